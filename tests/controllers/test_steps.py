"""Steps over the horizon: what decides is resolved, kinks and stiffness are told apart."""

import dataclasses

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Problem, SsacSettings, agreement, synthesize
from capsyn.cells.masks import last_any, several, singles
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.ssac import batch_controller
from capsyn.controllers.steps import STEP_LADDER, TRIED, resolving_steps
from capsyn.errors import ProblemError
from capsyn.modelling.transcription import transcribe

ALL_SMOOTH = np.ones(100, dtype=bool)


def first(results):
    """Return sets of symbol 0 for any results: nothing changes."""
    return singles(np.zeros(len(results[0]), dtype=int), 2)


def test_an_error_that_does_not_fall_ends_the_search_once_enough_steps_were_tried():
    noise, tried = np.random.default_rng(0), []

    def solver(states, horizon, steps):
        tried.append(steps)
        gradients = noise.normal(size=(len(states), 2)) * 1e-3
        return np.ones(len(states)), gradients, np.ones((len(states), 2))

    states = np.zeros((100, 1))
    steps, error = resolving_steps(solver, first, states, 1.0, 1e-6, ALL_SMOOTH)
    assert steps in STEP_LADDER and 1e-6 < error < 1e-2
    assert TRIED < max(tried) < STEP_LADDER[-1]


def test_states_that_need_more_steps_for_any_result_count_as_errors():
    def solver(states, horizon, steps):
        gradients = np.where((states < 0) & (steps < 100), np.nan, states)
        return states[:, 0], gradients, np.ones_like(states)

    states = np.linspace(-1, 1, 100)[:, None]
    assert resolving_steps(solver, first, states, 1.0, 1e-6, ALL_SMOOTH) == (128, 0.0)


def test_symbols_that_finer_steps_change_ask_for_more_steps():
    def solver(states, horizon, steps):
        ones = np.ones((len(states), 1))
        return np.full(len(states), 1 + 1 / steps**2), ones, ones

    def decided(results):
        return singles((results[0] > 1.02).astype(int), 2)  # by the cost alone

    states = np.zeros((100, 1))
    steps, _ = resolving_steps(solver, decided, states, 1.0, 1e-6, ALL_SMOOTH)
    assert steps == 8  # 1 / 6**2 > 0.02 > 1 / 8**2


def test_errors_behind_a_kink_count_less_than_others():
    def solver(states, horizon, steps):
        error = np.where(states > 0, 0.1 / steps**2, 0.1 / steps**4)
        return np.ones(len(states)), 1 + error, np.ones_like(states)

    states = np.linspace(-1, 1, 100)[:, None]
    fine, _ = resolving_steps(solver, first, states, 1.0, 1e-6, ALL_SMOOTH)
    kinked, _ = resolving_steps(solver, first, states, 1.0, 1e-6, states[:, 0] < 0)
    assert (fine, kinked) == (384, 24)


def spring(force) -> Problem:
    return Problem(
        name="spring",
        dynamics=lambda x, u: [x[1], -force(x[0]) + u[0]],
        domain=Box([-3, -2], [3, 2]),
        alphabet=[-1.0, 0.0, 1.0],
        default=0.0,
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        settings=SsacSettings(rule="steepest"),
    )


def batch(problem: Problem, **changes):
    problem = problem.replace(settings=dataclasses.replace(problem.settings, **changes))
    return batch_controller(Formulation.of(problem, transcribe(problem)))


PIECEWISE = {
    "table": lambda x: np.interp(x, np.linspace(-3, 3, 13), np.sin(np.linspace(-3, 3, 13))),
    "play": lambda x: ca.fmax(x - 0.3, 0) + ca.fmin(x + 0.3, 0),
    "stiffer when pushed": lambda x: ca.if_else(x > 0, 2 * x, x),
    "friction": lambda x: x + 0.1 * ca.fabs(x),
}


