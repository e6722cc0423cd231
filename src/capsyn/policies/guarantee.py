"""A policy as a decision tree, and what the tree guarantees."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields
from typing import Any

from capsyn.errors import ProblemError
from capsyn.statistics import clopper_pearson
from capsyn.validation import one_of, true_or_false

CONFIDENCE = 0.95
"""Of the interval of the share of judging states that agree."""
MODES = ("exact", "freedom", "linear")


@dataclass(frozen=True)
class Guarantee:
    """What a decision tree has in common with the policy that it was made from.

    Of a policy that remembers this is about rows, what follows each symbol in force: "the same
    symbol" is the same for every symbol in force, the default control among them, "another" one for
    any. So of `agreeing` states there are no more than of those of `capsyn.agreement`, which is the
    mean over the symbols in force.

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
    controller : "ssac", "function", "policy" or ""
        What the tree was judged against: sSAC with the policy's own model, a given function, or the
        policy.
    states, agreeing : int
        Random states that the tree was neither fitted to nor chosen by, and those at which it gives
        a symbol of the controller.
    target : float, optional
        Share that was asked for.
    cut : bool
        Whether the tree is the one that was judged with its exogenous inputs fixed: shares are then
        those of the whole.
    """

    mode: str
    source: str
    level: int | None = None
    changed: float = 0.0
    controller: str = ""
    states: int = 0
    agreeing: int = 0
    target: float | None = None
    cut: bool = False

    def __post_init__(self) -> None:
        one_of("mode", self.mode, list(MODES))
        true_or_false("cut", self.cut)
        one_of("controller", self.controller, ["", "ssac", "function", "policy"])
        shares = [self.changed] + ([] if self.target is None else [self.target])
        sound = (
            isinstance(self.source, str)
            and len(self.source) == 64
            and set(self.source) <= set("0123456789abcdef")
            and all(type(share) in (int, float) and 0 <= share <= 1 for share in shares)
            and type(self.states) is type(self.agreeing) is int
            and 0 <= self.agreeing <= self.states < 2**53
            and (self.states > 0) == (self.controller != "")
            and (self.level is None or (type(self.level) is int and 0 <= self.level < 64))
        )
        if not sound:
            raise ProblemError(f"the guarantee of a tree does not make sense: {self.to_json()}")

    @property
    def agreement(self) -> float:
        """Share of the judging states at which the tree agrees with the controller; else NaN."""
        return self.agreeing / self.states if self.states else float("nan")

    @functools.cached_property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval, of `CONFIDENCE`, of the volume where it agrees; else (0, 1)."""
        if not self.states:
            return 0.0, 1.0
        return clopper_pearson(self.agreeing, self.states, CONFIDENCE)

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.interval[0]

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.interval[1]

    @property
    def reached(self) -> bool:
        """Whether the interval is above the target, if there is one."""
        return self.target is None or self.low >= self.target

    @property
    def text(self) -> str:
        """What is guaranteed, in a sentence; shares are rounded to the careful side."""
        whole = "; stated of the whole, before exogenous inputs were fixed" if self.cut else ""
        return self._text() + whole

    def _text(self) -> str:
        policy = "the policy" if self.level is None else f"the policy cut off at level {self.level}"
        proved = {
            "exact": f"equal to {policy} in every cell (proved)",
            "freedom": f"equal to {policy} in every cell whose test points agreed, and a symbol "
            "seen in the cell elsewhere (proved)",
            "linear": f"another symbol than the policy's in {_percent(self.changed, up=True)} of "
            "the volume (estimated)",
        }[self.mode]
        if self.mode != "linear" and self.changed:
            changed = _percent(self.changed, up=True)
            proved += f"; another symbol than the policy's in {changed} of the volume"
        if not self.states:
            return proved
        than = {"ssac": "sSAC", "function": "its controller", "policy": "the policy"}[
            self.controller
        ]
        return (
            f"{proved}; agrees with {than} at {_percent(self.agreement)} of {self.states:,} random "
            f"states ({_percent(self.low)} to {_percent(self.high, up=True)} with {CONFIDENCE:.0%} "
            "confidence)"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the guarantee as plain data; what is not cut does not say so."""
        plain = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: v for k, v in plain.items() if k != "cut" or v}


def _percent(share: float, up: bool = False) -> str:
    """Return a share as text, rounded down or up, with two digits or as many as tell it from 1."""
    if share in (0.0, 1.0):
        return f"{share:.2%}"
    digits = 2 + max(0, math.ceil(-math.log10(min(share, 1 - share))) - 3)
    scale = 10.0 ** (digits + 2)
    rounded = math.ceil(share * scale - 1e-9) if up else math.floor(share * scale + 1e-9)
    return f"{rounded / scale:.{digits}%}"
