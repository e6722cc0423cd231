"""Tables for tests and files of them, as they should be and damaged."""

import io

import numpy as np
import pytest

from capsyn import Alphabet
from capsyn.sources.table import Table


def made_file(ending):
    """Return a fixture that writes a text, or bytes, to a file with an ending."""

    @pytest.fixture
    def file(tmp_path):
        def write(text):
            path = tmp_path / f"made.{ending}"
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
            return path

        return write

    return file


def grid_text(name, first, step, counts):
    """Return the section of a grid of points in SCOTS 0.2."""
    last = [low + h * (k - 1) for low, h, k in zip(first, step, counts)]
    lines = [f"#SCOTS:{name}", "#TYPE:UNIFORMGRID", "#MEMBER:DIM", str(len(first))]
    for vector, values in (("ETA", step), ("LOWER_LEFT", first), ("UPPER_RIGHT", last)):
        lines += [f"#VECTOR:{vector}", f"#BEGIN:{len(values)}", *map(repr, values), "#END"]
    return lines


def scots_text(table, first, step):
    """Return the file of a table whose inputs are the grid ``0, 1, .. N-1``."""
    rows = []
    for state, mask in enumerate(table.masks.ravel(order="F").tolist()):
        inputs = [str(k) for k in range(len(table.alphabet)) if mask >> k & 1]
        if inputs:
            rows.append(" ".join([str(state), *inputs]))
    return scots_file((first, step, table.counts), ([0.0], [1.0], [len(table.alphabet)]), rows)


def scots_file(states, inputs, rows, points=None):
    """Return the file of grids (first, step, counts) of states and inputs, and of rows."""
    points = np.prod(states[2]) if points is None else points
    lines = ["#SCOTS:v0.2", "#TYPE:STATICCONTROLLER"]
    lines += grid_text("STATE_SPACE", *states) + grid_text("INPUT_SPACE", *inputs)
    lines += ["#TYPE:WINNINGDOMAIN", "#SCOTS:i (state) j_0 ... j_n (valid inputs)"]
    return "\n".join([*lines, "#MATRIX:DATA", f"#BEGIN:{points} 1", *rows, "#END"]) + "\n"


def csv_text(table, names, digits=17, order=None):
    """Return the CSV file of a table: its lowest symbols, in C order or another."""
    points, symbols = table.points(), table.symbols.ravel().tolist()
    lines = [",".join([*names, "symbol"])]
    for i in range(len(points)) if order is None else order:
        state = [f"{value:.{digits}g}" for value in points[i]]
        lines.append(",".join([*state, "" if symbols[i] < 0 else str(symbols[i])]))
    return "\n".join(lines)


def npz_bytes(save=np.savez, **arrays):
    """Return the NumPy archive of some arrays."""
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


def damaged(data, count, seed=0):
    """Yield `count` copies of bytes that are changed, cut off, cut out of, or added to."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        made = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            at, size = int(rng.integers(len(made) + 1)), int(rng.integers(1, 9))
            kind = rng.integers(5)
            if kind == 0:
                made[at : at + size] = b""
            elif kind == 1:
                made[at:at] = rng.bytes(size)
            elif kind == 2:
                made[at:at] = made[at : at + 8 * size]
            elif kind == 3 and rng.random() < 0.3:
                made = made[:at]
            else:
                made[at : at + 1] = rng.bytes(1)
        yield bytes(made)


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