@pytest.mark.parametrize("name", PIECEWISE)
def test_kinks_do_not_drive_the_choice_of_steps(name):
    problem = spring(PIECEWISE[name])
    found = batch(problem)
    assert found.settings.steps <= 64
    exact, states = batch(problem, steps=2048), problem.domain.sample(20_000, 7)
    sure = ~several(exact.masks(states))
    assert np.mean((found.symbols(states) != exact.symbols(states))[sure]) < 1e-3


SYMBOLS, WAVES = np.linspace(-1, 1, 9), 24
PHASE = Problem(
    name="phase",
    dynamics=lambda x, u: [1.0, u[0]],
    domain=Box([0, -1], [2 * np.pi, 1], periodic=[True, False]),
    alphabet=SYMBOLS,
    default=0.0,
    horizon=1.0,
    running_cost=lambda x: x[1] ** 2 + 0.3 * (1 - ca.cos(WAVES * x[0])),
    settings=SsacSettings(gamma=-1.0),
    max_level=0,
)


def exact_phase(x):
    """Return the best symbols of states (B, 2) of `PHASE`, by integrals in closed form."""
    waves = (np.sin(WAVES * (x[:, 0] + 1)) - np.sin(WAVES * x[:, 0])) / WAVES
    cost = x[:, 1] ** 2 + 0.3 * (1 - waves)
    return ((2 * x[:, 1:] * SYMBOLS + cost[:, None]) ** 2).argmin(axis=1)


def test_a_cost_that_decides_is_resolved_where_the_gradients_need_no_steps():
    states = PHASE.domain.sample(50_000, 1)
    assert np.mean(batch(PHASE).symbols(states) != exact_phase(states)) < 1e-3
    assert np.mean(batch(PHASE, steps=4).symbols(states) != exact_phase(states)) > 0.1


def test_agreement_at_more_steps_shows_what_the_policy_s_own_steps_hide():
    problem = PHASE.replace(
        settings=dataclasses.replace(PHASE.settings, steps=4), partitions=[128, 16], max_level=2
    )
    policy = synthesize(problem)
    own, finer = agreement(policy, 20_000), agreement(policy, 20_000, steps=100)
    assert own.share > 0.9 > 0.8 > finer.share
    with pytest.raises(ProblemError, match="`steps` must be a whole number >= 1.*got 0"):
        agreement(policy, 100, steps=0)
    with pytest.raises(ProblemError, match="`steps` .* sSAC.*`controller`"):
        agreement(policy, 100, controller=policy, steps=10)


@pytest.mark.parametrize("seed", range(3))
def test_fast_states_of_random_problems_do_not_change_symbols_off_ties(seed):
    random = np.random.default_rng(seed)
    speed, waves, mass = np.exp(random.uniform(1, 5)), random.integers(1, 4), random.uniform(0.3, 2)
    problem = Problem(
        name="fast",
        dynamics=lambda x, u: [x[1], -ca.sin(x[0]) / mass + u[0] * (1 + 0.5 * ca.cos(x[2])), speed],
        domain=Box([-2, -2, 0], [2, 2, 2 * np.pi], periodic=[False, False, True]),
        alphabet=np.linspace(-1, 1, 5),
        default=0.0,
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2 + mass * x[1] ** 2 + 1 - ca.cos(waves * x[2]),
        settings=SsacSettings(rule=["schedule", "steepest"][seed % 2]),
    )
    found = batch(problem)
    finer, states = batch(problem, steps=8 * found.settings.steps), problem.domain.sample(5000, 3)
    masks = finer.masks(states)
    sure = ~several(masks) & last_any(masks != 0)
    assert np.mean((found.symbols(states) != finer.symbols(states))[sure]) <= 1e-3


def test_a_model_too_stiff_for_any_steps_is_refused_as_stiff():
    problem = spring(lambda x: x).replace(
        dynamics=lambda x, u: [-1e6 * (x[0] - x[1]), -x[1] + u[0]]
    )
    with pytest.raises(ProblemError, match="`horizon` must be shorter.* is stiff: .* 1e\\+06 per"):
        batch(problem)
