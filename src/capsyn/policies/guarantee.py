"""What a decision tree guarantees about the policy that it was made from."""

from __future__ import annotations

import functools
import math
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from capsyn.errors import ProblemError
from capsyn.statistics import clopper_pearson
from capsyn.validation import describe, is_list, keep, one_of, true_or_false

CONFIDENCE = 0.95
"""Of the interval of the share of judging states that agree."""
LOSS = 0.1
"""Share of a policy's success, and of its cost, that a tree judged by closed loops may lose."""
MODES = ("exact", "freedom", "linear")


def cost_ratio(before: float, after: float) -> float:
    """Return a mean cost over another, of whatever sign; infinite where either is."""
    if not (math.isfinite(before) and math.isfinite(after)):
        return math.inf
    if before == 0:
        return 1.0 if after <= 0 else math.inf
    return 1 + (after - before) / abs(before)


@dataclass(frozen=True)
class LoopFigures:
    """What closed loops of a tree and of its policy did, in trials that no choice saw.

    Parameters
    ----------
    trials, successes, own_successes : int
        Number of trials, and numbers in which the tree and the policy succeeded, from the same
        starts. A trial succeeds if it arrives at the `target` and stays as asked, or without a
        target if it runs to its end.
    cost, own_cost : float, optional
        Mean costs of the tree and of the policy, over the trials that neither loses; None if there
        are no such trials, or if the mean is not finite.
    low, high : float, optional
        Interval of the mean extra cost of a trial with the tree.
    lost, own_lost : int
        Numbers of lost trials of the tree and of the policy: they left the domain and ended, or
        became not finite.
    switches, own_switches : float
        Switches of the tree and of the policy per time unit.
    visited, agreeing : int
        Number of states that loops of the tree visit, and number of states at which the tree gives
        a symbol of the controller.
    confidence : float
        Confidence of the intervals.
    scale : float
        Factor by which effort and prices are charged.
    duration, rate : float
        Time of a trial [time unit], and its samples per time unit.
    target : bool
        Whether there was a target.
    limit, size : int
        Largest size that was allowed, None for as small as possible, and the size of the tree.
    measure : str
        What the sizes count: ``nodes``, or which bytes.
    """

    trials: int
    successes: int
    own_successes: int
    cost: float | None
    own_cost: float | None
    low: float | None
    high: float | None
    lost: int
    own_lost: int
    switches: float
    own_switches: float
    visited: int
    agreeing: int
    confidence: float
    scale: float
    duration: float
    rate: float
    target: bool
    limit: int | None
    size: int
    measure: str

    def __post_init__(self) -> None:
        plain = vars(self)
        counts = [plain[name] for name in ("successes", "own_successes", "lost", "own_lost")]
        some = ("cost", "own_cost", "low", "high")
        numbers = [plain[name] for name in some if plain[name] is not None]
        numbers += [self.switches, self.own_switches, self.confidence, self.scale]
        numbers += [self.duration, self.rate]
        sizes = [self.size, 1 if self.limit is None else self.limit]
        sound = (
            type(self.trials) is type(self.visited) is type(self.agreeing) is int
            and 0 < self.trials < 2**53
            and all(type(count) is int and 0 <= count <= self.trials for count in counts)
            and all(type(value) in (int, float) and abs(value) < math.inf for value in numbers)
            and 0 <= self.agreeing <= self.visited < 2**53
            and self.rate > 0 < self.duration
            and min(self.switches, self.own_switches, self.scale) >= 0
            and 0 < self.confidence < 1
            and type(self.target) is bool
            and all(type(size) is int and 1 <= size < 2**53 for size in sizes)
            and isinstance(self.measure, str)
            and len(self.measure) <= 80
            and self.measure.isprintable()
        )
        if not sound:
            raise ProblemError(f"the closed loops of a tree do not make sense: {plain}")

    @property
    def success(self) -> float:
        """Share of the trials in which the tree succeeded."""
        return self.successes / self.trials

    @property
    def own_success(self) -> float:
        """Share of the trials in which the policy succeeded."""
        return self.own_successes / self.trials

    @property
    def agreement(self) -> float:
        """Share of the visited states at which the tree agrees with the controller, or NaN."""
        return self.agreeing / self.visited if self.visited else float("nan")

    @property
    def ratio(self) -> float:
        """Mean cost of the tree divided by that of the policy; infinite if one is not known."""
        before, after = (math.inf if x is None else x for x in (self.own_cost, self.cost))
        return cost_ratio(before, after)

    @property
    def fits(self) -> bool:
        """Whether the tree is no larger than allowed."""
        return self.limit is None or self.size <= self.limit

    @property
    def near(self) -> bool:
        """Whether the tree loses at most `LOSS` against the policy, in success and in cost.

        The share of lost loops may also grow by at most `LOSS`.
        """
        enough = self.success >= (1 - LOSS) * self.own_success
        kept = self.lost - self.own_lost <= LOSS * self.trials
        return enough and kept and self.ratio <= 1 + LOSS

    @property
    def text(self) -> str:
        """The figures of the loops in words."""
        low, high = clopper_pearson(self.successes, self.trials, self.confidence)
        done = "succeeds in" if self.target else "goes on to the end in"
        success = (
            f"{done} {_percent(self.success)} of {self.trials:,} closed loops ({_percent(low)} to "
            f"{_percent(high, up=True)} with {self.confidence:.0%} confidence), the policy in "
            f"{_percent(self.own_success)}"
        )
        cost = "no mean cost"
        if self.cost is not None and self.own_cost is not None:
            change = ""
            if self.low is not None and self.high is not None:
                change = f" ({self.low:+.3g} to {self.high:+.3g})"
            cost = f"mean cost {self.cost:.4g}{change}, the policy's {self.own_cost:.4g}"
        if not self.visited:
            return f"{success}; {cost}"
        agrees = f"agrees at {_percent(self.agreement)} of the states that its loops visit"
        return f"{success}; {cost}; {agrees}"


