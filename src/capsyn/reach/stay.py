"""Staying: a set of states that the loop comes back to for ever, and how far it strays."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from capsyn.reach.arrive import inside
from capsyn.reach.kernel import PROVED, Cells, Follower
from capsyn.reach.loop import SampledLoop

FINENESS, FINEST = 4096, 1 << 20
"""Cells of a grid, roughly, by all axes together; at first, and most."""
FEW = 256
"""Members of a set for which a grid with cells half as wide is taken."""
FIRST_HORIZON, LONGEST_HORIZON = 32, 8192
"""Samples from one set to its image."""
EFFORT = 200_000
"""Most pieces that flow for a cell."""
MARGIN = 0.25
"""Share by which a grid is wider than the set it is for, on either side."""
SHRUNK = 0.6
"""Share of a grid's width below which the next grid is narrower."""
SETTLED = 0.97
"""Share of the last ripple, and rate of switches, from which the next is not worth more work."""
ROUNDS, UNIONS = 80, 3
"""Most images, and how often in turn cells that are new are added to a set."""


@dataclass(frozen=True, eq=False)
class Staying:
    """A set that the loop stays in."""

    swing: tuple[np.ndarray, np.ndarray]  # (n,), (n,): between what it stays once it has arrived
    ripple: tuple[np.ndarray, np.ndarray]  # (n,), (n,): and in the end
    switch_rate: float  # most changes of the label, in the long run [1 / time unit]


def stay(loop: SampledLoop, threads: int, deadline: float) -> Staying | None:
    """Return what the loop does for ever from the target; None where nothing is proved.

    The sets of a sequence each hold the image of the one before, after a number of samples. Once
    one holds its own image, loops return to it for ever, and on the way are in its tube.
    """
    cells = _grid(loop.space.lower, loop.space.upper, loop)
    lower, upper = cells.boxes(np.arange(cells.total))
    _, meets = inside(loop.target, lower, upper)
    if not meets.any():
        return None
    cells = _grid(lower[meets].min(axis=0), upper[meets].max(axis=0), loop)
    lower, upper = cells.boxes(np.arange(cells.total))
    _, meets = inside(loop.target, lower, upper)
    search = _Search(loop, threads, deadline, cells, np.tile(meets, (loop.layers, 1)))
    if not search.close():
        return None
    swing = search.met
    return search.settle((swing[0], swing[1]))


