"""Affine rows of cells, fitted to the scores at their test points and rounded to integers."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from capsyn.cells.affine_leaves import LARGEST_SLOPE, LARGEST_SUM, PriceRatios
from capsyn.cells.masks import holds, members
from capsyn.subdivision.split_axes import SplitAxes

CENTER_WEIGHT = 0.5
"""Weight of the centre in a fit, all other fixed points having the rest: vertices alone see a
square term x^2 as 1 throughout the cell, where its mean is 1/3."""
BEYOND = 1.01
"""How much more than any difference of rows in its cell a price need be."""
TINY = 1e-300
"""Least size of scores."""
NO_PRICES = np.zeros((1, 1), dtype=np.int16)
"""Ratios where nothing is in force: no price for any symbol."""
TRIES = 8
"""Steps of the perceptron that corrects rows fitted to labels."""


@dataclass(frozen=True, eq=False)
class Fits:
    """Affine rows of M cells for S symbols, in integers, and how well they do."""

    constants: np.ndarray  # (M, S)
    slopes: np.ndarray  # (M, S, n): the rows, see `AffineLeaves`
    used: np.ndarray  # (M, S) bool: which rows are the largest anywhere in their cell
    wrong: np.ndarray  # (M,): share of the test points whose symbol is wrong
    error: np.ndarray  # (M,): estimated share of the cell where the symbol is wrong
    price: np.ndarray  # (M,): what a ratio of prices takes off, in the rows' whole numbers
    axes: np.ndarray  # (M, n) bool: along which axes the cell is split where that is too much

    def better(self, other: Fits) -> Fits:
        """Return for each cell the rows with fewer wrong points, of equals with less error."""
        mine = (self.wrong < other.wrong) | (
            (self.wrong == other.wrong) & (self.error <= other.error)
        )
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(Fits))
        return Fits(*(np.where(mine.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs))


def point_weights(offsets: np.ndarray, plain: bool = False) -> np.ndarray:
    """Return the weights (P,) of fixed test points (P, n), in halves of the cell."""
    center = (offsets == 1).all(axis=1)
    if plain or not center.any() or center.all():
        return np.full(len(offsets), 1 / len(offsets))
    others = np.count_nonzero(~center)
    return np.where(center, CENTER_WEIGHT, (1 - CENTER_WEIGHT) / others)


def fit_cells(
    scores: np.ndarray,
    masks: np.ndarray,
    offsets: np.ndarray,
    places: np.ndarray,
    corners: np.ndarray,
    size: np.ndarray,
    counts: tuple[int, ...],
    plain: bool = False,
    split_axes: SplitAxes | None = None,
    can: np.ndarray | None = None,
    prices: PriceRatios | None = None,
) -> Fits:
    """Return the affine rows of cells: of each, those of the variant of scores that do best.

    The scores (P, M, V, S) of the symbols at the cells' test points are in V variants; the largest
    of the first is best. `masks` (P, M, J, W) are the sets of symbols that are right there, for
    each label in force where there are `prices` on switching, which scores pay; `places` (P, M, n)
    are the lattice steps, within the cell, that hold the points or are nearest to them. Rows are
    fitted to the first points, at `offsets` (F, n) in halves of the cell: a layout that is
    symmetric about the centre, along every axis. `corners` and `size` (M, n) are those of the
    cells, `counts` (n,) the edge lengths of the lattice [lattice steps].

    Where scores are `plain`, mere indicators of labels, rows that mistake a label are corrected.
    Cells are split along the axes that `split_axes` chooses among those (M, n) along which they
    `can` be; without it, along all.

    In coordinates of -1 to 1, fixed points are orthogonal, so that least squares are weighted sums.
    The estimated error is the weighted mean over the test points of ``min(1, rho / margin)^2``
    (Chebyshev's inequality), with `margin` the difference of the two largest rows there and `rho`
    the root mean square of its error.
    """
    largest = np.abs(scores).max(axis=(0, 3))
    scores = scores / np.where(largest > 0, largest, 1.0)[:, :, None]  # any size: no overflow
    fixed, signs, weights = len(offsets), offsets - 1, point_weights(offsets, plain)
    kept: Fits | None = None
    for variant in range(scores.shape[2]):
        some = scores[:, :, variant]
        levels, slopes = _least_squares(some[:fixed], signs, weights)
        if plain:
            levels, slopes = _corrected(levels, slopes, masks[:fixed, :, -1], signs)
        axes = np.ones(corners.shape, dtype=bool)
        if split_axes is not None and can is not None:
            fitted = levels + np.einsum("msi,pi->pms", slopes, signs)
            axes = split_axes.by_residuals(some[:fixed] - fitted, can)
        ratios, unit = NO_PRICES.repeat(scores.shape[3], axis=1), np.zeros(len(corners))
        if prices is not None:
            ratios = prices.ratios[:, : scores.shape[3]]
            unit = prices.unit / np.maximum(largest[:, variant], TINY)
        paid = ratios[ratios > 0]
        span = (int(paid.min()), int(paid.max())) if paid.size else (1, 1)
        rows = _rounded(levels, slopes, corners, size, counts, unit, span)
        fits = _judged(some, masks, offsets, places, corners, size, rows, ratios, axes)
        kept = fits if kept is None else kept.better(fits)
    assert kept is not None
    return kept


_Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Constants (M, S), slopes (M, S, n), the scales (M,) that they are rounded with, and what a ratio
of prices comes to (M,)."""


def _judged(
    scores: np.ndarray,
    masks: np.ndarray,
    offsets: np.ndarray,
    places: np.ndarray,
    corners: np.ndarray,
    size: np.ndarray,
    rows: _Rows,
    ratios: np.ndarray,
    axes: np.ndarray,
) -> Fits:
    """Return rows with what they do at the test points, for scores (P, M, S).

    `ratios` (J, S) are those of prices, of each label in force. The margin of a point is that of
    the label in force where it is least.
    """
    constants, slopes, scale, price = rows
    corner_values = constants + np.einsum("msi,mi->ms", slopes, corners)
    shape = masks.shape[:2]
    wrong = np.zeros(shape, dtype=bool)
    margin, residual = np.full(shape, np.inf), np.zeros(shape)
    for p in range(shape[0]):
        unpriced = corner_values + np.einsum("msi,mi->ms", slopes, places[p])
        for j, ratio in enumerate(ratios):
            best, gap, rest = _two_best(unpriced, scores[p], scale, price, ratio, j)
            nearer = gap < margin[p]
            margin[p] = np.where(nearer, gap, margin[p])
            residual[p] = np.where(nearer, rest, residual[p])
            wrong[p] |= ~holds(masks[p, :, j], best)
    shares = point_weights(offsets)
    if shape[0] > len(offsets):
        shares = np.full(shape[0], 1 / shape[0])
    rho = np.sqrt(np.einsum("pm,p->m", residual**2, shares))
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.minimum(1.0, np.where(rho > 0, rho / margin, 0.0))
    error = np.einsum("pm,p->m", reach**2, shares)
    used = _used(constants, slopes, corners, size, price, ratios)
    return Fits(constants, slopes, used, wrong.mean(axis=0), error, price, axes)


def _two_best(
    values: np.ndarray,
    scores: np.ndarray,
    scale: np.ndarray,
    price: np.ndarray,
    ratio: np.ndarray,
    label: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the symbols (M,) that follow a label, and by how much their rows beat the second.

    `values` (M, S) are those of the rows, `ratio` (S,) the label's prices. The margins (M,) are in
    scores (M, S); after them comes what these differ by from them.
    """
    cells = np.arange(len(values))
    lowest = np.iinfo(np.int64).min
    values = np.where(ratio < 0, lowest, values - price[:, None] * np.maximum(ratio, 0))
    best = values.argmax(axis=1)
    if label < values.shape[1]:  # which stays where it ties
        best = np.where(values[:, label] == values[cells, best], label, best)
    top = values[cells, best]
    values[cells, best] = lowest
    second = values.argmax(axis=1)
    margin = (top - values[cells, second]) / scale
    paid = (price / scale) * (ratio[best] - ratio[second])
    residual = scores[cells, best] - scores[cells, second] - paid - margin
    alone = values[cells, second] == lowest  # none other may follow
    return best, np.where(alone, np.inf, margin), np.where(alone, 0.0, residual)


def _least_squares(
    scores: np.ndarray, signs: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return values at the centre (M, S) and slopes (M, S, n); `signs` are -1 to 1, (P, n)."""
    levels = np.zeros(scores.shape[1:])
    slopes = np.zeros((*levels.shape, signs.shape[1]))
    strength = weights @ signs**2
    for here, sign, weight in zip(scores, signs, weights):
        levels += weight * here
        for i in np.flatnonzero(sign):
            slopes[:, :, i] += (weight * sign[i] / strength[i]) * here
    return levels, slopes


def _corrected(
    levels: np.ndarray, slopes: np.ndarray, masks: np.ndarray, signs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows with fewest mistakes at the test points among those that a perceptron finds."""
    cells, symbols = levels.shape
    right = members(masks, symbols)
    extended = np.column_stack([np.ones(len(signs)), signs])
    rows = np.concatenate([levels[:, :, None], slopes], axis=2)
    kept, fewest = rows.copy(), np.full(cells, len(signs) + 1)
    for _ in range(TRIES + 1):
        values = np.einsum("msi,pi->pms", rows, extended)
        mistaken = values.argmax(axis=2)
        wrong = ~np.take_along_axis(right, mistaken[:, :, None], axis=2)[:, :, 0]
        count = wrong.sum(axis=0)
        better = count < fewest
        kept[better], fewest[better] = rows[better], count[better]
        wanted = np.where(right, values, -np.inf).argmax(axis=2)
        p, m = np.nonzero(wrong)
        if not p.size:
            break
        step = extended[p] / len(signs)
        np.add.at(rows, (m, wanted[p, m]), step)
        np.add.at(rows, (m, mistaken[p, m]), -step)
    return kept[:, :, 0], kept[:, :, 1:]


def _rounded(
    levels: np.ndarray,
    slopes: np.ndarray,
    corners: np.ndarray,
    size: np.ndarray,
    counts: tuple[int, ...],
    unit: np.ndarray,
    span: tuple[int, int],
) -> _Rows:
    """Return rows as integers: constants (M, S), slopes (M, S, n), and their scales (M,).

    Last come the prices (M,) of a ratio of 1, a `unit` (M,) in scores, or less where the least
    ratio of the `span` is more than rows differ by in the cell; what the largest comes to fits as
    sums do.

    Only differences of rows count: their mean is taken off first. A row stands for the centres of
    the lattice steps.
    """
    levels = levels - levels.mean(axis=1, keepdims=True)
    per_step = 2 * (slopes - slopes.mean(axis=1, keepdims=True)) / size[:, None, :]
    middle = corners + (size - 1) / 2
    lattice = np.array(counts, dtype=float)
    constants = levels - np.einsum("msi,mi->ms", per_step, middle)
    sums = np.abs(constants) + np.einsum("msi,i->ms", np.abs(per_step), lattice)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        scale = np.minimum(
            (LARGEST_SUM - lattice.sum() - 2) / sums.max(axis=1),
            LARGEST_SLOPE / np.abs(per_step).max(axis=(1, 2)),
        )
        reach = np.ptp(levels, axis=1) + 2 * np.abs(slopes).max(axis=1).sum(axis=1)
        least, largest = span
        unit = np.minimum(unit, BEYOND * reach / least)
        scale = np.minimum(scale, (LARGEST_SUM - largest) / (unit * largest))
    flat = ~((scale > 0) & np.isfinite(scale))  # scores that are all alike
    scale[flat], levels[flat], per_step[flat] = 1.0, 0.0, 0.0
    whole = np.rint(per_step * scale[:, None, None])
    constants = np.rint(levels * scale[:, None] - np.einsum("msi,mi->ms", whole, middle))
    price = np.minimum(np.rint(unit * scale), LARGEST_SUM // largest).astype(np.int64)
    return constants.astype(np.int64), whole.astype(np.int64), scale, price


def _used(
    constants: np.ndarray,
    slopes: np.ndarray,
    corners: np.ndarray,
    size: np.ndarray,
    price: np.ndarray,
    ratios: np.ndarray,
) -> np.ndarray:
    """Return which rows (M, S) no other row beats everywhere in the cell, whatever is in force."""
    symbols = constants.shape[1]
    used = np.ones(constants.shape, dtype=bool)
    for i in range(symbols):
        difference = slopes[:, i, None] - slopes
        most = constants[:, i, None] - constants
        most = most + np.einsum("msi,mi->ms", difference, corners)
        most = most + np.einsum("msi,mi->ms", np.maximum(difference, 0), size - 1)
        # what it must beat the other by at least, of equals the first: one that is in force is kept
        lead = np.where(np.arange(symbols) < i, 1, 0)
        if len(ratios) > 1:
            some = ratios[ratios[:, i] >= 0].astype(np.int64)
            lead = price[:, None] * (some[:, i, None] - some).min(axis=0)
            lead[:, (some < 0).any(axis=0)] = np.iinfo(np.int64).min
        beats = most >= lead
        beats[:, i] = True
        used[:, i] = beats.all(axis=1)
    return used
