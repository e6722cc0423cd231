"""The control alphabet policy: one symbol for every state, and for every symbol in force."""

from __future__ import annotations

import dataclasses
import functools
import os
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.errors import OutsideDomainError, ProblemError
from capsyn.limits.kept import Kept
from capsyn.modelling.alphabet import Alphabet, Outside, check_outside
from capsyn.modelling.domain import Box
from capsyn.modelling.exogenous import readings
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching
from capsyn.modelling.targets import Target
from capsyn.policies.checks import check_fields, labels_in_force
from capsyn.policies.derived import Derived
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.in_force import mixed_share
from capsyn.policies.lookup import GAP, OUTSIDE, outside_text, row_numbers
from capsyn.programs.model import Model
from capsyn.validation import describe


@dataclass(frozen=True, eq=False)
class Policy(Derived):
    """A control alphabet policy ``<U, L, T>`` (Definition 2 of the paper).

    A call of the policy with states (..., n) returns symbol indices (...,) into
    ``policy.alphabet.values``. -1 stands for the default control. If the policy is told exogenous
    inputs (..., k), the call takes them after the states.

    Parameters
    ----------
    name : str
        Name of the problem.
    domain : Box
        The states that have cells; see `space`.
    alphabet : Alphabet
        The symbols U.
    default : (m,)
        Default control [input units].
    cells : CellTree or SplitTree
        The partitions L. A `DecisionTree` has a `SplitTree`.
    outside : "error", "nearest" or symbol index
        What a state outside the domain gets: an error, the symbol of the nearest cell, or a safe
        symbol. A state that is not finite gets an error or the safe symbol.
    min_dwell : float
        Least time between switches [time unit], which closed loops and exports keep.
    target : Ball, Box or Program, optional
        The states that count as arrived. For a program, these are the states where it is not 0.
    horizon : float, optional
        Prediction horizon T [time unit] of the controller that the policy came from; samples where
        it is `discrete`.
    settings : SsacSettings, optional
        Settings of that controller. Without a horizon, only their sample time counts.
    model : Model, optional
        Model of that controller, as programs.
    statistics : dict
        Counts and shares of the synthesis, as plain data.
    timings : dict
        Seconds of the synthesis by part. The policy's file does not have them.
    evidence : dict
        What `capsyn.verification` found, by kind, as plain data. ``"sha256"`` names the content
        that the evidence is about; see `with_evidence`.
    gaps : bool
        Whether cells of the default control are gaps. A state in a gap counts as outside, although
        it is in the domain, and does not get the symbol of a nearest cell.
    time_unit, outside_at_once
        See `Problem`.
    transitions : (R, N + 1) ints, optional
        The transition function T: the label that follows each label in force, the default's last.
        Each leaf number of `cells` has a row, except affine leaves. The first N + 1 rows are
        constant. Default: only these rows, and the symbol in force does not matter.
    switching : Switching, optional
        Prices as numbers, least times and forbidden transitions, which `transitions` keeps.
    delay : float
        Input delay that the policy compensates [time unit].
    exogenous : Box, optional
        Box of the exogenous inputs, which the policy is told beside the state; see `Problem`.
    kept : Kept, optional
        The states from which the policy keeps limits; see `keeps_limits`.
    """

    name: str
    domain: Box
    alphabet: Alphabet
    default: np.ndarray
    cells: CellTree | SplitTree
    outside: Outside = "error"
    min_dwell: float = 0.0
    target: Target | None = None
    horizon: float | None = None
    settings: SsacSettings | None = None
    model: Model | None = None
    statistics: dict[str, Any] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)
    evidence: dict[str, Any] = field(default_factory=dict)
    gaps: bool = False
    time_unit: str = "s"
    outside_at_once: bool = False
    transitions: Any = None
    switching: Switching | None = None
    delay: float = 0.0
    exogenous: Box | None = None
    kept: Kept | None = None

    _structure: ClassVar[type] = CellTree

    def __post_init__(self) -> None:
        check_fields(self, self._structure)

    def __call__(
        self,
        states: Any,
        exogenous: Any = None,
        outside: Outside | None = None,
        backend: str = "auto",
        current: Any = None,
    ) -> Any:
        """Return the symbol indices (...,) for states (..., n); -1 is the default control.

        Parameters
        ----------
        states : (..., n)
            States [state units].
        exogenous : (..., k), or mapping of name to numbers (...), optional
            Exogenous inputs, broadcast against the states, if the policy is told some. If left out,
            `states` are readings (..., n + k), with the exogenous inputs last.
        outside : "error", "nearest" or symbol index, optional
            Rule for states outside, in place of the policy's own rule.
        backend : "auto", "c" or "numpy"
            Which lookup to use. All give the same symbols. Features always take NumPy.
        current : symbol indices (...,), or the name of one, optional
            The symbols in force; -1, the default control, is in force before the first decision.
            Default: -1. The symbol of a policy that does not remember is the same for all of them.

        Raises
        ------
        OutsideDomainError
            A state is outside the domain under rule ``"error"``. Or a state is in a gap, or not
            finite, under rule ``"error"`` or ``"nearest"``.
        ProblemError
            States of another shape, or symbols in force that are not in the alphabet.
        """
        states = self.readings(states, exogenous)
        rule = check_outside(self.outside if outside is None else outside, self.alphabet)
        flat = states.reshape(-1, self.space.n)
        in_force = labels_in_force(current, states.shape[:-1], self.alphabet)
        labels = self.leaves(flat, rule == "nearest", backend, in_force)
        lost = labels < 0
        if lost.any():
            if isinstance(rule, str):
                first = int(np.flatnonzero(lost)[0])
                index = None if states.ndim == 1 else first
                what = "state" if self.exogenous is None else "reading"
                raise OutsideDomainError(outside_text(self.space, flat[first], index, what))
            labels[lost] = rule
        labels[labels == len(self.alphabet)] = -1
        return labels.reshape(states.shape[:-1])[()]

    def readings(self, states: Any, exogenous: Any = None) -> np.ndarray:
        """Return readings (..., n + k): states, then exogenous inputs; see a call of the policy.

        Raises
        ------
        ProblemError
            States or exogenous inputs of another shape, or that are no numbers.
        """
        return readings(states, exogenous, self.domain, self.exogenous)

    def leaves(
        self,
        states: np.ndarray,
        nearest: bool,
        backend: str = "auto",
        in_force: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the next labels (B,) of readings `states`: symbols, or N for the default.

        A label is negative where a state has none. With `nearest`, a finite state outside the
        domain has the label of the nearest cell. `in_force` (B,) are the labels in force, by
        default the default control's. `backend` is that of a call.
        """
        labels = row_numbers(states, self.space, self.cells, nearest, backend, in_force)
        if len(self.transitions) > len(self.alphabet) + 1:
            known = labels >= 0
            now = len(self.alphabet) if in_force is None else in_force[known]
            labels[known] = self.transitions[labels[known], now]
        if self.gaps:
            labels[labels == len(self.alphabet)] = GAP
        return labels

    def rows(self, states: Any, exogenous: Any = None) -> Any:
        """Return which rows of `transitions` hold at states (..., n), as numbers (...,).

        A number is negative for a state that is outside the domain or not finite. Numbers from R on
        belong to affine leaves, whose row varies with the state; see ``cells.affine``. `exogenous`
        is that of a call of the policy.

        Raises
        ------
        ProblemError
            States of another shape, or that are no numbers.
        """
        states = self.readings(states, exogenous)
        flat = states.reshape(-1, self.space.n)
        inside = self.space.contains(flat)
        numbers = np.full(len(flat), OUTSIDE, dtype=np.int32)
        steps = self.space.locate(flat[inside], self.cells.counts)
        numbers[inside] = self.cells.labels_at(self.cells.find(steps))
        return numbers.reshape(states.shape[:-1])[()]

    def covers(self, states: Any, exogenous: Any = None) -> Any:
        """Return whether states (..., n) are in the domain and in no gap, booleans (...).

        `exogenous` is that of a call of the policy. The exogenous inputs must be in their box, too.

        Raises
        ------
        ProblemError
            States of another shape, or that are no numbers.
        """
        states = self.readings(states, exogenous)
        leaves = self.leaves(states.reshape(-1, self.space.n), False)
        return (leaves >= 0).reshape(states.shape[:-1])[()]

    def control(
        self,
        states: Any,
        exogenous: Any = None,
        outside: Outside | None = None,
        current: Any = None,
    ) -> np.ndarray:
        """Return the control vectors (..., m) [input units] for states (..., n).

        `exogenous`, `outside`, `current` and the errors are those of a call of the policy.
        """
        return self.controls[self(states, exogenous, outside, current=current)]

    def at(self, exogenous: Any) -> Policy:
        """Return the policy of the states alone, for exogenous inputs that stay fixed.

        The new policy has exactly the symbols of this policy at `exogenous` (k,), or a mapping of
        names. The new cells are the cut through these cells, and the new model has the inputs
        fixed.

        Raises
        ------
        ProblemError
            `exogenous` is not k finite numbers within their box, or the policy is told nothing.
        """
        from capsyn.policies.cut import at

        return at(self, exogenous)

    def structure(self) -> dict[str, Any]:
        """Return what the file says about the cells besides their arrays, as plain data."""
        return self.cells.structure()

    @functools.cached_property
    def mixed_share(self) -> float:
        """Share of the volume that is in finest cells whose test points did not agree."""
        return mixed_share(cell_tree(self))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy to a file at `path`, completely or not at all.

        Raises
        ------
        ProblemError
            A place that cannot be written.
        """
        from capsyn.policies.file import save

        save(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Policy:
        """Return the policy in the file at `path`, which may be a `DecisionTree`.

        Raises
        ------
        PolicyFormatError
            The file is no policy, is damaged or tampered with, or has a newer format.
        """
        from capsyn.policies.file import load

        return load(path, lambda known: (DecisionTree if "guarantee" in known else Policy)(**known))

    def with_evidence(self, **kinds: dict[str, Any]) -> Policy:
        """Return the policy with evidence added. Its file then carries the evidence.

        `kinds` are results of `capsyn.verification` by name, ``monte_carlo``, ``lyapunov`` or
        ``agreement``, as their ``to_json()`` gives them. Evidence of another content is dropped.

        Raises
        ------
        ProblemError
            Another kind of evidence, or data that are no such evidence.
        """
        from capsyn.policies.file import add_evidence

        return dataclasses.replace(self, evidence=add_evidence(self, kinds))

    def __repr__(self) -> str:
        return (
            f"Policy('{self.name}', {axes_text(self)}, {len(self.alphabet)} symbols, "
            f"{self.cells.leaf_count} cells)"
        )


@dataclass(frozen=True, eq=False)
class DecisionTree(Policy):
    """A policy that looks symbols up in a decision tree; see `Policy`.

    Parameters
    ----------
    cells : SplitTree
        The splits of the tree, and the labels of its leaves.
    guarantee : Guarantee
        How the tree compares with the policy that it was made from.

    Notes
    -----
    Splits compare integers of a lattice, so every backend and export gives the same symbol.
    """

    cells: SplitTree
    guarantee: Guarantee = field(kw_only=True)

    _structure: ClassVar[type] = SplitTree

    def __post_init__(self) -> None:
        if not isinstance(self.guarantee, Guarantee):
            raise ProblemError(f"`guarantee` must be a Guarantee; got {describe(self.guarantee)}")
        super().__post_init__()

    @staticmethod
    def of(policy: Policy, cells: SplitTree, guarantee: Guarantee) -> DecisionTree:
        """Return `policy` with a tree for `cells` and its `guarantee`, without the old evidence."""
        kept = {f.name: getattr(policy, f.name) for f in fields(Policy)}
        return DecisionTree(
            guarantee=guarantee, **kept | {"cells": cells, "evidence": {}, "timings": {}}
        )

    @property
    def node_count(self) -> int:
        """Number of nodes: inner nodes and leaves."""
        return self.cells.node_count

    @property
    def depth(self) -> int:
        """Most comparisons that a lookup takes."""
        return self.cells.depth

    @property
    def title(self) -> str:
        """The name of the policy and the mode of the tree."""
        return f"{self.name}, {self.guarantee.mode} tree"

    def structure(self) -> dict[str, Any]:
        """Return what the file says about the tree besides its arrays, with its guarantee."""
        return super().structure() | {"guarantee": self.guarantee.to_json()}

    @property
    def mixed_share(self) -> float:
        """Always 0, as a tree has no cells whose test points did not agree."""
        return 0.0

    def __repr__(self) -> str:
        return (
            f"DecisionTree('{self.name}', {axes_text(self)}, {len(self.alphabet)} symbols, "
            f"{self.node_count} nodes, {self.guarantee.mode})"
        )


def axes_text(policy: Policy) -> str:
    """Return how many states, and exogenous inputs if any, a policy is asked with."""
    told = "" if policy.exogenous is None else f" + {policy.exogenous.n} exogenous"
    return f"{policy.domain.n} states{told}"


def cell_tree(policy: Any) -> CellTree:
    """Return the cells of a policy; `ProblemError` if it is none, or a decision tree."""
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a capsyn.Policy; got {describe(policy)}")
    if not isinstance(policy.cells, CellTree):
        raise ProblemError(
            f"`policy` must be one of cells, as synthesize makes them; got {policy!r}"
        )
    return policy.cells
