"""What a proof is asked: a loop, a grid, and the set of starts."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.execution.memory import available_memory
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.exogenous import of_states
from capsyn.modelling.targets import (
    Target,
    check_initial,
    check_target,
    describe_target,
    target_axes,
    with_tolerance,
)
from capsyn.modelling.transcription import target_condition
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from capsyn.reach.kernel import Cells
from capsyn.reach.loop import SampledLoop, sampled_loop
from capsyn.simulation.closed_loop import new_record
from capsyn.simulation.experiment import Experiment, per_state, set_up
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import Plant, plant_of
from capsyn.validation import describe, finite_number, is_list, whole_numbers

COUNTS = {1: 4096, 2: 72, 3: 24, 4: 12}
"""Cells along each axis unless told, by the number of axes; `FEWEST` of more."""
FEWEST = 6
MOST_CELLS = 1 << 26
BYTES = 200
"""Of a cell and a layer while it is proved."""
HORIZONS = 20
"""Prediction horizons that a simulated loop may take to arrive; time units without a horizon."""
SUBDIVISIONS = 4096
"""Points of a cell, roughly, by which the share of a ball in it is told."""
TRACED, TRACED_BYTES = 64, 1 << 26
"""Most simulated loops that tell where the grid is to be, and their bytes."""
AROUND, WHOLE = 0.1, 0.8
"""Share by which the grid is wider than that, and share of an axis from which all is taken."""
NARROW = 1e-9
"""Share of its range within which an exogenous input that is told one value is."""


@dataclass(frozen=True)
class Asked:
    """The arguments of `capsyn.certify`."""

    initial: Any = None
    target: Any = None
    tolerance: float | None = None
    avoid: Any = None
    rate: float | None = None
    delay: float | None = None
    noise: Any = None
    parameters: Any = None
    exogenous: Any = None
    model: Any = None
    min_dwell: float | None = None
    counts: Any = None


@dataclass(frozen=True, eq=False)
class Question:
    """A loop, the cells of the proof, and the starts it is about."""

    policy: Policy
    experiment: Experiment  # simulates the same loop, at the middle of each range
    loop: SampledLoop
    cells: Cells
    initial: Ball | Box | None
    starts: np.ndarray  # (K,): share of each cell in the initial set
    box: tuple[np.ndarray, np.ndarray]  # (n,), (n,): around the initial set
    middle: np.ndarray  # (P,): of the ranges of parameters
    conditions: dict[str, Any]


def question(policy: Policy, asked: Asked, threads: int | None, seed: int) -> Question:
    """Return what is to be proved.

    Raises
    ------
    ProblemError
        An argument that cannot be used, by name.
    """
    if policy.exogenous is not None and asked.model is None:
        policy, asked = _cut(policy, asked)
    ranges = _ranges("parameters", asked.parameters)
    plant = plant_of(policy, asked.model, tuple(ranges))
    delay = plant.delay if asked.delay is None else finite_number("delay", asked.delay, least=0.0)
    initial = asked.initial
    check_initial(initial, plant.domain)
    options = LoopOptions(
        duration=HORIZONS * (policy.horizon or 1.0),
        rate=asked.rate,
        model=asked.model,
        parameters={name: (low + high) / 2 for name, (low, high) in ranges.items()},
        delay=delay,
        min_dwell=asked.min_dwell,
        target=with_tolerance(asked.target or policy.target, asked.tolerance),
        stop_at_target=True,
        threads=threads,
        seed=seed,
    )
    middle = np.array(list(options.parameters.values()))
    typical = middle[:, None] if len(middle) else None
    experiment = set_up(policy, plant, options, typical)
    if experiment.target is None:
        raise ProblemError("`target` must be given: neither policy nor problem has one")
    avoid = _avoided(asked.avoid, plant)
    loop = sampled_loop(
        policy,
        plant,
        experiment.loop.holds,
        experiment.loop.period,
        delay,
        target=experiment.target,
        avoid=avoid,
        noise=_noise(asked.noise, plant),
        parameters=np.array(list(ranges.values())).reshape(-1, 2).T,
    )
    told = _told(asked.exogenous, plant)
    box = _box(initial, plant, told)
    cells = _cells(asked.counts, loop, *_region(experiment, loop, middle, box, seed))
    conditions = {
        **({} if plant.time_unit == "s" else {"time_unit": plant.time_unit}),
        "initial": describe_target(initial or plant.domain, plant.domain),
        "target": describe_target(experiment.target, plant.space),
        "avoid": None if avoid is None else describe_target(avoid, plant.space),
        "rate": experiment.rate,
        "delay": delay,
        **({"noise": loop.noise[: plant.states].tolist()} if loop.noise.any() else {}),
        **({"hold": float(loop.holds.max() * loop.period)} if loop.holds.any() else {}),
        "parameters": {name: list(pair) for name, pair in ranges.items()},
        **({"exogenous": {name: list(pair) for name, pair in told.items()}} if told else {}),
    }
    starts = _starts(initial, box, plant.space, cells)
    return Question(policy, experiment, loop, cells, initial, starts, box, middle, conditions)


def halved(asked: Question) -> Question:
    """Return the same question of cells half as wide along each axis that has more than one."""
    cells = asked.cells
    finer = Cells(cells.lower, cells.upper, np.where(cells.counts > 1, 2 * cells.counts, 1))
    starts = _starts(asked.initial, asked.box, asked.loop.space, finer)
    return dataclasses.replace(asked, cells=finer, starts=starts)


def _ranges(name: str, given: Any) -> dict[str, tuple[float, float]]:
    """Return ranges by name of numbers or pairs (low, high)."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ProblemError(f"`{name}` must be a mapping of names; got {describe(given)}")
    ranges = {}
    for key, value in given.items():
        ends = value if is_list(value, 2) else (value, value)
        low, high = (finite_number(f"{name}['{key}']", end) for end in ends)
        if low > high:
            raise ProblemError(f"`{name}['{key}']` must be (low, high); got {describe(value)}")
        ranges[str(key)] = (low, high)
    return ranges


