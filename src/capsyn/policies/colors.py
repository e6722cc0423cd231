"""Looks of symbols: a colour for each, and marks over the colour if there are many symbols."""

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
    """The look of a symbol in all pictures, in notebooks and on the page of its policy.

    Parameters
    ----------
    color : str
        The colour ``#rrggbb`` of the symbol's cells.
    marks : int
        The marks that are drawn over the cells: a place in `tiles`, 0 for no marks.
    """

    color: str
    marks: int

    @property
    def ink(self) -> str:
        """The colour of the marks, which can be seen on `color`."""
        return ink_on(self.color)


def symbol_looks(count: int) -> list[Look]:
    """Return the looks of `count` symbols; up to 256 looks are all different.

    The first eight symbols have the colours of `PALETTE` without marks. Each further eight symbols
    have one kind of marks, and begin one colour later. Symbols whose numbers differ by one power of
    2 therefore differ in colour. In an alphabet of on/off settings, such symbols differ in one
    input only.
    """
    shades, kinds = len(PALETTE), len(tiles())
    return [
        Look(PALETTE[(k + k // shades + k // shades**2) % shades], k // shades % kinds)
        for k in range(count)
    ]


def symbol_colors(count: int) -> list[str]:
    """Return the colours of `count` symbols; only eight colours differ without marks."""
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
