"""Ports of a circuit: what numbers they carry, and where on them the faces of the lattice lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capsyn.errors import ProblemError
from capsyn.exports.crossings import least_reaching
from capsyn.exports.plan import Plan
from capsyn.random_streams import stream

LEAST_UNITS = 64
"""Units of the last place that a lattice step has at least by default."""
MAX_BITS = 48
"""Widest port; its numbers are exact in double precision."""
MAX_TURNS = 16
"""Most turns of a periodic axis that a port may hold."""
SHARED = 100_000
"""Random states at which the effect of the quantisation is counted."""
QUANTISED = 8
"""Purpose of these states."""
LEAST_STEP = 1e-200
"""Finest lattice step in readings."""
MOST_STEPS = 1 << 20
"""Most lattice steps of an axis that sums of an oblique tree may take from a port."""
MAX_SHIFT = 40


def width_of(most: int) -> int:
    """Return the bits of an unsigned number from 0 to `most`."""
    return max(1, int(most).bit_length())


@dataclass(frozen=True, eq=False)
class Port:
    """A signed fixed-point port: it carries the reading ``v * 2 ** -fraction``.

    Parameters
    ----------
    axis : int
        Whose state it is.
    bits, fraction : int
        Width with the sign, and the bits behind the point.
    negative : bool
        Whether the state falls as the reading rises: the circuit works with ``-v - 1``.
    steps, faces : (F,) int64
        Steps that the tree tells apart from those below, ascending, and their least numbers; a
        number on a periodic axis is brought into ``first .. last`` first.
    first, last : int
        Least and largest number of a state in the domain.
    step : float
        Numbers of a lattice step, not rounded.
    """

    axis: int
    bits: int
    fraction: int
    negative: bool
    steps: np.ndarray
    faces: np.ndarray
    first: int
    last: int
    step: float

    def face(self, step: int) -> int:
        """Return the least number of a step that the tree tells apart."""
        return int(self.faces[np.searchsorted(self.steps, step)])

    def ends(self, periodic: bool) -> tuple[int, int]:
        """Return numbers between which all steps are found; beyond, the step is that of an end."""
        if periodic or not len(self.faces):
            return self.first, self.last
        return int(self.faces[0]) - 1, int(self.faces[-1])

    @property
    def least(self) -> int:
        """Smallest number of the port."""
        return -(2 ** (self.bits - 1))

    @property
    def most(self) -> int:
        """Largest number of the port."""
        return 2 ** (self.bits - 1) - 1

    @property
    def turn(self) -> int:
        """Numbers of one turn of a periodic axis."""
        return self.last + 1 - self.first

    def quantised(self, readings: np.ndarray) -> np.ndarray:
        """Return the numbers (K,) of finite readings: nearest, up at ties, saturated."""
        with np.errstate(over="ignore"):
            numbers = np.floor(readings * 2.0**self.fraction + 0.5)
        return np.clip(numbers, self.least, self.most).astype(np.int64)

    def readings(self, numbers: np.ndarray, periodic: bool) -> np.ndarray:
        """Return the readings (K,) that numbers stand for, a periodic axis within one turn."""
        inner = -1 - numbers if self.negative else numbers
        if periodic:
            inner = self.first + (inner - self.first) % self.turn
        return (-1 - inner if self.negative else inner) * 2.0**-self.fraction


def fixed_port(plan: Plan, axis: int, bits: int | None, fraction: int | None) -> Port:
    """Return the port of a state; `ProblemError` where its steps fall together or do not fit."""
    domain, count = plan.policy.space, plan.tree.cells.counts[axis]
    name, periodic = domain.names[axis], domain.periodic[axis]
    scale, offset = float(plan.scale[axis]), float(plan.offset[axis])
    low, high = float(domain.lower[axis]), float(domain.upper[axis])
    ends = [(low - offset) / scale, (high - offset) / scale]
    step = abs(ends[1] - ends[0]) / count
    if not LEAST_STEP < step < 1 / LEAST_STEP:
        raise ProblemError(
            f"a lattice step of axis '{name}' must be of {LEAST_STEP} to {1 / LEAST_STEP} in its "
            f"readings for a fixed-point port; it is {step}"
        )
    if fraction is None:
        fraction = max(0, math.ceil(math.log2(LEAST_UNITS / step)))
    reach = max(abs(end) for end in ends) * 2.0**fraction
    # beyond the bounds there is room for states outside, to be told as such
    wanted = 1 + max(1, math.ceil(math.log2(max(reach * 1.25, 1.0))))
    bits = wanted if bits is None else bits
    if bits > MAX_BITS or wanted > 1000:
        raise ProblemError(
            f"a port of axis '{name}' would need {wanted} bits with {fraction} of them behind the "
            f"point; more than {MAX_BITS} are not possible: give fewer by `fraction`"
        )
    negative, least, most = scale < 0, -(2 ** (bits - 1)), 2 ** (bits - 1) - 1

    def states(numbers: np.ndarray) -> np.ndarray:
        values = (-1 - numbers if negative else numbers) * 2.0**-fraction
        return values * scale + offset if plan.folded else values

    steps = _told_apart(plan, axis)
    end = high if periodic else np.nextafter(high, np.inf)
    bounds = np.concatenate([[low], domain.faces(axis, steps, count), [end]])
    begins = least_reaching(states, bounds, least, most)
    first, faces, last = int(begins[0]), begins[1:-1], int(begins[-1]) - 1
    if (np.diff(begins) < 1).any():
        narrow = fraction + max(0, math.ceil(math.log2(2.0**-fraction / step)))
        whole = 1 + max(1, math.ceil(math.log2(max(abs(end) for end in ends) * 2.0**narrow)))
        raise ProblemError(
            f"the steps of axis '{name}' would fall together, or lie beyond the port of "
            f"{bits} bits with {fraction} behind the point: at least {whole} bits with {narrow} "
            "behind the point are needed"
        )
    port = Port(axis, bits, fraction, negative, steps, faces, first, last, step * 2.0**fraction)
    if periodic and 2**bits > MAX_TURNS * port.turn:
        raise ProblemError(
            f"a port of axis '{name}' would hold more than {MAX_TURNS} turns; give `bits` and "
            "`fraction` for it"
        )
    return port


def _told_apart(plan: Plan, axis: int) -> np.ndarray:
    """Return the steps of an axis that the tree tells apart from those below, ascending."""
    tree = plan.tree.cells
    if not len(tree.planes):
        return np.unique(tree.threshold[tree.split == axis]).astype(np.int64)
    count = tree.counts[axis]
    if count > MOST_STEPS:
        raise ProblemError(
            f"sums of an oblique tree take up to {MOST_STEPS:,} lattice steps from a fixed-point "
            f"port; axis '{plan.policy.space.names[axis]}' has {count:,}: take inputs lattice"
        )
    return np.arange(1, count)


def changed_share(plan: Plan, ports: tuple[Port, ...]) -> float:
    """Return the share of random states in the domain whose label the ports' rounding changes."""
    domain, tree = plan.policy.space, plan.tree.cells
    rng = stream(0, QUANTISED)
    states = domain.lower + rng.random((SHARED, plan.n)) * domain.widths
    before = tree.labels(domain.locate(states, tree.counts))
    numbers = port_numbers(ports, (states - plan.offset) / plan.scale)
    at_ports = plan.states(quantised_readings(plan, ports, numbers))
    after = tree.labels(domain.locate(at_ports, tree.counts))
    return float(np.mean(before != after))