@dataclass
class _Search:
    """For members (layers, K) of a grid that hold their own image after a horizon."""

    loop: SampledLoop
    threads: int
    deadline: float
    cells: Cells
    members: np.ndarray
    horizon: int = FIRST_HORIZON
    switches: int = 0  # most in that time

    def __post_init__(self) -> None:
        n = self.loop.space.n
        self.met = np.stack([np.full(n, np.inf), np.full(n, -np.inf)])

    def close(self) -> bool:
        """Go from image to image until one lies in its set; whether it does."""
        grid, unions = self.cells, 0
        for _ in range(ROUNDS):
            found = self.image(grid, self.horizon, 0)
            if found is None:
                return False
            image, low, high, self.switches = found
            self.met = np.stack([np.minimum(self.met[0], low), np.maximum(self.met[1], high)])
            same = grid is self.cells
            new = image & ~self.members if same else image
            if same and not new.any():
                return True
            if same and new.sum() < 0.1 * self.members.sum() and unions < UNIONS:
                self.members, unions = self.members | image, unions + 1
                continue
            lower, upper = grid.boxes(np.flatnonzero(image.any(axis=0)))
            least, most = lower.min(axis=0), upper.max(axis=0)
            self.members, self.cells, unions = image, grid, 0
            if ((most - least) < SHRUNK * (grid.upper - grid.lower)).any():
                grid = _grid(least, most, self.loop)
            elif same:
                self.horizon *= 2
                if self.horizon > LONGEST_HORIZON:
                    return False
        return False

    def settle(self, swing: tuple[np.ndarray, np.ndarray]) -> Staying:
        """Follow the set for longer; what happens from one return to the next bounds the ripple.

        Loops return after K to K + D samples, where D is the longest hold: each sample is K to 2 K
        + 2 D after some return. What is met then bounds the ripple.
        """
        begun = 0 if self.loop.layered else 1  # the label in force is not known then
        rate = (self.switches + begun) / (self.horizon * self.loop.period)
        best, first = Staying(swing, swing, rate), True
        hold = int(self.loop.holds.max())
        while True:
            grid = self.cells
            finer = 2**self.loop.space.n * grid.total
            if self.members.any(axis=0).sum() < FEW and finer <= FINEST:
                grid = Cells(grid.lower, grid.upper, 2 * grid.counts)
            horizon = 2 * (self.horizon + hold)
            found = None
            if horizon <= LONGEST_HORIZON or first:
                found = self.image(grid, horizon, self.horizon)
            if found is None:
                return best
            image, low, high, switches = found
            rate = min(switches / (self.horizon * self.loop.period), best.switch_rate)
            low, high = np.maximum(low, best.ripple[0]), np.minimum(high, best.ripple[1])
            last, best = best, Staying(swing, (low, high), rate)  # all that is proved holds
            before = last.ripple[1] - last.ripple[0]
            if (
                not first
                and (high - low > SETTLED * before).all()
                and rate > SETTLED * last.switch_rate
            ):
                return best
            first = False
            kept = _within(image, grid, self.members, self.cells)
            self.members, self.cells, self.horizon = image, grid, horizon
            if not kept and not self.close():  # holds may shift when they return
                return best

    def image(
        self, grid: Cells, horizon: int, record: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, int] | None:
        """Return the cells (layers, K) of a grid in which loops from the members end.

        With them least and greatest states (n,) from sample `record` on, and most switches; None
        where a loop cannot be followed, or ends outside the grid.
        """
        loop, n = self.loop, self.loop.space.n
        follower = Follower.build(loop, grid, self.threads, self.deadline)
        layer, cell = np.nonzero(self.members)
        lower, upper = self.cells.boxes(cell)
        held = layer if loop.layered else np.full_like(layer, loop.labels - 1)
        low, high, most = np.full(n, np.inf), np.full(n, -np.inf), 0
        size = max(1, len(held) // 20)
        for part in (slice(k, k + size) for k in range(0, len(held), size)):
            if time.monotonic() > self.deadline:
                return None
            found = follower.follow(lower[part], upper[part], held[part], EFFORT, horizon, record)
            if (found.status != PROVED).any():
                return None
            low = np.minimum(low, found.lower.min(axis=0))
            high = np.maximum(high, found.upper.max(axis=0))
            most = max(most, int(found.switches.max()))
        return follower.marks.astype(bool), low, high, most


def _within(image: np.ndarray, grid: Cells, members: np.ndarray, cells: Cells) -> bool:
    """Return whether an image is in a set, of the same cells or of ones that halve their widths."""
    factor = int(grid.counts[0] // cells.counts[0])
    whole = members.reshape(len(members), *cells.counts)
    for axis in range(1, whole.ndim):
        whole = whole.repeat(factor, axis=axis)
    return not (image & ~whole.reshape(image.shape)).any()


def _grid(lower: np.ndarray, upper: np.ndarray, loop: SampledLoop) -> Cells:
    """Return a grid around a box, within the domain, or all of a periodic axis."""
    space = loop.space
    margin = MARGIN * (upper - lower)
    whole = np.array(space.periodic) & (upper - lower + 2 * margin >= space.widths)
    inner = (
        np.where(space.periodic, -np.inf, space.lower),
        np.where(space.periodic, np.inf, space.upper),
    )
    lower = np.where(whole, space.lower, np.maximum(lower - margin, inner[0]))
    upper = np.where(whole, space.upper, np.minimum(upper + margin, inner[1]))
    count = round(FINENESS ** (1 / space.n))
    return Cells(lower, upper, np.full(space.n, count))