def _cut(policy: Policy, asked: Asked) -> tuple[Policy, Asked]:
    """Return the policy of the states alone where each exogenous input is told one value."""
    told, given = policy.exogenous, asked.exogenous
    assert told is not None
    values = list(given.values()) if isinstance(given, Mapping) else given
    if not is_list(values, told.n) or any(is_list(value, 2) for value in values):
        return policy, asked
    return policy.at(given), dataclasses.replace(asked, exogenous=None)


def _told(given: Any, plant: Plant) -> dict[str, tuple[float, float]]:
    """Return the ranges of the exogenous inputs by name, those of their box where not given."""
    own = plant.exogenous
    if own is None:
        if given is not None:
            raise ProblemError("`exogenous` must be left out: the policy is told nothing")
        return {}
    if is_list(given, own.n):
        given = dict(zip(own.names, given))
    ranges = dict(zip(own.names, zip(own.lower.tolist(), own.upper.tolist())))
    for name, (low, high) in _ranges("exogenous", given).items():
        if name not in ranges:
            raise ProblemError(
                f"`exogenous` must name inputs among {', '.join(own.names)}; got '{name}'"
            )
        if low < ranges[name][0] or high > ranges[name][1]:
            raise ProblemError(
                f"`exogenous['{name}']` must be within [{ranges[name][0]:g}, {ranges[name][1]:g}]; "
                f"got [{low:g}, {high:g}]"
            )
        ranges[name] = (low, high)
    return ranges


def _avoided(avoid: Any, plant: Plant) -> Target | None:
    if callable(avoid) and not isinstance(avoid, Program):
        avoid = target_condition(avoid, plant.states, plant.told)
    avoid = of_states(avoid, plant.domain, plant.exogenous)
    check_target(avoid, plant.space, "avoid")
    return avoid


def _noise(noise: Any, plant: Plant) -> np.ndarray:
    """Return the largest error of each measured state; exogenous inputs are known."""
    errors = np.zeros(plant.space.n)
    if noise is not None:
        errors[: plant.states] = per_state("noise", noise, plant.states, least=0.0)
    return errors