def port_numbers(ports: tuple[Port, ...], readings: np.ndarray) -> np.ndarray:
    """Return the numbers (K, n) of finite readings (K, n)."""
    return np.stack([port.quantised(readings[:, port.axis]) for port in ports], axis=1)


def quantised_readings(plan: Plan, ports: tuple[Port, ...], numbers: np.ndarray) -> np.ndarray:
    """Return the readings (K, n) that numbers (K, n) stand for."""
    periodic = plan.policy.space.periodic
    return np.stack([p.readings(numbers[:, p.axis], periodic[p.axis]) for p in ports], axis=1)


def fold(port: Port, name: str, periodic: bool) -> tuple[int, int, int]:
    """Return (M, A, S) with ``(v * M + A) >> S`` the step of every number between its ends."""
    count = len(port.faces) + 1
    k = np.arange(1, count)
    first, last = port.ends(periodic)
    for shift in range(MAX_SHIFT + 1):
        slope = 2**shift / port.step
        if slope * max(abs(first), abs(last)) > 2.0**60 or count * 2.0**shift > 2.0**60:
            break
        for factor in sorted({max(1, math.floor(slope) + d) for d in (0, 1)}):
            lower = (k << shift) - factor * port.faces
            upper = (k << shift) - 1 - factor * (port.faces - 1)
            least = max([-factor * first, *lower.tolist()])
            most = min([(count << shift) - 1 - factor * last, *upper.tolist()])
            if least <= most:
                return factor, least, shift
    raise ProblemError(
        f"the faces of axis '{name}' fall on numbers of its port so that no product finds the "
        "steps; give another `fraction`, or take inputs lattice"
    )
