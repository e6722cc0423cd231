"""A policy as a decision tree, and what the tree guarantees."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np

from capsyn.errors import ProblemError
from capsyn.policy import Policy
from capsyn.split_tree import SplitTree
from capsyn.validation import describe, one_of

MODES = ("exact", "freedom", "linear")
SAMPLES = 100_000
"""States at which the volumes of a tree with oblique splits are estimated."""


@dataclass(frozen=True)
class Guarantee:
    """What a decision tree has in common with the policy that it was made from.

    Parameters
    ----------
    mode : "exact", "freedom" or "linear"
        ``exact``: every state has the policy's symbol. ``freedom``: so has every state of a cell
        whose test points agreed, and all others have a symbol that was seen in their cell. Both
        are proved cell by cell. ``linear``: no state is sure, see `agreeing`.
    source : str
        SHA-256 of the policy's content, as in its file.
    level : int, optional
        Cells below this level were merged first; modes and proofs are about what was left.
    changed : float
        Share of the volume where the symbol is another one than the policy's; estimated at the
        `states` for ``linear``, else proved.
    controller : "ssac", "policy" or ""
        What the tree was judged against: sSAC with the policy's own model, or the policy.
    states, agreeing : int
        Random states that the tree was not fitted to, and those at which it gives a symbol of the
        controller.
    confidence, low, high : float
        Clopper-Pearson interval of the share of the volume where it does.
    target : float, optional
        Share that was asked for.
    reached : bool
        Whether it was reached.
    """

    mode: str
    source: str
    level: int | None = None
    changed: float = 0.0
    controller: str = ""
    states: int = 0
    agreeing: int = 0
    confidence: float = 0.95
    low: float = 0.0
    high: float = 1.0
    target: float | None = None
    reached: bool = True

    def __post_init__(self) -> None:
        one_of("mode", self.mode, list(MODES))
        one_of("controller", self.controller, ["", "ssac", "policy"])
        shares = [self.changed, self.confidence, self.low, self.high]
        shares += [] if self.target is None else [self.target]
        counts = (self.agreeing, self.states)
        sound = (
            isinstance(self.source, str)
            and len(self.source) == 64
            and set(self.source) <= set("0123456789abcdef")
            and all(type(share) in (int, float) and 0 <= share <= 1 for share in shares)
            and all(type(count) is int for count in counts)
            and 0 <= self.agreeing <= self.states < 2**63
            and (self.states > 0) == (self.controller != "")
            and self.low <= self.high
            and isinstance(self.reached, bool)
            and (self.level is None or (type(self.level) is int and 0 <= self.level < 64))
        )
        if not sound:
            raise ProblemError(f"the guarantee of a tree does not make sense: {self.to_json()}")

    @property
    def agreement(self) -> float:
        """Share of the judging states at which the tree agrees with the controller; else NaN."""
        return self.agreeing / self.states if self.states else float("nan")

    @property
    def text(self) -> str:
        """What is guaranteed, in a sentence."""
        policy = "the policy" if self.level is None else f"the policy cut off at level {self.level}"
        proved = {
            "exact": f"equal to {policy} in every cell (proved)",
            "freedom": f"equal to {policy} in every cell whose test points agreed, and a symbol "
            "seen in the cell elsewhere (proved)",
            "linear": f"another symbol than the policy's in {self.changed:.2%} of the volume "
            "(estimated)",
        }[self.mode]
        if self.mode != "linear" and self.changed:
            proved += f"; another symbol than the policy's in {self.changed:.2%} of the volume"
        if not self.states:
            return proved
        than = {"ssac": "sSAC", "policy": "the policy"}[self.controller]
        return (
            f"{proved}; agrees with {than} at {self.agreement:.2%} of {self.states:,} random "
            f"states ({self.low:.2%} to {self.high:.2%} with {self.confidence:.0%} confidence)"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the guarantee as plain data."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(frozen=True, eq=False)
class DecisionTree(Policy):
    """A policy that looks symbols up in a decision tree; see `Policy`.

    Parameters
    ----------
    guarantee : Guarantee
        What it has in common with the policy that it was made from.

    Notes
    -----
    ``cells`` is a `SplitTree`: splits compare lattice integers, so that every backend and export
    gives the same symbol.
    """

    cells: SplitTree
    guarantee: Guarantee = field(kw_only=True)

    _structure: ClassVar[type] = SplitTree

    def __post_init__(self) -> None:
        if not isinstance(self.guarantee, Guarantee):
            raise ProblemError(f"`guarantee` must be a Guarantee; got {describe(self.guarantee)}")
        super().__post_init__()

    @property
    def node_count(self) -> int:
        """Inner nodes and leaves."""
        return self.cells.node_count

    @property
    def depth(self) -> int:
        """Most comparisons that a lookup takes."""
        return self.cells.depth

    @functools.cached_property
    def volume_shares(self) -> np.ndarray:
        """Share of the domain's volume of each symbol, and of the default last, (N + 1,).

        Of a tree with oblique splits it is estimated at `SAMPLES` random states.
        """
        if not len(self.cells.planes):
            return super().volume_shares
        counts = self.cells.counts
        steps = np.random.default_rng(0).integers(counts, size=(SAMPLES, self.domain.n))
        found = np.bincount(self.cells.labels(steps), minlength=len(self.alphabet) + 1)
        return found / SAMPLES

    @property
    def mixed_share(self) -> float:
        """0: a tree has no cells whose test points did not agree."""
        return 0.0

    def __repr__(self) -> str:
        return (
            f"DecisionTree('{self.name}', {self.domain.n} states, {len(self.alphabet)} symbols, "
            f"{self.node_count} nodes, {self.guarantee.mode})"
        )
