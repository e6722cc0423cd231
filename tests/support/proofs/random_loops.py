"""Sampled loops made at random: plants of few sources, policies of all kinds, sets and rates."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from capsyn import Alphabet, Ball, Box, DecisionTree, Policy, Problem, Switching
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.modelling.grid import Grid
from capsyn.modelling.transcription import transcribe
from support.split_trees import guarantee

SYMBOLIC = SimpleNamespace(
    sin=ca.sin, cos=ca.cos, tanh=ca.tanh, sqrt=ca.sqrt, fabs=ca.fabs, fmax=ca.fmax, sign=ca.sign,
    floor=ca.floor, if_else=ca.if_else,
)  # fmt: skip
NUMERIC = SimpleNamespace(
    sin=np.sin, cos=np.cos, tanh=np.tanh, sqrt=np.sqrt, fabs=np.abs, fmax=np.maximum,
    sign=np.sign, floor=np.floor, if_else=np.where,
)  # fmt: skip


@dataclass(frozen=True)
class Family:
    """Plants of one source: x' = f(x, u, p, functions), told inputs after the states in x."""

    rates: Callable[..., list[Any]]
    n: int
    m: int
    spans: tuple[float, ...]  # each component of p is within +- this
    periodic: tuple[bool, ...] = ()
    told: int = 0
    jumps: bool = False

    @functools.cached_property
    def symbolic(self) -> Callable[..., list[Any]]:
        """The model as `capsyn.certify` takes it."""
        if self.told:
            return lambda x, u, w, p: self.rates(
                [*map(x.__getitem__, range(self.n)), w[0]], u, p, SYMBOLIC
            )
        return lambda x, u, p: self.rates(x, u, p, SYMBOLIC)

    def __call__(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the rates (n + k, B) by NumPy alone; those of told inputs are 0."""
        rates = self.rates(x, u, p, NUMERIC)
        out = np.zeros_like(x)
        for i, rate in enumerate(rates):
            out[i] = rate
        return out


def _plane(x, u, p, f):
    bent = f.if_else(x[0] + x[1] > 0, x[0] + x[1], (x[0] + x[1]) / 2)
    return [
        p[0] * x[0] + p[1] * x[1] + p[2] * f.sin(3 * x[1]) + u[0],
        p[3] * x[0] + p[4] * x[1] + p[5] * x[0] * u[1] + p[6] * bent + u[1],
    ]


def _told(x, u, p, f):
    return [x[1] + p[0] * x[2], u[0] + x[2] * x[0] - p[1] * x[1] ** 3]


FAMILIES = {
    "line": Family(lambda x, u, p, f: [p[0] * x[0] + p[1] * f.sin(5 * x[0]) + u[0]], 1, 1, (1, 1)),
    "plane": Family(_plane, 2, 2, (1, 1, 0.5, 1, 1, 0.5, 0.5)),
    "linear": Family(
        lambda x, u, p, f: [p[0] * x[0] + p[1] * x[1] + u[0], p[2] * x[0] + p[3] * x[1] + u[1]],
        2, 2, (1, 3, 3, 1),
    ),
    "friction": Family(
        lambda x, u, p, f: [x[1] + p[1] * x[0], u[0] - p[0] * f.if_else(x[1] > 0.05, 1, -1)],
        2, 1, (0.6, 0.5), jumps=True,
    ),
    "steps": Family(
        lambda x, u, p, f: [u[0] + p[0] * f.sign(x[1]), u[1] + p[1] * f.floor(3 * x[0])],
        2, 2, (0.5, 0.3), jumps=True,
    ),
    "pendulum": Family(
        lambda x, u, p, f: [x[1], p[0] * f.sin(x[0]) - p[1] * x[1] + u[0] * f.cos(x[0])],
        2, 1, (1, 1), (True, False),
    ),
    "torus": Family(
        lambda x, u, p, f: [u[0] + p[0] * f.sin(x[1]), u[1] + p[1] * f.cos(x[0])],
        2, 2, (0.5, 0.5), (True, True),
    ),
    "roots": Family(
        lambda x, u, p, f: [
            u[0] - p[0] * f.sqrt(f.fmax(x[0] + 1.6, 0)),
            u[1] - p[1] * x[1] / f.sqrt(f.sqrt(x[1] * x[1] + 0.01)),
        ],
        2, 2, (0.5, 0.5),
    ),
    "oscillator": Family(
        lambda x, u, p, f: [x[1], p[0] * (1 - x[0] ** 2) * x[1] - x[0] + u[0] + p[1] * x[0] * u[0]],
        2, 1, (1, 0.5),
    ),
    "space": Family(
        lambda x, u, p, f: [
            p[0] * x[1] + u[0], p[1] * x[0] * x[2] + u[1], p[2] * f.tanh(2 * x[0]) + u[2],
        ],
        3, 3, (1, 1, 0.5),
    ),
    "car": Family(
        lambda x, u, p, f: [f.cos(x[2]) + p[0], f.sin(x[2]), 2 * u[0]],
        3, 1, (0.2,), (False, False, True),
    ),
    "told": Family(_told, 2, 1, (0.3, 0.5), told=1),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Case:
    """A loop and what is asked of it; `kind` tells which plant, target and set to avoid."""

    kind: tuple[Any, ...]
    family: Family
    policy: Policy
    target: Any
    inside: Callable[[np.ndarray], np.ndarray]  # of states (n, B): at most 0 in the target
    avoid: Any
    avoided: Callable[[np.ndarray], np.ndarray]
    period: float
    delay: float
    noise: np.ndarray
    ranges: dict[str, tuple[float, float]]
    dwell: float | None
    counts: tuple[int, ...]
    told: dict[str, tuple[float, float]] = field(default_factory=dict)
    initial: Any = None


def never(x: np.ndarray) -> np.ndarray:
    return np.full(x.shape[1], np.inf)


def _radius(x: np.ndarray, family: Family, center: float) -> np.ndarray:
    off = x[: family.n] - center
    for i in np.flatnonzero(family.periodic):
        off[i] = (off[i] + np.pi) % (2 * np.pi) - np.pi
    return np.sqrt((off**2).sum(axis=0))


def _targets(family: Family, which: str) -> tuple[Any, Callable[[np.ndarray], np.ndarray]]:
    n = family.n
    if which == "ball":
        radius = 0.35 if n == 2 else 0.5
        return Ball([0.0] * n, radius), lambda x: _radius(x, family, 0.0) - radius
    if which == "box" and not any(family.periodic):
        half = 0.3 if n < 3 else 0.45
        box = Box([-half] * n, [half] * n)
        return box, lambda x: np.abs(x[:n]).max(axis=0) - half

    turning = family.periodic or (False,) * n

    def size(x, f):
        squares = [2 - 2 * f.cos(x[i]) if turning[i] else x[i] ** 2 for i in range(n)]
        return sum(((1 + i) * square for i, square in enumerate(squares[1:], 1)), start=squares[0])

    def condition(x, *w):
        return size(x, SYMBOLIC) <= 0.16

    def value(x):
        return size(x, NUMERIC) - 0.16

    return condition, value


def _avoids(family: Family, which: str) -> tuple[Any, Callable[[np.ndarray], np.ndarray]]:
    n = family.n
    if which == "none":
        return None, never
    if which == "ball":
        return Ball([0.55] * n, 0.2), lambda x: _radius(x, family, 0.55) - 0.2
    if any(family.periodic):  # x[0] of some turns on, or only x[1]
        return (lambda x, *w: ca.sin(x[0] + 1) < -0.5), lambda x: np.sin(x[0] + 1) + 0.5
    return (lambda x, *w: x[0] > 0.75), lambda x: 0.75 - x[0]


@functools.cache
def _base(n: int, m: int, told: int, periodic: tuple[bool, ...]) -> Any:
    """Return a model of such sizes; its costs are of no account, another is given."""
    box = Box([-1.0] * n, [1.0] * n, periodic=periodic or None)
    extra = {"exogenous": Box([-1.0], [1.0], names=["w1"])} if told else {}
    problem = Problem(
        "base", lambda x, u, *w: [x[0] * 0 + u[i % m] for i in range(n)], box,
        Alphabet(np.eye(m).repeat(2, axis=0) * [[1]] + np.arange(2 * m)[:, None]), [0.0] * m, 1.0,
        running_cost=lambda x, *w: x[0] ** 2, **extra,
    )  # fmt: skip
    return transcribe(problem)


KINDS = [
    (family, target, avoid, symbols)
    for family in FAMILIES
    for target, avoid, symbols in (
        ("ball", "none", 4),
        ("box", "ball", 2),
        ("condition", "half", 4),
    )
]
"""Family, target, set to avoid, and symbols: each has C sources of its own."""


def random_case(rng: np.random.Generator, kind: tuple[str, str, str, int]) -> Case:
    """Return a random loop of one of the `KINDS`."""
    name, target, avoid, symbols = kind
    family = FAMILIES[name]
    n, m, told = family.n, family.m, family.told
    periodic = family.periodic or (False,) * n
    lower, upper = -rng.uniform(0.8, 1.4, n), rng.uniform(0.8, 1.4, n)
    for i in np.flatnonzero(periodic):
        lower[i], upper[i] = -np.pi, np.pi
    domain = Box(lower, upper, periodic=periodic)
    exogenous = Box([-0.5], [0.5], names=["w1"]) if told else None
    middle = rng.uniform(-1, 1, len(family.spans)) * family.spans * rng.choice([0.1, 0.5, 1.0])
    if name in ("friction", "pendulum", "roots"):
        middle = np.abs(middle)
    half = np.array(family.spans) * (rng.random(len(middle)) < 0.4) * rng.choice([0, 0.02, 0.2])
    ranges = {f"p{k}": (a - b, a + b) for k, (a, b) in enumerate(zip(middle, half))}
    controls = _controls(rng, symbols, m)
    default = controls[rng.integers(symbols)] if rng.random() < 0.4 else np.zeros(m)
    space = _joined(domain, exogenous)
    values = np.vstack([controls, default])
    label = _wished(rng, family, values, middle)
    speed = _speed(family, space, values, middle)
    shape = {1: (8, 65), 2: (8, 21), 3: (5, 10)}[n + told]
    counts = tuple(int(c) for c in rng.integers(*shape, n + told))
    motion = 10 ** rng.uniform(-1.8, 0.4)
    period = float(motion * (domain.widths / counts[:n]).min() / speed)
    policy = _policy(rng, domain, exogenous, controls, default, label, period)
    noise = np.zeros(n)
    if rng.random() < 0.35:
        noise = rng.uniform(0, 0.1, n) * domain.widths / counts[:n] * (rng.random(n) < 0.7)
    inits = None
    if rng.random() < 0.25:
        inits = Box(0.9 * lower * rng.random(n), 0.9 * upper * rng.uniform(0.1, 1, n))
        inits = (
            inits if rng.random() < 0.5 else Ball((lower + upper) / 2, 0.4 * domain.widths.min())
        )
    dwell = None
    if policy.switching is None and rng.random() < 0.35:
        dwell = period * int(rng.integers(2, 6))
    ends = np.sort(rng.uniform(-0.5, 0.5, 2))
    if told and rng.random() < 0.3:  # known
        ends, counts = ends[:1].repeat(2), counts[:n]
    return Case(
        kind, family, policy, *_targets(family, target), *_avoids(family, avoid), period,
        float(rng.choice([0, 0, 0, 0.3, 1.0, rng.random()]) * period), noise, ranges, dwell, counts,
        {"w1": tuple(ends.tolist())} if told else {}, inits,
    )  # fmt: skip


def _joined(domain: Box, exogenous: Box | None) -> Box:
    if exogenous is None:
        return domain
    return Box(
        np.append(domain.lower, exogenous.lower), np.append(domain.upper, exogenous.upper),
        periodic=[*domain.periodic, False],
    )  # fmt: skip


def _controls(rng: np.random.Generator, symbols: int, m: int) -> np.ndarray:
    """Return controls, two of them the same now and then."""
    ends = np.stack(np.meshgrid(*[[-1.0, 1.0]] * m, indexing="ij"), axis=-1).reshape(-1, m)
    values = ends[rng.permutation(len(ends))[:symbols]]
    while len(values) < symbols:
        values = np.vstack([values, rng.uniform(-1, 1, m)])
    return values * rng.uniform(0.8, 1.6)


def _speed(family: Family, space: Box, values: np.ndarray, p: np.ndarray) -> float:
    x = space.sample(256, 0).T
    rates = [np.abs(family(x, u[:, None], p[:, None])).max() for u in values]
    return max(max(rates), 0.1)


def _wished(
    rng: np.random.Generator, family: Family, values: np.ndarray, p: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """Return what says which label (B,) of states (B, n) leads nearest to the middle, or errs."""
    ahead, weights = rng.uniform(0.15, 1.2), rng.uniform(0.3, 2.0, family.n)
    lead, errs = rng.uniform(0, 1), float(rng.choice([0, 0, 0, 0.03, 0.2]))
    labels = len(values) - 1 + int(rng.random() < 0.3)

    def label(states: np.ndarray) -> np.ndarray:
        scores = []
        for u in values[:labels]:
            x = states.T.copy()
            for _ in range(6):
                x = x + ahead / 6 * family(x, u[:, None], p[:, None])
            x = x[: family.n].copy()
            for i in np.flatnonzero(family.periodic):
                x[i] = (x[i] + np.pi) % (2 * np.pi) - np.pi
            if family.n > 1:
                x[0] = x[0] + lead * x[1]
            scores.append((weights[:, None] * x**2).sum(axis=0))
        best = np.argmin(scores, axis=0)
        wrong = rng.random(len(best)) < errs
        best[wrong] = rng.integers(0, len(values), int(wrong.sum()))
        return best

    return label


def _policy(
    rng: np.random.Generator, domain: Box, exogenous: Box | None, controls: np.ndarray,
    default: np.ndarray, label: Callable[[np.ndarray], np.ndarray], period: float,
) -> Policy:  # fmt: skip
    """Return cells, or a tree, axial or oblique; some remember, hold, have gaps or no outside."""
    space, labels = _joined(domain, exogenous), len(controls) + 1
    n = space.n
    counts = tuple(int(c) for c in rng.integers(3, {1: 30, 2: 14, 3: 9}[n], n))
    rows, row_of = _rows(rng, labels, rng.random() < 0.3)
    if rng.random() < 0.5:
        middles = space.lower + space.widths * (_lattice(counts) + 0.5) / counts
        entries = -1 - row_of(label(middles))
        none = np.zeros(0, np.int32), np.zeros((0, 1 if rows is None else labels, 1), np.uint64)
        cells: Any = CellTree(Grid(counts, (2,) * n, 0), entries.astype(np.int32), *none)
        made: Any = Policy
    else:
        planes = int(rng.random() < 0.5) * 4
        cells = _tree(
            rng, counts, planes, lambda z: row_of(label(space.lower + space.widths * z / counts))
        )
        made = functools.partial(DecisionTree, guarantee=guarantee("linear" if planes else "exact"))
    switching = None
    if rng.random() < 0.15:
        switching = Switching(hold=tuple((period * rng.integers(0, 5, labels - 1)).tolist()))
    told = 0 if exogenous is None else 1
    return made(
        "random", domain, Alphabet(controls), default, cells, exogenous=exogenous,
        outside="nearest" if rng.random() < 0.25 else "error", transitions=rows,
        gaps=bool(rng.random() < 0.1), horizon=max(1.0, 100 * period) / 4, switching=switching,
        model=_base(domain.n, controls.shape[1], told, tuple(domain.periodic)),
    )  # fmt: skip


def _lattice(counts: tuple[int, ...]) -> np.ndarray:
    return np.stack(np.unravel_index(np.arange(np.prod(counts)), counts), axis=1)


def _rows(
    rng: np.random.Generator, labels: int, remembers: bool
) -> tuple[np.ndarray | None, Callable[[np.ndarray], np.ndarray]]:
    """Return transitions, and what gives rows of them for wished labels."""
    if not remembers:
        return None, lambda wished: wished
    table, own = set(), {}
    for wished in range(labels):
        keeps = rng.random(labels) < 0.5
        row = tuple(int(k) if keep else wished for k, keep in zip(range(labels), keeps))
        own[wished] = row
        if len(set(row)) > 1:
            table.add(row)
    if not table:
        return None, lambda wished: wished
    ordered = sorted(table)
    constant = np.repeat(np.arange(labels)[:, None], labels, axis=1)
    number = {row: labels + k for k, row in enumerate(ordered)}
    chosen = np.array([number.get(own[k], k) for k in range(labels)])
    rows = np.vstack([constant, np.array(ordered)])
    share = rng.uniform(0.2, 1)
    return rows, lambda wished: np.where(rng.random(len(wished)) < share, chosen[wished], wished)


def _tree(
    rng: np.random.Generator, counts: tuple[int, ...], planes: int,
    row: Callable[[np.ndarray], np.ndarray],
) -> SplitTree:  # fmt: skip
    """Return a tree of random splits, whose leaves have the row of some point of theirs."""
    n, nodes, used = len(counts), [], []
    points = rng.random((400, n)) * counts

    def grow(points: np.ndarray, left: int) -> None:
        here = len(nodes)
        if not left or len(points) < 4 or (here and rng.random() < 0.05):
            own = row(points[:1]) if len(points) else [0]
            nodes.append([LEAF, int(own[0]), here])
            return
        whole = np.floor(points).astype(int)
        if planes and rng.random() < 0.6:
            plane = rng.integers(-3, 4, n)
            value, split = whole @ plane, n + len(used)
            used.append(plane)
        else:
            split = int(rng.integers(n))
            value = whole[:, split]
        cut = int(rng.choice(value))
        if split < n and not 1 <= cut < counts[split]:
            nodes.append([LEAF, int(row(points[:1])[0]), here])
            return
        nodes.append([split, cut, 0])
        grow(points[value < cut], left - 1)
        nodes[here][2] = len(nodes)
        grow(points[value >= cut], left - 1)

    grow(points, int(rng.integers(2, 9)))
    return SplitTree(
        counts, *np.array(nodes, dtype=np.int32).T.copy(),
        np.array(used, dtype=np.int32).reshape(-1, n),
    )  # fmt: skip
