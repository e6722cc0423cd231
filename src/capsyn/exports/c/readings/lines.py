"""Whole numbers by which counts become lattice steps: a line, and the few places that leave it.

A line gives the step of a place by ``(place * factor + addend) >> shift``. For a factor M and a
shift S the addend A must hold ``M p + A >= k 2^S`` where step k begins, and ``M p + A < (k + 1)
2^S`` where it ends. How far these bounds on A are apart is concave in M, so that a line which is
right everywhere is found if there is one. Where faces fall on counts there may be none, since
rounding puts each on its own side: then the line that breaks the fewest bounds serves, with a list
of the places whose step is one more or one less. All of this is done in integers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

NONE = 1 << 62
"""Where a bound on addends is none; sums of 64 bits stay below."""
CODE = {"held": 20, "wide": 200, "listed": 200, "table": 60}
"""About what code takes more than that of a line of 32 bits [bytes]: on an AVR, with its library,
where such code is largest."""
FARTHEST = 12
NEAR = (0, *(sign << k for k in range(FARTHEST + 1) for sign in (1, -1)))
"""How far factors that are tried are from the one with the widest room."""
WORK = 1 << 19
"""Runs times factors that are tried, beyond three factors."""


@dataclass(frozen=True)
class Line:
    """Whole numbers that give the steps of places 0 .. top.

    Parameters
    ----------
    factor, addend, shift : int
        The step of a place is ``(place * factor + addend) >> shift``.
    wide : bool
        Whether the sum takes 64 bits, else 32.
    last : int
        Where counts are coarser than steps the last step, else 0: the place 0 has step 0, and
        others ``((place - 1) * factor + addend) >> shift``, at most ``last``.
    less, more : tuple of int
        Places whose step is one less, and one more, ascending.
    """

    factor: int
    addend: int
    shift: int
    wide: bool = False
    last: int = 0
    less: tuple[int, ...] = ()
    more: tuple[int, ...] = ()

    @property
    def listed(self) -> int:
        """Places that leave the line."""
        return len(self.less) + len(self.more)

    @property
    def text(self) -> str:
        """The rule in one line, for a place p."""
        if self.last:
            rule = f"((p - 1) * {self.factor} + {self.addend}) >> {self.shift}"
            rule = f"{rule}, at most {self.last}, and 0 at p = 0"
        else:
            rule = f"(p * {self.factor} + {self.addend}) >> {self.shift}"
        lists = ((len(self.less), "less"), (len(self.more), "more"))
        places = [f"one {what} at {count} listed counts" for count, what in lists if count]
        return ", ".join([rule, *places])


@dataclass(frozen=True)
class Runs:
    """Places of the same step: where each run begins and ends, and its step; (R,) int64 each."""

    begins: np.ndarray
    ends: np.ndarray
    steps: np.ndarray
    held: bool

    @staticmethod
    def of(changes: np.ndarray, top: int, held: bool) -> Runs:
        """Return the runs; places are one less where the first and the last are held."""
        later = np.unique(changes[(changes > 0) & (changes <= top)])
        begins, ends = np.append(0, later), np.append(later - 1, top)
        steps = np.searchsorted(changes, begins, side="right")
        return Runs(begins - held, ends - held, steps, held)

    @property
    def top(self) -> int:
        """The last place."""
        return int(self.ends[-1])

    @property
    def last(self) -> int:
        """The last step."""
        return int(self.steps[-1])

    def addends(self, factor: int, shift: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and the largest addend for each run."""
        least = (self.steps << shift) - factor * self.begins
        most = ((self.steps + 1) << shift) - 1 - factor * self.ends
        if self.held:
            least[0], most[0], most[-1] = -NONE, NONE, NONE
        return least, most

    def widest(self, shift: int) -> int:
        """Return the factor whose addends have the widest room, or lack the least."""

        def room(factor: int) -> int:
            least, most = self.addends(factor, shift)
            return int(most.min()) - int(least.max())

        low, high = 0, ((self.last + 1) << shift) // max(self.top, 1) + 1
        while low < high:
            middle = (low + high) // 2
            if room(middle + 1) > room(middle):
                low = middle + 1
            else:
                high = middle
        return low

    def shifts(self, wide: bool) -> list[int]:
        """Return the shifts that sums allow, and factors of 32 bits."""
        bits = 61 if wide else 32
        return [
            shift
            for shift in range(bits)
            if self.last << shift < 1 << bits
            and ((self.last + 1) << shift) // max(self.top, 1) < (1 << 32) - (2 << FARTHEST)
        ]

    def fits(self, factor: int, addend: int, wide: bool) -> bool:
        """Whether sums and the factor are within their bits."""
        return 0 <= factor < 1 << 32 and factor * self.top + addend < 1 << (62 if wide else 32)


