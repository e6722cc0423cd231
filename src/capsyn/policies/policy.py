"""The control alphabet policy: one symbol for every state, and symbol in force if it remembers."""

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

    Calling the policy with states (..., n), and with exogenous inputs (..., k) where it is told
    some, returns symbol indices (...,) into ``policy.alphabet.values``; -1 stands for the default
    control.

    Parameters
    ----------
    name : str
        Name of the problem.
    domain : Box
        States that have cells; see `space`.
    alphabet : Alphabet
        The symbols U.
    default : (m,)
        Default control [input units].
    cells : CellTree or SplitTree
        The partitions L; a `SplitTree` of a `DecisionTree`.
    outside : "error", "nearest" or symbol index
        What a state outside the domain gets: an error, the symbol of the nearest cell, or a safe
        symbol. A state that is not finite gets an error, or the safe symbol.
    min_dwell : float
        Least time between switches [time unit], for whoever runs the policy.
    target : Ball, Box or Program, optional
        What "arrived" means; of a program, the states where it is not 0.
    horizon : float, optional
        Prediction horizon T [time unit] of the controller that the policy came from.
    settings : SsacSettings, optional
        Its settings; without a horizon, those of the problem, which say the sample time.
    model : Model, optional
        Its model, as programs.
    statistics : dict
        Counts and shares of the synthesis, as plain data.
    timings : dict
        Seconds of the synthesis by part; not part of the policy's file.
    evidence : dict
        What `capsyn.verification` found, by kind, as plain data, and under ``"sha256"`` the content
        that it is about; see `with_evidence`.
    gaps : bool
        Whether cells of the default control are gaps: states there are outside, although in the
        domain, and have no symbol of a nearest cell either.
    time_unit, outside_at_once
        See `Problem`.
    transitions : (R, N + 1) ints, optional
        The transition function T: which label follows each label in force, the default's last; a
        row for each leaf number of `cells` but those of affine leaves. The first N + 1 rows are
        constant. Default: no more than these, so that the symbol in force does not matter.
    switching : Switching, optional
        The prices that `transitions` keeps, as numbers; least times, and forbidden transitions.
    delay : float
        Input delay that the policy compensates [time unit].
    exogenous : Box, optional
        Values of the exogenous inputs, what the policy is told beside the state; see `Problem`.
    kept : Kept, optional
        From where its limits are kept; see `keeps_limits`.
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
        """Return the symbol indices (...,) of states (..., n); -1 is the default control.

        Parameters
        ----------
        states : (..., n)
            States [state units].
        exogenous : (..., k), or mapping of name to numbers (...), optional
            Exogenous inputs, of a policy that is told some, broadcast against the states. Left out,
            `states` are readings (..., n + k), these last.
        outside : "error", "nearest" or symbol index, optional
            Overrides the policy's own rule.
        backend : "auto", "c" or "numpy"
            Which lookup to use; all give the same symbols. Features are for NumPy in any case.
        current : symbol indices (...,), or the name of one, optional
            The symbols in force, -1 for the default control, which is in force before the first
            decision. Default: that. A policy that does not remember is the same for all.

        Raises
        ------
        OutsideDomainError
            A state outside the domain under rule ``"error"``, or one in a gap, or one that is not
            finite, under ``"error"`` or ``"nearest"``.
        ProblemError
            States of another shape, or symbols in force that are none.
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
        """Return readings (..., n + k) of states and exogenous inputs; see a call of the policy.

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
        """Return the next labels (B,) of readings `states`: symbols, N the default, or negative.

        It is negative where there is none. With `nearest` a finite state outside the domain has
        that of the nearest cell; `backend` is that of a call; `in_force` (B,) are the labels in
        force, by default the default's.
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
        """Return which rows of `transitions` hold at states (..., n), numbers (...,).

        `exogenous` is that of a call of the policy. They are negative outside the domain and where
        a state is not finite. Numbers from R on are those of affine leaves, whose row varies with
        the state; see ``cells.affine``.

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

        `exogenous`, whose values must be in their box, is that of a call of the policy.

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
        """Return the control vectors (..., m) [input units] of states (..., n).

        `exogenous`, `outside`, `current` and errors are those of a call of the policy.
        """
        return self.controls[self(states, exogenous, outside, current=current)]

    def at(self, exogenous: Any) -> Policy:
        """Return the policy of the states alone that this one is while exogenous inputs stay.

        Its symbols are those of this policy at `exogenous` (k,), or a mapping of names, exactly:
        its cells are the cut through these cells, and its model the same with the inputs fixed.

        Raises
        ------
        ProblemError
            Inputs that are no k finite numbers within their box, or a policy that is told nothing.
        """
        from capsyn.policies.cut import at

        return at(self, exogenous)

    def structure(self) -> dict[str, Any]:
        """Return what the file says of the cells beside their arrays, as plain data."""
        return self.cells.structure()

    @functools.cached_property
    def mixed_share(self) -> float:
        """Share of the volume of finest cells whose test points did not agree."""
        return mixed_share(cell_tree(self))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the policy to a file at `path`, whole or not at all.

        Raises
        ------
        ProblemError
            A place that cannot be written.
        """
        from capsyn.policies.file import save

        save(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Policy:
        """Return the policy in the file at `path`, a `DecisionTree` where it holds one.

        Raises
        ------
        PolicyFormatError
            The file is no policy, damaged, tampered with, or of a newer format.
        """
        from capsyn.policies.file import load

        return load(path, lambda known: (DecisionTree if "guarantee" in known else Policy)(**known))

    def with_evidence(self, **kinds: dict[str, Any]) -> Policy:
        """Return the policy with evidence added, which its file will carry.

        `kinds` are what ``to_json()`` of a result of `capsyn.verification` gives, by name:
        ``monte_carlo``, ``lyapunov`` or ``agreement``. That of another content is dropped.

        Raises
        ------
        ProblemError
            Another kind, or something that is not such plain data.
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
        Splits, and labels of leaves.
    guarantee : Guarantee
        What it has in common with the policy that it was made from.

    Notes
    -----
    Splits compare lattice integers, so that every backend and export
    gives the same symbol.
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
        """Return `policy` with a tree for `cells`, and its `guarantee`; without its evidence."""
        kept = {f.name: getattr(policy, f.name) for f in fields(Policy)}
        return DecisionTree(
            guarantee=guarantee, **kept | {"cells": cells, "evidence": {}, "timings": {}}
        )

    @property
    def node_count(self) -> int:
        """Inner nodes and leaves."""
        return self.cells.node_count

    @property
    def depth(self) -> int:
        """Most comparisons that a lookup takes."""
        return self.cells.depth

    @property
    def title(self) -> str:
        """The name and the mode."""
        return f"{self.name}, {self.guarantee.mode} tree"

    def structure(self) -> dict[str, Any]:
        """Return what the file says of the tree beside its arrays, and its guarantee."""
        return super().structure() | {"guarantee": self.guarantee.to_json()}

    @property
    def mixed_share(self) -> float:
        """0: a tree has no cells whose test points did not agree."""
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
