"""Tables and files of tables for tests; texts are written here, in the format of SCOTS 0.2."""

import numpy as np

from capsyn import Alphabet
from capsyn.sources.table import Table


def grid_text(name, first, step, counts):
    """Return the section of a grid of points."""
    last = [low + h * (k - 1) for low, h, k in zip(first, step, counts)]
    lines = [f"#SCOTS:{name}", "#TYPE:UNIFORMGRID", "#MEMBER:DIM", str(len(first))]
    for vector, values in (("ETA", step), ("LOWER_LEFT", first), ("UPPER_RIGHT", last)):
        lines += [f"#VECTOR:{vector}", f"#BEGIN:{len(values)}", *map(repr, values), "#END"]
    return lines


def scots_text(table, first, step):
    """Return the file of a table whose inputs are the grid ``0, 1, .. N-1``."""
    lines = ["#SCOTS:v0.2", "#TYPE:STATICCONTROLLER"]
    lines += grid_text("STATE_SPACE", first, step, table.counts)
    lines += grid_text("INPUT_SPACE", [0.0], [1.0], [len(table.alphabet)])
    lines += ["#TYPE:WINNINGDOMAIN", "#SCOTS:i (state) j_0 ... j_n (valid inputs)"]
    lines += ["#MATRIX:DATA", f"#BEGIN:{table.masks.size} 1"]
    for state, mask in enumerate(table.masks.ravel(order="F").tolist()):
        inputs = [str(k) for k in range(len(table.alphabet)) if mask >> k & 1]
        if inputs:
            lines.append(" ".join([str(state), *inputs]))
    return "\n".join([*lines, "#END"]) + "\n"


def random_table(counts, symbols=3, gaps=True, several=True, seed=0, **names):
    """Return a table of smooth regions with noise, with or without gaps and choices."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.unravel_index(np.arange(np.prod(counts)), counts), axis=1)
    slope = rng.normal(size=len(counts)) / np.array(counts)
    value = places @ slope + 0.02 * rng.normal(size=len(places))
    order = np.argsort(np.argsort(value))
    labels = order * (symbols + gaps) // len(order)
    masks = np.where(labels == symbols, 0, 1 << labels).astype(np.uint64)
    if several:
        free = (rng.random(len(masks)) < 0.3) & (masks != 0)
        masks[free] |= (1 << rng.integers(symbols, size=free.sum())).astype(np.uint64)
    first, step = rng.normal(size=len(counts)), 0.1 + rng.random(len(counts))
    alphabet = Alphabet(np.arange(symbols))
    return Table(first, step, masks.reshape(counts), alphabet, **names)


def assert_same(policy, table):
    """Compare a policy with a table at all points: what is outside, and the symbols elsewhere."""
    points, symbols = table.points(), table.symbols.ravel()
    np.testing.assert_array_equal(policy.covers(points), symbols >= 0)
    for backend in ("numpy", "c"):
        found = policy(points, outside=-1, backend=backend)
        np.testing.assert_array_equal(found, symbols)
