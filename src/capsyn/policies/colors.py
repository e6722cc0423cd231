"""How symbols look: a colour each, and of many symbols marks over it."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#404040")
"""Colours that stay apart under colour blindness: those of Okabe and Ito, with a dark grey in the
place of their black, which is that of lines."""
TILE = 12
"""Marks repeat after so many dots, across and up."""
INKS = ("#111111", "#ffffff")
"""Colours of marks, on light colours and on dark ones."""


@dataclass(frozen=True)
class Look:
    """How a symbol looks everywhere: in pictures, in notebooks and on its page.

    Parameters
    ----------
    color : str
        The colour ``#rrggbb`` of its cells.
    marks : int
        What is drawn over them: a place in `tiles`, 0 for nothing.
    """

    color: str
    marks: int

    @property
    def ink(self) -> str:
        """The colour of the marks: what can be seen on `color`."""
        return ink_on(self.color)


def symbol_looks(count: int) -> list[Look]:
    """Return how `count` symbols look; up to 256 of them are all different.

    The first eight have the colours of `PALETTE` alone, each further eight one kind of marks. Their
    colours begin one later each time, so that symbols whose numbers differ by one power of 2, which
    have all but one input in common in an alphabet of on/off settings, differ in colour.
    """
    shades, kinds = len(PALETTE), len(tiles())
    return [
        Look(PALETTE[(k + k // shades + k // shades**2) % shades], k // shades % kinds)
        for k in range(count)
    ]


def symbol_colors(count: int) -> list[str]:
    """Return the colours of `count` symbols; more than eight need their marks, too."""
    return [look.color for look in symbol_looks(count)]


def ink_on(color: str) -> str:
    """Return which of `INKS` is easier to see on a colour."""
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return INKS[0.299 * red + 0.587 * green + 0.114 * blue < 140]


@functools.cache
def tiles() -> np.ndarray:
    """Return the marks, (32, `TILE`, `TILE`) booleans, the first row at the top.

    The first has none. The others are those that stay farthest apart, lines and dots before what
    takes longer to recognise.
    """
    y, x = np.indices((TILE, TILE))
    odd = (x // 6 + y // 6) % 2 == 1

    def lines(period: int, width: int) -> list[np.ndarray]:
        return [v % period < width for v in (x + y, x - y, y, x)]  # rising, falling, level, upright

    def dots(period: int, outer: float, inner: float = 0.0) -> np.ndarray:
        middle = (period - 1) / 2
        distance = np.hypot(x % period - middle, y % period - middle)
        return (distance >= inner) & (distance <= outer)

    def both(period: int, width: int, first: int) -> np.ndarray:
        one, other = lines(period, width)[first : first + 2]
        return one | other

    plain, diamonds = np.zeros((TILE, TILE), dtype=bool), abs(x - 5.5) + abs(y - 5.5) < 5
    return np.array(
        [
            plain, *lines(6, 2), dots(6, 1.6), both(6, 2, 2), both(6, 2, 0),
            *lines(12, 6), diamonds, both(12, 6, 2), both(12, 5, 0), both(12, 3, 2),
            *lines(12, 3), *lines(4, 2)[2:], dots(12, 4.9, 2.6), ~odd & dots(6, 2.6),
            (abs(x - 6) + y) % 12 < 4, (abs(y - 6) + x) % 12 < 4, dots(4, 1.0), both(4, 1, 2),
            odd & (x % 6 < 3) | ~odd & (y % 6 < 3), *lines(6, 4)[2:], odd,
        ]
    )  # fmt: skip
