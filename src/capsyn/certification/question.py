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
from capsyn.modelling.discrete import refuse_map
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.exogenous import of_states
from capsyn.modelling.targets import (
    Target,
    check_initial,
    check_target,
    describe_target,
    target_axes,
    target_program,
    with_tolerance,
)
from capsyn.modelling.transcription import target_condition
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from capsyn.reach.kernel import Cells
from capsyn.reach.loop import SampledLoop, sampled_loop
from capsyn.simulation.closed_loop import Record, new_record
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
THIN = 1e-6
"""Share of the domain's width that is proved on either side of a state whose start is fixed."""
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

    def simulated(
        self, states: np.ndarray, samples: int | None = None, recorded: bool = False
    ) -> tuple[np.ndarray, Record | None]:
        """Return trials (B,) of the loop from states (B, n) that have run, and their record if any.

        They run for so many samples, by default those of the experiment.
        """
        run = self.experiment
        if samples is not None:
            run = dataclasses.replace(run, loop=dataclasses.replace(run.loop, samples=samples))
        count, inputs = len(states), self.loop.controls.shape[1]
        parameters = np.repeat(self.middle[None], count, axis=0)
        trials = run.trials(states, np.full(count, self.loop.delay), parameters)
        record = new_record(count, run.loop.samples, states.shape[1], inputs) if recorded else None
        run.run(trials, None, record)
        return trials, record

    def begins(self, states: np.ndarray) -> np.ndarray:
        """Return which states (B, n) are in the initial set."""
        inside = ((states >= self.box[0]) & (states <= self.box[1])).all(axis=1)
        if isinstance(self.initial, Ball):
            off = states[:, target_axes(self.initial, self.policy.domain)] - self.initial.center
            inside &= (off**2).sum(axis=1) <= self.initial.radius**2
        return np.asarray(inside)


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
    if plant.sample_time is not None:
        refuse_map(policy if policy.discrete else asked.model, "policy", "proofs follow flows")
    delay = plant.delay if asked.delay is None else finite_number("delay", asked.delay, least=0.0)
    if asked.target is None and policy.target is None:
        raise ProblemError("`target` must be given: neither policy nor problem has one")
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
    assert experiment.target is not None
    avoid = _avoided(asked.avoid, plant)
    _check_periods(plant, experiment.target, avoid, middle)
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
    cells = _cells(asked.counts, loop, box)
    conditions = {
        **({} if plant.time_unit == "s" else {"time_unit": plant.time_unit}),
        "initial": describe_target(initial or plant.domain, plant.domain),
        "target": describe_target(experiment.target, plant.space),
        "avoid": None if avoid is None else describe_target(avoid, plant.space),
        "rate": experiment.rate,
        "delay": delay,
        "model": "its own" if asked.model is None else "given",
        "outside": str(policy.outside),
        **({"noise": loop.noise[: plant.states].tolist()} if loop.noise.any() else {}),
        **({"hold": float(loop.holds.max() * loop.period)} if loop.holds.any() else {}),
        "parameters": {name: list(pair) for name, pair in ranges.items()},
        **({"exogenous": {name: list(pair) for name, pair in told.items()}} if told else {}),
    }
    starts = _starts(initial, box, plant.domain, cells)
    return Question(policy, experiment, loop, cells, initial, starts, box, middle, conditions)


def halved(asked: Question) -> Question:
    """Return the same question of cells half as wide along each axis that has more than one."""
    cells = asked.cells
    finer = Cells(cells.lower, cells.upper, np.where(cells.counts > 1, 2 * cells.counts, 1))
    starts = _starts(asked.initial, asked.box, asked.policy.domain, finer)
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
        avoid = target_condition(avoid, plant.states, plant.told, "avoid")
    avoid = of_states(avoid, plant.domain, plant.exogenous)
    check_target(avoid, plant.space, "avoid")
    return avoid


def _check_periods(
    plant: Plant, target: Target | None, avoid: Target | None, middle: np.ndarray
) -> None:
    """Raise where a set or the plant is another one period on, at random states."""
    space = plant.space
    states = space.sample(256, 0).T
    controls = np.repeat(plant.default[:, None], 256, axis=1)
    parameters = np.repeat(middle[:, None], 256, axis=1)
    for axis in np.flatnonzero(space.periodic):
        later = states.copy()
        later[axis] += space.widths[axis]
        for name, value in (
            ("target", target_program(target, space)),
            ("avoid", target_program(avoid, space)),
        ):
            if (value.evaluate(states)[0] != value.evaluate(later)[0]).mean() > 0.01:
                raise ProblemError(
                    f"`{name}` must come again every period of '{space.names[axis]}'; it does not"
                )
        here, there = (plant.rates(x, controls, parameters) for x in (states, later))
        if not np.allclose(
            here, there, rtol=1e-6, atol=1e-9 * np.nanmax(np.abs(here)), equal_nan=True
        ):
            raise ProblemError(
                f"the model must come again every period of '{space.names[axis]}'; it does not"
            )


def _noise(noise: Any, plant: Plant) -> np.ndarray:
    """Return the largest error of each measured state; exogenous inputs are known."""
    errors = np.zeros(plant.space.n)
    if noise is not None:
        errors[: plant.states] = per_state("noise", noise, plant.states, least=0.0)
    return errors


def _cells(counts: Any, loop: SampledLoop, box: tuple[np.ndarray, np.ndarray]) -> Cells:
    """Return the grid over the domain and the values of exogenous inputs; one cell of one value."""
    space, n, narrow = loop.space, loop.moving, NARROW * loop.space.widths
    lower, upper = space.lower.copy(), space.upper.copy()
    lower[n:], upper[n:] = box[0][n:], box[1][n:]
    fixed = upper - lower < narrow
    lower, upper = np.where(fixed, lower - narrow, lower), np.where(fixed, upper + narrow, upper)
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
    thin, margin = lower == upper, THIN * domain.widths  # a proof is of sets that have a volume
    lower = np.where(thin, np.maximum(lower - margin, domain.lower), lower)
    upper = np.where(thin, np.minimum(upper + margin, domain.upper), upper)
    ends = np.array(list(told.values())).reshape(-1, 2)
    return np.concatenate([lower, ends[:, 0]]), np.concatenate([upper, ends[:, 1]])


def _starts(
    initial: Ball | Box | None, box: tuple[np.ndarray, np.ndarray], domain: Box, cells: Cells
) -> np.ndarray:
    """Return the share (K,) of each cell in the initial set; of a ball by points of the cell."""
    shares = np.ones(1)
    for i, count in enumerate(cells.counts):
        faces = cells.lower[i] + cells.widths[i] * np.arange(count + 1)
        faces[-1] = cells.upper[i]
        both = np.minimum(faces[1:], box[1][i]) - np.maximum(faces[:-1], box[0][i])
        share = np.clip(both / (faces[1:] - faces[:-1]), 0.0, 1.0)
        share[share > 1 - 1e-12] = 1.0
        if box[0][i] == box[1][i]:
            share[:] = 1.0  # one value
        shares = (shares[:, None] * share).ravel()
    if not isinstance(initial, Ball):
        return shares
    axes = target_axes(initial, domain)
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