@dataclass(frozen=True)
class Guarantee:
    """How a decision tree compares with the policy that it was made from.

    For a policy that remembers, the comparison is about rows: the next symbol for each symbol in
    force. "The same symbol" then means the same for every symbol in force, including the default
    control. "Another symbol" means another for any of them. The comparison of rows is stricter than
    `capsyn.agreement`, which takes the mean over the symbols in force.

    Parameters
    ----------
    mode : "exact", "freedom" or "linear"
        ``exact``: every state has the policy's symbol. ``freedom``: every state of a cell whose
        test points agreed has the policy's symbol, and every other state has a symbol that was seen
        in its cell. The guarantees of both modes are proved cell by cell. ``linear``: no single
        state is sure, see `agreeing`.
    source : str
        SHA-256 of the policy's content, as in its file.
    level : int, optional
        Level below which cells were merged first. Modes and proofs are about the merged cells.
    changed : float
        Share of the volume in which the symbol differs from the policy's. The share is proved,
        except for ``linear``, where it is estimated at the `states`.
    controller : "ssac", "function", "policy" or ""
        What the tree was judged against: sSAC with the policy's own model, a given function, or the
        policy itself.
    states, agreeing : int
        Number of random states that neither fitted nor chose the tree, and number of states at
        which the tree gives a symbol of the controller.
    target : float, optional
        The agreement that was asked for.
    cut : bool
        Whether exogenous inputs were fixed after the tree was judged. Shares are then those of the
        whole tree.
    loop : LoopFigures, optional
        Figures of the closed loops that judged the tree.
    lost : dict of name to two shares
        Symbols, or the default control, that the tree loses: their share of the volume is 0, or at
        most half of their share in the policy. The shares are the policy's, then the tree's.
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
    loop: LoopFigures | None = None
    lost: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        one_of("mode", self.mode, list(MODES))
        true_or_false("cut", self.cut)
        if self.loop is not None and not isinstance(self.loop, LoopFigures):
            raise ProblemError(f"`loop` must be LoopFigures; got {describe(self.loop)}")
        one_of("controller", self.controller, ["", "ssac", "function", "policy"])
        shares = [self.changed] + ([] if self.target is None else [self.target])
        if isinstance(self.lost, dict):
            keep(self, lost={k: tuple(v) if is_list(v, 2) else v for k, v in self.lost.items()})
        sound = (
            isinstance(self.source, str)
            and len(self.source) == 64
            and set(self.source) <= set("0123456789abcdef")
            and all(type(share) in (int, float) and 0 <= share <= 1 for share in shares)
            and type(self.states) is type(self.agreeing) is int
            and 0 <= self.agreeing <= self.states < 2**53
            and (self.states > 0) == (self.controller != "")
            and (self.level is None or (type(self.level) is int and 0 <= self.level < 64))
            and isinstance(self.lost, dict)
            and all(_is_loss(name, shares) for name, shares in self.lost.items())
        )
        if not sound:
            raise ProblemError(
                f"the guarantee of a tree does not make sense: {describe(vars(self))}"
            )

    @property
    def agreement(self) -> float:
        """Share of the judging states at which the tree agrees with the controller, or NaN."""
        return self.agreeing / self.states if self.states else float("nan")

    @functools.cached_property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval (`CONFIDENCE`) of the share of the volume that agrees.

        The interval is (0, 1) if the tree was judged at no states.
        """
        if not self.states:
            return 0.0, 1.0
        return clopper_pearson(self.agreeing, self.states, CONFIDENCE)

    @property
    def low(self) -> float:
        """Lower end of the interval of the agreement."""
        return self.interval[0]

    @property
    def high(self) -> float:
        """Upper end of the interval of the agreement."""
        return self.interval[1]

    @property
    def reached(self) -> bool:
        """Whether the tree reached its goal: the interval is above the target, if there is one.

        A tree that closed loops judged must instead fit its budget and lose little against the
        policy.
        """
        if self.loop is not None:
            return self.loop.fits and self.loop.near
        return self.target is None or self.low >= self.target

    @property
    def text(self) -> str:
        """The guarantee in one sentence, with shares rounded to the careful side."""
        whole = "; stated of the whole, before exogenous inputs were fixed" if self.cut else ""
        loop = "" if self.loop is None else f"; {self.loop.text}"
        return self._text() + loop + whole

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

    @property
    def lost_text(self) -> str:
        """What symbols the tree loses, with both shares, and what may keep them; or nothing."""
        if not self.lost:
            return ""
        several = (f"{k} from {_percent(a)} to {_percent(b)}" for k, (a, b) in self.lost.items())
        advice = "ask for a higher `agreement`, or let closed loops judge (`judge` 'loop')"
        if self.loop is not None:
            advice = "closed loops judged it without them"
        elif self.level is not None:
            advice = "cut off at a deeper `level`"
        return (
            "the tree gives some symbols half as often as the policy, or never: "
            f"{', '.join(several)} of the volume; {advice}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the guarantee as plain data; `cut`, `loop`, `lost` only if there is something."""
        plain = {f.name: getattr(self, f.name) for f in fields(self)}
        plain["loop"] = None if self.loop is None else asdict(self.loop)
        plain["lost"] = {name: list(shares) for name, shares in self.lost.items()}
        return {k: v for k, v in plain.items() if k not in ("cut", "loop", "lost") or v}

    @staticmethod
    def from_json(plain: dict[str, Any]) -> Guarantee:
        """Return the guarantee from the plain `data` of `to_json`."""
        loop = {"loop": LoopFigures(**plain["loop"])} if "loop" in plain else {}
        return Guarantee(**plain | loop)


def _is_loss(name: Any, shares: Any) -> bool:
    """Return whether a name and a pair of shares may be those of a symbol that is lost."""
    return (
        isinstance(name, str)
        and name.isprintable()
        and is_list(shares, 2)
        and all(type(share) in (int, float) for share in shares)
        and 0 <= 2 * shares[1] <= shares[0] <= 1
        and shares[0] > 0
    )


def _percent(share: float, up: bool = False) -> str:
    """Return a share as text, rounded down or up, with two digits or as many as tell it from 1."""
    if share in (0.0, 1.0):
        return f"{share:.2%}"
    digits = 2 + max(0, math.ceil(-math.log10(min(share, 1 - share))) - 3)
    scale = 10.0 ** (digits + 2)
    rounded = math.ceil(share * scale - 1e-9) if up else math.floor(share * scale + 1e-9)
    return f"{rounded / scale:.{digits}%}"