def exact_line(changes: np.ndarray, top: int, wide: bool, held: bool) -> Line | None:
    """Return the line of the least shift that is right at every place, if there is one.

    Parameters
    ----------
    changes : (C - 1,)
        The least place of each step from 1 on, ``top + 1`` where there is none; ascending.
    top : int
        The last place.
    wide, held : bool
        Whether sums take 64 bits, and whether the first and the last place are held; see `Line`.
    """
    runs = Runs.of(changes, top, held)
    shifts = runs.shifts(wide)
    for shift in shifts[-1:] if wide else shifts:
        factor = runs.widest(shift)
        least, most = runs.addends(factor, shift)
        addend = max(int(least.max()), 0)
        if addend <= int(most.min()) and runs.fits(factor, addend, wide):
            return Line(factor, addend, shift, wide, runs.last if held else 0)
    return None


def near_line(changes: np.ndarray, top: int, wide: bool, held: bool) -> Line | None:
    """Return a line that breaks few bounds, with the places that leave it; see `exact_line`."""
    runs, best, fewest = Runs.of(changes, top, held), None, len(changes)
    for shift in reversed(runs.shifts(wide)[-2:]):
        centre = runs.widest(shift)
        count = max(WORK // len(runs.steps), 3)
        for factor in (centre + near for near in NEAR[:count] if centre + near > 0):
            least, most = (np.sort(bound) for bound in runs.addends(factor, shift))
            tried = least.clip(0, None)  # from each on, one bound less is broken
            broken = len(least) - np.searchsorted(least, tried, side="right")
            broken += np.searchsorted(most, tried, side="left")
            addend = int(tried[broken.argmin()])
            if broken.min() < fewest and runs.fits(factor, addend, wide):
                line = Line(factor, addend, shift, wide, runs.last if held else 0)
                if with_lists := _listing(line, changes, top):
                    fewest, best = int(broken.min()), with_lists
        if best:
            break
    return best


def _listing(line: Line, changes: np.ndarray, top: int) -> Line | None:
    """Return the line with the places that are one step off; none where some are farther off.

    The line's own changes are computed, not the steps of all places.
    """
    held, sum_of_top = int(line.last > 0), (top - (line.last > 0)) * line.factor + line.addend
    steps = np.arange(1, (line.last or sum_of_top >> line.shift) + 1)
    own = -((line.addend - (steps << line.shift)) // line.factor) + held
    own = own.clip(held, None)
    begins = np.unique(np.concatenate([[0], own, changes]).clip(0, top))
    off = np.searchsorted(changes, begins, "right") - np.searchsorted(own, begins, "right")
    wrong = np.flatnonzero(off)
    lengths = np.diff(np.append(begins, top + 1))[wrong]
    if (abs(off) > 1).any() or lengths.sum() > len(changes):
        return None
    before = np.repeat(np.cumsum(lengths) - lengths, lengths)
    places = np.repeat(begins[wrong], lengths) + np.arange(lengths.sum()) - before
    signs = np.repeat(off[wrong], lengths)
    less, more = (tuple(places[signs == sign].tolist()) for sign in (-1, 1))
    return replace(line, less=less, more=more)


def line_of(changes: np.ndarray, top: int, coarse: bool, entry: int) -> Line | None:
    """Return the line that takes the fewest bytes; none where a table of changes takes fewer.

    Parameters
    ----------
    changes, top
        See `exact_line`.
    coarse : bool
        Whether the first and the last place may be far from a line, as where counts are coarser
        than steps.
    entry : int
        Bytes of an entry of a table.
    """
    if top >= 1 << 31:
        return None
    plain = exact_line(changes, top, False, False)
    if plain is not None:
        return plain
    kinds = [(wide, held) for wide in (False, True) for held in (False, True)[: 1 + coarse]]
    tried = [exact_line(changes, top, *kind) for kind in kinds]
    if not any(tried):
        tried = [near_line(changes, top, *kind) for kind in kinds]
    lines = [line for line in tried if line is not None]
    best = min(lines, key=lambda line: _bytes(line, entry), default=None)
    if best is None or _bytes(best, entry) >= CODE["table"] + entry * len(changes):
        return None
    return best


def _bytes(line: Line, entry: int) -> int:
    code = CODE["held"] * (line.last > 0) + CODE["wide"] * line.wide
    return code + (CODE["listed"] + entry * line.listed) * (line.listed > 0)
