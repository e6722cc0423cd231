"""What a closed loop did in equal pieces of time: shares of symbols, means and ranges of inputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def piece_starts(samples: int, pieces: int) -> np.ndarray:
    """Return the first samples of at most so many pieces of a loop, as equal as can be."""
    return np.arange(min(pieces, samples)) * samples // max(1, min(pieces, samples))


def symbol_shares(symbols: np.ndarray, starts: np.ndarray) -> dict[int, np.ndarray]:
    """Return the share of each piece's samples that each symbol of (K,) holds, ascending."""
    lengths = np.diff(np.append(starts, len(symbols)))
    return {
        label: np.add.reduceat((symbols == label).astype(float), starts) / lengths
        for label in np.unique(symbols).tolist()
    }


def stacked(shares: dict[int, np.ndarray], rows: int) -> np.ndarray:
    """Return shares (P,) of labels as columns (rows, P), the first label lowest."""
    tops = np.cumsum(list(shares.values()), axis=0)
    heights = (np.arange(rows) + 0.5) / rows
    above = (tops[:, None, :] <= heights[:, None] * tops[-1]).sum(axis=0)
    found: np.ndarray = np.array(list(shares))[np.minimum(above, len(shares) - 1)]
    return found


@dataclass(frozen=True, eq=False)
class Drawn:
    """An input over time as it is drawn.

    Parameters
    ----------
    values : (K,)
        Its values [input unit], where it chatters the mean of the piece.
    starts : (P,)
        The first samples of the pieces in which it chatters.
    ends : (P,)
        Their last samples, and one.
    low, high : (P,)
        What it spans there [input unit].
    """

    values: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    low: np.ndarray
    high: np.ndarray


def input_pieces(values: np.ndarray, pieces: int) -> Drawn:
    """Return an input (K,) as it is drawn in so many pieces.

    It chatters in a piece in which it changes three times or more, or twice beside another, and in
    one beside these in which it changes. A single pulse is none of these.
    """
    samples = len(values)
    starts = piece_starts(samples, pieces)
    ends = np.append(starts[1:], samples)
    changed = np.append(False, values[1:] != values[:-1])
    changed[starts] = False  # within pieces alone
    changes = np.add.reduceat(changed.astype(int), starts)
    many = (changes > 2) | (changes > 1) & _beside(changes > 1)
    many |= (changes > 0) & _beside(many)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    lengths = ends - starts
    means = np.add.reduceat(values, starts) / lengths
    shown = np.where(np.repeat(many, lengths), np.repeat(means, lengths), values)
    return Drawn(shown, starts[many], ends[many], low[many], high[many])


def _beside(some: np.ndarray) -> np.ndarray:
    """Return which pieces are beside one of some."""
    padded = np.pad(some, 1)
    found: np.ndarray = padded[:-2] | padded[2:]
    return found


def input_of_all(values: np.ndarray, pieces: int) -> Drawn:
    """Return an input of many loops (B, K), NaN after their ends, as one is drawn.

    It is the mean over each piece and all loops that have not ended, in the range of these.
    """
    samples = values.shape[1]
    starts = piece_starts(samples, pieces)
    ends = np.append(starts[1:], samples)
    known = np.isfinite(values)
    count = np.add.reduceat(known.sum(axis=0), starts)
    total = np.add.reduceat(np.where(known, values, 0.0).sum(axis=0), starts)
    means = np.divide(total, count, out=np.full(len(starts), np.nan), where=count > 0)
    low = np.minimum.reduceat(np.where(known, values, np.inf).min(axis=0), starts)
    high = np.maximum.reduceat(np.where(known, values, -np.inf).max(axis=0), starts)
    some = count > 0
    return Drawn(np.repeat(means, ends - starts), starts[some], ends[some], low[some], high[some])
