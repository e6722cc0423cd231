"""Tables for tests and files of them, as they should be and damaged."""

import io
import json

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


def rows_of(table):
    """Yield the state of each point of a table, and its symbols."""
    for point, mask in zip(table.points().tolist(), table.masks.ravel().tolist()):
        yield point, [k for k in range(len(table.alphabet)) if mask >> k & 1]


def long_csv(table, names, separator=",", index=False, number=repr):
    """Return a CSV file with a row for each symbol that is allowed at a point, if any."""
    lines = [[""] * index + [*names, *table.alphabet.inputs]]
    for point, symbols in rows_of(table):
        for k in symbols:
            values = [number(v) for v in point + table.alphabet.values[k].tolist()]
            lines.append([str(len(lines) - 1)] * index + values)
    return "\n".join(map(separator.join, lines)) + "\n"


def dtcontrol_text(table):
    """Return the file of dtControl of a table."""
    rows = long_csv(table, table.box().names).split("\n", 1)[1]
    kind = "" if any(len(symbols) > 1 for _, symbols in rows_of(table)) else "NON-"
    return f"#{kind}PERMISSIVE\n#BEGIN {len(table.counts)} {table.alphabet.m}\n{rows}"


def whole_table(counts, seed=0, several=False):
    """Return a table of whole numbers with gaps, whose symbols have names."""
    rough = random_table(counts, several=several, seed=seed)
    first = np.arange(len(counts)) - 2.0
    names = ["go", "stay", "turn left"]
    alphabet = Alphabet(np.arange(3), names)
    return Table(first, np.ones(len(counts)), rough.masks, alphabet, [f"v{k}" for k in first])


def storm_text(table, kind="labels"):
    """Return the scheduler of Storm of a table, without its gaps, or with them undefined."""
    states = []
    for k, (point, symbols) in enumerate(rows_of(table)):
        choices = []
        for symbol in symbols:
            name = table.alphabet.names[symbol]
            if kind == "labels":
                what = {"labels": [name]}
            else:
                what = {"origin": {"action-label": name, "transitions": []}}
            choices.append({"index": k, "prob": 1.0} | what)
        if choices or kind == "labels":
            values = dict(zip(table.box().names, map(int, point)))
            states.append({"c": choices or "undefined", "s": values})
    return json.dumps(states, indent=4)


def prism_texts(table, numbered=True, induced=False):
    """Return a strategy of PRISM of a table, and its states."""
    lines, states = [], [f"({','.join(table.box().names)})"]
    for k, (point, symbols) in enumerate(rows_of(table)):
        values = f"({','.join(str(int(v)) for v in point)})"
        states.append(f"{k}:{values}")
        for name in (table.alphabet.names[symbol] for symbol in symbols):
            if induced:
                lines += [f"{k} {k} 0.5 {name}", f"{k} 0 0.5 {name}"]
            else:
                lines.append(f"{k}:{name}" if numbered else f"{values}={name}")
    if induced:
        lines.insert(0, f"{len(states) - 1} {len(lines)}")
    return "\n".join(lines) + "\n", "\n".join(states) + "\n"


def random_regressor(rng, lower, upper, depth, numbers=100):
    """Return a random tree of numbers as Stratego writes it."""
    if depth == 0 or rng.random() < 0.2:
        return "inf" if rng.random() < 0.05 else float(rng.integers(numbers))
    axis = int(rng.integers(len(lower)))
    bound = float(rng.uniform(lower[axis], upper[axis]))
    low, high = list(lower), list(upper)
    low[axis] = high[axis] = bound
    return {
        "var": axis,
        "bound": bound,
        "low": random_regressor(rng, lower, high, depth - 1, numbers),
        "high": random_regressor(rng, low, upper, depth - 1, numbers),
    }


def stratego(keys=((0, 1), (0, 3), (2, 1)), depth=5, seed=0, minimize=1, numbers=100):
    """Return a random strategy of UPPAAL Stratego as plain data."""
    rng = np.random.default_rng(seed)
    regressors = {}
    for key in keys:
        trees = {}
        for action in rng.permutation(4)[:3].tolist():
            trees[str(action)] = random_regressor(rng, [-1.0, -5.0], [1.0, 5.0], depth, numbers)
        regressors[f"({','.join(map(str, key)) or 1})"] = {
            "type": "act->point->val",
            "representation": "simpletree",
            "minimize": minimize,
            "regressor": trees,
        }
    return {
        "version": 1.0,
        "type": "state->regressor",
        "representation": "map",
        "actions": {str(k): f"A.c->A.w {{ 1, tau, u := {k} }}" for k in range(4)},
        "statevars": [f"d{k} " for k in range(len(next(iter(keys))))],
        "pointvars": ["Ball[0].p", "Ball[0].v"],
        "locationnames": {"A.location": {"0": "c"}},
        "regressors": regressors,
    }


def npz_bytes(save=np.savez, **arrays):
    """Return the NumPy archive of some arrays."""
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


MARKS = b'0123456789.,;:|-+eE"#()[]{}=_ \t\n'
"""Characters that mean something in tables."""


def damaged_text(data, count, seed=0):
    """Yield copies of bytes that are damaged by what may stand in a table, or by any bytes."""
    rng = np.random.default_rng(seed)

    def drawn(size):
        return rng.choice(np.frombuffer(data + MARKS * (1 + len(data) // 64), np.uint8), size)

    return damaged(data, count, seed, lambda size: drawn(size).tobytes())


def damaged(data, count, seed=0, drawn=None):
    """Yield `count` copies of bytes that are changed, cut off, cut out of, or added to.

    Every other one has bytes that are `drawn`, if that is given, the rest any.
    """
    rng = np.random.default_rng(seed)
    for number in range(count):
        some = rng.bytes if drawn is None or number % 2 else drawn
        made = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            at, size = int(rng.integers(len(made) + 1)), int(rng.integers(1, 9))
            kind = rng.integers(5)
            if kind == 0:
                made[at : at + size] = b""
            elif kind == 1:
                made[at:at] = some(size)
            elif kind == 2:
                made[at:at] = made[at : at + 8 * size]
            elif kind == 3 and rng.random() < 0.3:
                made = made[:at]
            else:
                made[at : at + 1] = some(1)
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