def _region(
    experiment: Experiment,
    loop: SampledLoop,
    middle: np.ndarray,
    box: tuple[np.ndarray, np.ndarray],
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the box (n,), (n,) of the grid: where simulated loops from the starts go, and more.

    It is within the domain, of each axis all or a part, and along exogenous inputs that of the
    starts; one of no width is made as narrow as can be.
    """
    space, samples = loop.space, experiment.loop.samples
    count = min(TRACED, max(1, TRACED_BYTES // (8 * (samples + 1) * (space.n + 2))))
    random = np.random.default_rng((seed, 7))
    states = box[0] + (box[1] - box[0]) * random.random((count, space.n))
    states[: count // 2] = np.where(random.random((count // 2, space.n)) < 0.5, *box)
    parameters = np.repeat(middle[None], count, axis=0)
    trials = experiment.trials(states, np.full(count, loop.delay), parameters)
    record = new_record(count, samples, space.n, loop.controls.shape[1])
    experiment.run(trials, None, record)
    where = record.states.reshape(-1, space.n)
    where = np.vstack([where[np.isfinite(where).all(axis=1)], *box])
    low, high = where.min(axis=0), where.max(axis=0)
    margin = AROUND * (high - low)
    lower, upper = np.maximum(low - margin, space.lower), np.minimum(high + margin, space.upper)
    whole = (upper - lower > WHOLE * space.widths) | np.array(space.periodic)
    lower, upper = np.where(whole, space.lower, lower), np.where(whole, space.upper, upper)
    n = loop.moving
    lower[n:], upper[n:] = box[0][n:], box[1][n:]
    narrow = NARROW * space.widths
    fixed = upper - lower < narrow
    return np.where(fixed, lower - narrow, lower), np.where(fixed, upper + narrow, upper)


def _cells(counts: Any, loop: SampledLoop, lower: np.ndarray, upper: np.ndarray) -> Cells:
    """Return the grid over a box, of an exogenous input that has one value one cell."""
    space = loop.space
    fixed = upper - lower < 3 * NARROW * space.widths
    free = int((~fixed).sum())
    if counts is None:
        found = np.full(space.n, COUNTS.get(free, FEWEST))
    else:
        found = np.ones(space.n, dtype=int)
        found[~fixed] = whole_numbers("counts", counts, free, least=1, most=1 << 20)
    found[fixed] = 1
    total = math.prod(found.tolist())
    most = min(MOST_CELLS, available_memory() / (BYTES * loop.layers))
    if total > most:
        fits = max(1, int(most ** (1 / free)))
        raise ProblemError(
            f"`counts` must be cells that fit memory, about {fits} along each axis; got {total:,} "
            f"cells of {loop.layers} label(s) in force"
        )
    return Cells(lower, upper, found)


def _box(
    initial: Ball | Box | None, plant: Plant, told: dict[str, tuple[float, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the box around the starts; `ProblemError` where some are outside the domain."""
    domain, axes = plant.domain, []
    lower, upper = domain.lower.copy(), domain.upper.copy()
    if initial is not None:
        axes = target_axes(initial, domain, "initial")
        if isinstance(initial, Ball):
            lower[axes], upper[axes] = (
                initial.center - initial.radius,
                initial.center + initial.radius,
            )
        else:
            lower[axes], upper[axes] = initial.lower, initial.upper
    for i in axes:
        if lower[i] < domain.lower[i] or upper[i] > domain.upper[i]:
            raise ProblemError(
                f"`initial` must be within the domain, [{domain.lower[i]:g}, {domain.upper[i]:g}] "
                f"on axis '{domain.names[i]}'; got [{lower[i]:g}, {upper[i]:g}]"
            )
    ends = np.array(list(told.values())).reshape(-1, 2)
    return np.concatenate([lower, ends[:, 0]]), np.concatenate([upper, ends[:, 1]])


def _starts(
    initial: Ball | Box | None, box: tuple[np.ndarray, np.ndarray], space: Box, cells: Cells
) -> np.ndarray:
    """Return the share (K,) of each cell in the initial set; of a ball by points of the cell."""
    shares = np.ones(1)
    for i, count in enumerate(cells.counts):
        faces = cells.lower[i] + cells.widths[i] * np.arange(count + 1)
        faces[-1] = cells.upper[i]
        both = np.minimum(faces[1:], box[1][i]) - np.maximum(faces[:-1], box[0][i])
        share = np.clip(both / (faces[1:] - faces[:-1]), 0.0, 1.0)
        share[share > 1 - 1e-12] = 1.0
        if cells.upper[i] - cells.lower[i] <= 3 * NARROW * space.widths[i]:
            share[:] = 1.0  # one value
        shares = (shares[:, None] * share).ravel()
    if not isinstance(initial, Ball):
        return shares
    axes = target_axes(initial, space)
    some = np.flatnonzero(shares)
    lower, upper = cells.boxes(some)
    per_axis = max(2, round(SUBDIVISIONS ** (1 / len(axes)) / 4))
    grid = (np.arange(per_axis) + 0.5) / per_axis
    inside = np.zeros(len(some))
    for place in itertools.product(grid, repeat=len(axes)):
        point = lower[:, axes] + (upper - lower)[:, axes] * np.array(place)
        inside += ((point - initial.center) ** 2).sum(axis=1) <= initial.radius**2
    shares[some] = inside / per_axis ** len(axes)
    return shares
