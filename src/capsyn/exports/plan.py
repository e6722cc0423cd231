"""What every target needs of a policy: its cells or its tree, constants, names and a header."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from dataclasses import dataclass

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import FeatureTree
from capsyn.cells.split_tree import SplitTree
from capsyn.compression.trees import affine_tree_of, tree_of
from capsyn.errors import ProblemError
from capsyn.exports.crossings import reading_factors
from capsyn.exports.text import kind, price, with_unit
from capsyn.modelling.alphabet import Alphabet, check_outside
from capsyn.modelling.discrete import horizon_text
from capsyn.modelling.switching import DEFAULT
from capsyn.modelling.time_unit import to_seconds
from capsyn.policies.file import content_hash
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree, Policy
from capsyn.validation import describe, finite_number, true_or_false
from capsyn.version import __version__

_tree_of = functools.lru_cache(maxsize=1)(tree_of)  # kept for the next target
_affine_tree_of = functools.lru_cache(maxsize=1)(affine_tree_of)
MOST_NODES = 200_000
"""Most nodes of a tree of affine leaves in targets that write trees alone."""
Files = dict[str, bytes]
"""Contents of files by name."""
OK, OUTSIDE, NOT_FINITE = 0, 1, 2
"""Status of a decision: a state in the domain, outside it, or with a NaN or infinite component."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A policy on its way to a target.

    A decision gives a symbol and a status. In the domain it is the policy's symbol. Outside, it is
    the policy's symbol of the nearest cell where the policy's rule is ``nearest``, else the safe
    symbol; of a state that is not finite, or in a gap of the policy, always the safe symbol.

    Parameters
    ----------
    policy : Policy
        What is exported.
    safe : int
        Symbol where there is no other: 0 .. N-1, or N for the default control.
    nearest : bool
        Whether a state outside the domain takes the symbol of the nearest cell.
    dwell : float
        Least time between switches [time unit of the policy]; 0 for none.
    outside_at_once : bool
        Whether the symbol of a state outside the domain does not wait for that.
    scale, offset : (n,)
        A state is ``reading * scale + offset``, rounded as written in double precision.
    as_cells : bool
        Whether what is written are the policy's cells, as affine leaves are, else its tree.
    hold_off : float
        Time after the start for which the safe symbol is in force, whatever the state [time unit].
    given : Policy, optional
        The policy as it was given, where its least times are others. Default: the policy.
    """

    policy: Policy
    safe: int
    nearest: bool
    dwell: float
    outside_at_once: bool
    scale: np.ndarray
    offset: np.ndarray
    as_cells: bool = False
    hold_off: float = 0.0
    given: Policy | None = None

    @staticmethod
    def of(
        policy: Policy,
        *,
        safe: int | str | None = None,
        dwell: float | None = None,
        outside_at_once: bool | None = None,
        scale: object = None,
        offset: object = None,
        hold_off: float = 0.0,
    ) -> Plan:
        """Return the plan of a policy; for the arguments see `capsyn.exports.export.export`.

        Raises
        ------
        ProblemError
            An argument that cannot be used, or readings that do not tell lattice steps apart.
        """
        if not isinstance(policy, Policy):
            raise ProblemError(f"`policy` must be a capsyn.Policy; got {describe(policy)}")
        labels = len(policy.alphabet)
        own = policy.outside if isinstance(policy.outside, int) else -1
        chosen = own if safe is None else _symbol(safe, policy.alphabet)
        at_once = policy.outside_at_once if outside_at_once is None else outside_at_once
        true_or_false("outside_at_once", at_once)
        factors = reading_factors(policy.space, policy.cells.counts, scale, offset)
        if policy.kept is not None and (dwell is not None or hold_off):
            raise ProblemError("`dwell` and `hold_off` must be left out: limits are kept without")
        given = policy
        if dwell is not None and finite_number("dwell", dwell, least=0.0) >= 0:
            policy = _held(policy, float(dwell))
        hold_off = finite_number("hold_off", hold_off, least=0.0)
        for name, time in (("dwell", policy.min_dwell), ("hold_off", hold_off)):
            finite_number(f"{name} in seconds", to_seconds(time, policy.time_unit))
        safe_label = chosen % (labels + 1)
        if policy.rules.forbidden[:, safe_label].any():
            before = int(np.flatnonzero(policy.rules.forbidden[:, safe_label])[0])
            names = (*policy.alphabet.names, DEFAULT)
            raise ProblemError(
                "`safe` must be a symbol that every other may go to; the transition from "
                f"'{names[before]}' to '{names[safe_label]}' is forbidden"
            )
        return Plan(
            policy,
            safe_label,
            policy.outside == "nearest",
            policy.min_dwell,
            at_once,
            *factors,
            _is_affine(policy),
            hold_off,
            given,
        )

    def written(self, as_cells: bool) -> Plan:
        """Return the plan with the policy's cells, or its tree, for what is written."""
        return self if as_cells == self.as_cells else dataclasses.replace(self, as_cells=as_cells)

    @property
    def source(self) -> Policy:
        """The policy as it was given."""
        return self.policy if self.given is None else self.given

    @functools.cached_property
    def sha256(self) -> str:
        """Hash of the content of that policy."""
        return content_hash(self.source)

    @functools.cached_property
    def tree(self) -> DecisionTree:
        """The policy itself where it is a tree, else its exact tree; made when it is asked for."""
        return _tree_of(self.source)

    @property
    def cells(self) -> CellTree | SplitTree:
        """What is written: the policy's cells, or the nodes of its tree."""
        return self.policy.cells if self.as_cells else self.tree.cells

    @property
    def counts(self) -> tuple[int, ...]:
        """Lattice steps along each axis."""
        return self.policy.cells.counts

    @property
    def guarantee(self) -> Guarantee:
        """What the export has in common with the policy that a tree was made from."""
        if self.as_cells:
            return Guarantee("exact", self.sha256)
        return self.tree.guarantee

    @property
    def n(self) -> int:
        """Number of states, and of the exogenous inputs after them."""
        return self.policy.space.n

    @property
    def has_state(self) -> bool:
        """Whether a decision needs more between calls than one least time for all symbols.

        That is the symbol in force, where the next depends on it, and the times of symbols and
        inputs.
        """
        return bool(has_state(self.policy) or self.hold_off)

    @property
    def transitions(self) -> np.ndarray:
        """The label that follows each in force, (R, N + 1), of the rows of leaves written."""
        return (self.policy if self.as_cells else self.tree).transitions

    @property
    def waits(self) -> bool:
        """Whether anything waits for a time."""
        rules = self.policy.rules
        return bool(rules.holds.any() or rules.input_holds.any() or self.hold_off)

    @property
    def forbidden(self) -> list[list[int]]:
        """Transitions that are not taken: pairs of labels, from and to."""
        return np.argwhere(self.policy.rules.forbidden).tolist()

    @property
    def dwell_s(self) -> float:
        """Least time between switches [s]; 0 for none."""
        return to_seconds(self.dwell, self.policy.time_unit)

    @property
    def at_once(self) -> tuple[int, ...]:
        """Statuses whose symbol does not wait for the dwell time."""
        return (OUTSIDE, NOT_FINITE) if self.outside_at_once else (NOT_FINITE,)

    @property
    def labels(self) -> int:
        """Number of labels, N + 1; the last is the default control."""
        return len(self.policy.alphabet) + 1

    @property
    def default(self) -> int:
        """Label of the default control."""
        return self.labels - 1

    @property
    def gap(self) -> int:
        """Label of cells whose states are outside and get the safe symbol; -1 for none."""
        return self.default if self.policy.gaps else -1

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user must be told, whatever the target."""
        if self.safe < self.default or self.first_alike[self.default] < self.default:
            return ()
        value = ", ".join(f"{v:g}" for v in self.policy.controls[-1].tolist())
        model = self.policy.model
        if model is not None and model.prediction is not None:
            value += ", the default's law in the middle of all bounds"
        return (
            f"the safe symbol is the default control ({value}), which is no symbol of the "
            "alphabet: a reading that is not finite would apply it; `safe` takes a symbol",
        )

    @functools.cached_property
    def first_alike(self) -> list[int]:
        """Of each label the first to which a change is no switch, (N + 1); see `SwitchRules`."""
        return self.policy.rules.kinds.tolist()

    @property
    def same_control(self) -> list[tuple[int, int]]:
        """Pairs of symbols, both ways, that have the same control: between them is no switch."""
        groups: dict[int, list[int]] = {}
        for k, first in enumerate(self.first_alike):
            groups.setdefault(first, []).append(k)
        return [pair for group in groups.values() for pair in itertools.permutations(group, 2)]

    @property
    def symbol_names(self) -> tuple[str, ...]:
        """Names of the labels, "default" last."""
        return (*self.policy.alphabet.names, "default")

    @property
    def folded(self) -> bool:
        """Whether readings are other numbers than states."""
        return bool((self.scale != 1).any() or (self.offset != 0).any())

    def states(self, readings: np.ndarray) -> np.ndarray:
        """Return the states (K, n) of readings (K, n)."""
        if not self.folded:
            return readings
        with np.errstate(over="ignore", invalid="ignore"):
            return readings * self.scale + self.offset

    @functools.cached_property
    def header(self) -> tuple[str, ...]:
        """Lines that every file begins with: what it is, and from what; printable text."""
        policy, domain = self.policy, self.policy.space
        lines = [f"Control alphabet policy '{policy.name}', by capsyn {__version__}."]
        for i in range(self.n):
            unit = f" {domain.units[i]}" if domain.units[i] else ""
            periodic = ", periodic" if domain.periodic[i] else ""
            bounds = f"[{float(domain.lower[i])!r}, {float(domain.upper[i])!r}]"
            what = f"{kind(policy, i).capitalize()} {i}"
            lines.append(f"{what}: {domain.names[i]} in {bounds}{unit}{periodic}")
        if self.folded:
            pairs = zip(self.scale.tolist(), self.offset.tolist())
            for i, (scale, offset) in enumerate(pairs):
                sign = "-" if offset < 0 else "+"
                what = f"{kind(policy, i).capitalize()} {i}"
                lines.append(f"{what} = {scale!r} * reading {sign} {abs(offset)!r}")
        if policy.exogenous is not None:
            lines.append("Readings: states, then exogenous inputs; 'state' below is either of them")
        inputs = map(with_unit, policy.alphabet.inputs, policy.alphabet.units)
        lines.append(f"Inputs: {', '.join(inputs)}")
        for k, name in enumerate(self.symbol_names):
            value = ", ".join(f"{v!r}" for v in policy.controls[k].tolist())
            lines.append(f"Symbol {k}: {name} ({value})")
        if policy.model is not None and policy.model.prediction is not None:
            lines.append("The default control is that of a law in the middle of all bounds")
        lost = f"symbol {self.safe} ({self.symbol_names[self.safe]})"
        nearest = f"Outside: the symbol of the nearest cell; not finite: {lost}"
        lines.append(nearest if self.nearest else f"Outside and not finite: {lost}")
        if self.policy.gaps:
            lines.append(f"In the domain, cells without a symbol are outside: {lost}")
        if policy.kept is not None:
            lines.append("What says whether limits are kept from a state is in the folder limits")
        lines += self._times()
        if self.outside_at_once:
            lines.append("The symbol of a state outside does not wait for that")
        if policy.settings is not None and policy.horizon is not None:
            settings = policy.settings
            wanted = f"alpha_d {settings.alpha_d!r}"
            if settings.alpha_d is None:
                wanted = f"gamma {settings.gamma!r}"
            weight = np.asarray(settings.control_weight).tolist()
            lines.append(
                f"Made by sSAC: rule {settings.rule}, "
                + (f"{wanted}, " if settings.rule == "schedule" else "")
                + f"control weight {weight!r}, {settings.on_no_descent} where none descends, "
                f"{horizon_text(policy)}, {settings.precision} precision"
            )
        lines.append(_structure(self))
        if isinstance(policy.cells, FeatureTree):
            lines.append(f"Features: {', '.join(policy.cells.features.names)}")
        lines.append(f"Policy content: SHA-256 {self.sha256}")
        return tuple(lines)

    def _times(self) -> list[str]:
        """Return what the header says of prices and least times."""
        policy, rules = self.policy, self.policy.rules
        unit, switching, lines = policy.time_unit, policy.switching, []
        if not self.has_state:
            return [f"Least time between switches: {self.dwell!r} {unit}"]
        if policy.remembers:
            lines.append(
                "The next symbol depends on the symbol in force, which stays where it ties"
            )
        if switching is not None and switching.price:
            lines.append(f"Price of a switch: {price(switching.price)} [cost / {unit}]")
        if switching is not None and switching.forbidden:
            pairs = ", ".join(f"{before} to {after}" for before, after in switching.forbidden)
            lines.append(f"Forbidden: {pairs}")
        names = (*self.symbol_names, *policy.alphabet.inputs)
        times = zip(names, [*rules.holds.tolist(), *rules.input_holds.tolist()])
        held = ", ".join(f"{name} {time!r}" for name, time in times if time)
        lines.append(f"Least times [{unit}]: {held}" if held else "Least times: none")
        if self.hold_off:
            lines.append(f"After the start the safe symbol is held for {self.hold_off!r} {unit}")
        if policy.delay:
            lines.append(f"Compensates an input delay of {policy.delay!r} {unit}")
        return lines


def has_state(policy: Policy) -> bool:
    """Return whether a policy has more to remember than one least time for all symbols."""
    rules = policy.rules
    several = len(set(rules.holds.tolist())) > 1 or rules.input_holds.any()
    return bool(policy.remembers or several)


def tree_within(policy: Policy, most: int) -> DecisionTree | None:
    """Return the tree of a policy; None where that of affine leaves has more nodes than `most`."""
    return _affine_tree_of(policy, most) if _is_affine(policy) else _tree_of(policy)


def _held(policy: Policy, dwell: float) -> Policy:
    """Return a policy with one least time for all symbols [time unit], and none of inputs."""
    switching = policy.switching
    if switching is not None:
        switching = dataclasses.replace(switching, hold=0.0)
    return dataclasses.replace(policy, min_dwell=dwell, switching=switching)


def _is_affine(policy: Policy) -> bool:
    return isinstance(policy.cells, CellTree) and policy.cells.affine is not None


def _structure(plan: Plan) -> str:
    """Return what the header says of what is written."""
    cells = plan.cells
    if isinstance(cells, SplitTree):
        return f"Tree: {cells.node_count} nodes; {plan.guarantee.text}."
    rows = ""
    if cells.affine is not None:
        rows = f", {len(cells.affine)} of them affine with {len(cells.affine.symbols)} rows"
    return f"Cells: {cells.leaf_count} leaves{rows}; those of the policy itself."


def _symbol(safe: object, alphabet: Alphabet) -> int:
    """Return the index of a safe symbol, -1 for the default control."""
    if safe in ("default", len(alphabet), str(len(alphabet))) and safe not in alphabet.names:
        return -1
    try:
        chosen = check_outside(safe, alphabet)
    except ProblemError:
        chosen = "error"
    if isinstance(chosen, str):
        names = ", ".join(alphabet.names)
        raise ProblemError(
            f"`safe` must be a symbol: default, its name ({names}) or its index, -1 to "
            f"{len(alphabet) - 1}; got {describe(safe)}"
        )
    return chosen
