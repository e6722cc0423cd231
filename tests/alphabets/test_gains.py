"""Gains of candidates: gradients are those of sSAC with them as symbols; the greedy choice."""

from __future__ import annotations

import dataclasses
import itertools

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Problem, SsacSettings, problems
from capsyn.alphabets.candidates import candidates_of, with_alphabet
from capsyn.alphabets.gains import candidate_gains, candidate_gradients, greedy, is_affine
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.ssac import batch_controller
from capsyn.modelling.transcription import transcribe
from support.backends import needs_compiler


def made(dynamics, m=2, **changes) -> Problem:
    """Return a problem of two states and `m` inputs."""
    options = {
        "name": "made",
        "dynamics": dynamics,
        "domain": Box([-1, -1], [1, 1]),
        "alphabet": np.eye(m),
        "default": np.full(m, 0.25),
        "horizon": 0.5,
        "running_cost": lambda x: x[0] ** 2 + ca.cos(x[1]),
        "settings": SsacSettings(steps=8, control_weight=0.1),
    }
    return Problem(**options | changes)


def turned(x, u):
    """Return rates under a thrust u[0] in the direction u[1]."""
    return [u[0] * ca.cos(u[1] + x[1]), u[0] * ca.sin(u[1]) - x[0]]


CASES = {
    "affine": lambda: made(lambda x, u: [x[1] * u[0] + u[1], ca.sin(x[0]) - u[1]]),
    "not affine": lambda: made(turned),
    "steps to be found": lambda: made(turned, settings=SsacSettings()),
    "affine, law": lambda: made(
        lambda x, u: [x[1] * u[0] + u[1], ca.sin(x[0]) - u[1]],
        default=lambda x: [ca.cos(x[0]), -x[1]],
    ),
    "law, exogenous": lambda: problems.plain("building"),
    "map": lambda: made(
        lambda x, u: [x[0] + 0.1 * x[1], 0.9 * x[1] + u[0] * ca.cos(x[0]) - u[1]],
        discrete=True, sample_time=0.1, horizon=5,
        settings=SsacSettings(sensitivity="first order"),
    ),
}  # fmt: skip


COMPILED = ("affine", "affine, law", "map")
"""Cases that are computed in C, too: each takes the compiler a while."""


@pytest.mark.parametrize(
    ("case", "backend"),
    [(case, "numpy") for case in CASES]
    + [pytest.param(case, "c", marks=needs_compiler) for case in COMPILED],
)
def test_gradients_are_those_of_ssac_with_the_candidates_as_symbols(case, backend):
    problem = CASES[case]()
    values = np.random.default_rng(1).uniform(-1, 1, (5, problem.alphabet.m))
    other = with_alphabet(problem, candidates_of(problem, values))
    states = problem.space.sample(70)
    own = batch_controller(Formulation.of(problem, transcribe(problem)), "numpy")
    settings = dataclasses.replace(problem.settings, steps=own.settings.steps)
    formulation = Formulation.of(other, transcribe(other))
    formulation = dataclasses.replace(formulation, settings=settings, prices=None, delay=0.0)
    expected = batch_controller(formulation, "numpy").solve(states)
    found = candidate_gradients(problem, values, states, backend)
    assert found.shape == (70, 5) and np.ptp(found) > 0.01
    assert (np.abs(found - expected.gradients) <= 1e-9 * expected.scales + 1e-13).all()
    gains = candidate_gains(problem, values, states, backend)
    wanted = -(expected.gradients + problem.settings.efforts(values))
    np.testing.assert_allclose(gains, np.maximum(wanted, 0), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("dynamics", "affine"),
    [
        (lambda x, u: [x[1] ** 2 * u[0] + u[1], ca.if_else(x[0] > 0, u[0], -u[1]) / x[0]], True),
        (lambda x, u: [ca.sin(x[1]), -x[0]], True),
        (lambda x, u: [u[0] ** 2, u[1]], False),
        (lambda x, u: [u[0] * u[1], x[0]], False),
        (lambda x, u: [ca.if_else(u[0] > 0.5, 1.0, 0.0), u[1]], False),
        (lambda x, u: [ca.fmax(u[0], 0), u[1]], False),
        (lambda x, u: [x[0] / (1 + u[0]), u[1]], False),
    ],
)
def test_what_is_affine_in_the_inputs(dynamics, affine):
    assert is_affine(transcribe(made(dynamics))) == affine


def test_no_gain_where_the_gradient_is_not_finite():
    problem = made(lambda x, u: [ca.sqrt(u[0]) - x[0], u[1]])
    values = np.array([[-1.0, 0], [1.0, 0]])
    gains = candidate_gains(problem, values, problem.space.sample(20), "numpy")
    assert np.isfinite(gains).all() and not gains[:, 0].any() and gains[:, 1].any()


def test_the_greedy_choice_adds_most_at_each_turn_and_the_first_of_equals():
    rng = np.random.default_rng(3)
    for _ in range(20):
        gains = np.round(np.maximum(rng.normal(size=(40, 9)), 0) * 4) / 4  # exact sums, many ties
        gains[:, 7] = gains[:, 2]
        keep = [5] if rng.random() < 0.5 else []
        chosen = list(keep)
        while len(chosen) < 4:
            totals = [gains[:, [*chosen, k]].max(axis=1).sum() for k in range(9)]
            chosen.append(int(np.argmax(totals)))
        assert greedy(gains, 4, keep).tolist() == chosen


def test_the_greedy_choice_keeps_to_its_bound_and_stops_where_nothing_adds():
    rng = np.random.default_rng(4)
    gains = np.maximum(rng.normal(size=(30, 8)), 0)

    def total(chosen):
        return gains[:, list(chosen)].max(axis=1).mean()

    best = max(total(each) for each in itertools.combinations(range(8), 3))
    assert (1 - 1 / np.e) * best <= total(greedy(gains, 3)) <= best
    gains[:, 5] = gains.max(axis=1) + 1
    assert greedy(gains, 4).tolist() == [5]
    assert greedy(gains, 2, keep=[3, 1, 3]).tolist() == [3, 1]
    assert greedy(np.zeros((10, 3)), 2).tolist() == []
