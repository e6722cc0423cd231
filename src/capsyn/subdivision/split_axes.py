"""Along which axes a cell is split whose test points do not agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.cells.row_table import whole

SHARE = 0.8
"""An axis is split where what varies along it is at least this share of what varies most."""
EVEN = 0.5
"""All axes are split where what varies most is less than this share of what the centre shows."""


@dataclass(frozen=True, eq=False)
class SplitAxes:
    """Test points of a cell that differ along one axis only, by their places."""

    pairs: list[np.ndarray]  # n of (K, 2): points on opposite faces
    triples: list[np.ndarray]  # n of (K, 3): those that have another half-way, which stands second
    center: np.ndarray  # (K,): the centre, if any
    vertices: np.ndarray  # (K,)

    @staticmethod
    def of(offsets: np.ndarray) -> SplitAxes:
        """Return those of fixed test points (P, n), in halves of the cell."""
        place = {tuple(point): k for k, point in enumerate(offsets.tolist())}
        pairs: list[np.ndarray] = []
        triples: list[np.ndarray] = []
        for i in range(offsets.shape[1]):
            lines = [
                [place.get((*point[:i], k, *point[i + 1 :])) for k in (0, 1, 2)]
                for point in place
                if point[i] == 0
            ]
            opposite = [(a, b) for a, _, b in lines if b is not None]
            pairs.append(np.array(opposite, dtype=int).reshape(-1, 2))
            triples.append(np.array([x for x in lines if None not in x], dtype=int).reshape(-1, 3))
        return SplitAxes(
            pairs,
            triples,
            np.flatnonzero((offsets == 1).all(axis=1)),
            np.flatnonzero((offsets != 1).all(axis=1)),
        )

    def by_labels(self, masks: np.ndarray, can: np.ndarray) -> np.ndarray:
        """Return the axes (M, n) along which cells are split, of those along which they `can` be.

        They are those along which labels vary, of sets (P, M, J, W) at the test points: maybe
        none. Where labels vary along none, all of them are.
        """
        varying = np.zeros((masks.shape[1], len(self.pairs)), dtype=bool)
        for i, (pairs, triples) in enumerate(zip(self.pairs, self.triples)):
            for a, b in [*pairs, *triples[:, :2], *triples[:, 1:]]:
                varying[:, i] |= ~whole(masks[a] & masks[b])
        varying[~varying.any(axis=1)] = True
        return varying & can

    def by_residuals(self, residuals: np.ndarray, can: np.ndarray) -> np.ndarray:
        """Return the axes (M, n) along which cells are split, of those along which they `can` be.

        They are those along which the residuals (P, M, S) of affine rows vary most. The rows being
        least squares, what differs between opposite points comes from products of coordinates, and
        what differs from the mean of the two half-way from squares. Without such points squares are
        seen at the centre alone, which does not tell their axes: all are split where they prevail.
        """
        residuals = residuals - residuals.mean(axis=2, keepdims=True)
        varying = np.zeros((residuals.shape[1], len(self.pairs)))
        for i, (pairs, triples) in enumerate(zip(self.pairs, self.triples)):
            if len(pairs):
                low, high = residuals[pairs.T]
                varying[:, i] += np.sqrt(np.mean((high - low) ** 2, axis=(0, 2)))
            if len(triples):
                low, middle, high = residuals[triples.T]
                varying[:, i] += np.sqrt(np.mean((low + high - 2 * middle) ** 2, axis=(0, 2)))
        varying[~can] = 0.0
        most = varying.max(axis=1)
        least = np.zeros(len(most))
        if self.center.size and self.vertices.size and not any(map(len, self.triples)):
            even = residuals[self.center[0]] - residuals[self.vertices].mean(axis=0)
            least = EVEN * np.sqrt(np.mean(even**2, axis=1))
        return can & ((varying >= SHARE * most[:, None]) | (most <= least)[:, None])
