"""Closed loops of sSAC without cells: compiled ones against NumPy, both against plain sSAC."""

import dataclasses

import numpy as np
import pytest

from capsyn import Alphabet, Ball, Box, Problem, SsacSettings, Switching, simulate
from capsyn.alphabets.candidates import with_alphabet
from capsyn.alphabets.loops.alphabet_loops import FIGURES, AlphabetLoops
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.ssac import batch_controller
from capsyn.modelling.transcription import transcribe
from capsyn.verification.trials import TrialOptions
from support.backends import needs_compiler

LEVELS = np.linspace(-1, 1, 9)
COUNT = 12
SETS = [(0, 4, 8), (1, 3, 6, 8), (4,), tuple(range(9)), (0, 8)]


def swing(**changes):
    settings = {"rule": "steepest", "control_weight": 0.05, "steps": 8, "sample_time": 0.1}
    settings |= changes.pop("settings", {})
    return Problem(
        **{
            "name": "swing",
            "dynamics": lambda x, u: [x[1], 2 * np.sin(x[0]) + 3 * u[0]],
            "domain": Box([-np.pi, -6], [np.pi, 6], periodic=[True, False]),
            "alphabet": [-1.0, 0.0, 1.0],
            "default": 0.0,
            "horizon": 0.5,
            "running_cost": lambda x: 1 - np.cos(x[0]) + 0.1 * x[1] ** 2,
            "target": Ball([0, 0], 0.3),
            "outside": "nearest",
            "settings": SsacSettings(**settings),
        }
        | changes
    )


def told(x, u, w):
    return [x[1], u[0] + w[0] - 0.1 * x[1]]


LINEAR = {"dynamics": lambda x, u: [x[1], u[0]], "domain": Box([-1, -1], [1, 1])}
KINDS = {
    "steepest": {},
    "schedule": {"settings": {"rule": "schedule", "gamma": -2.0}},
    "absolute": {"settings": {"rule": "schedule", "alpha_d": -3.0}},
    "default": {"settings": {"on_no_descent": "default"}},
    "price": {"switching": Switching(price=0.2, hold=0.2)},
    "share": {"switching": Switching(price="2%")},
    "share of eq. (8)": {"switching": Switching(price="2%"), "settings": {"rule": "schedule"}},
    "not finite": {
        "dynamics": lambda x, u: [3 * x[0] ** 2 + u[0], 2 * x[1] ** 3 + u[0]],
        "domain": Box([-3, -3], [3, 3]),
        "horizon": 2.0,
        "switching": Switching(price=0.05),
        "settings": {"rule": "schedule", "control_weight": 0.0},
    },
    "inputs": {"switching": Switching(price={"u1": 0.1}, hold={"u1": 0.3})},
    "law": {"default": lambda x: -0.3 * x[1]},
    "error": {**LINEAR, "outside": "error"},
    "symbol": {**LINEAR, "outside": 1},
    "exogenous": {
        "dynamics": told,
        "running_cost": lambda x, w: (x[0] - w[0]) ** 2 + x[1] ** 2,
        "exogenous": Box([-0.5], [0.5]),
        "domain": LINEAR["domain"],
    },
    "no target": {"target": None},
    "map": {
        "dynamics": lambda x, u: [x[0] + 0.1 * x[1], x[1] + 0.3 * u[0]],
        "domain": Box([-1, -1], [1, 1]),
        "discrete": True,
        "sample_time": 0.1,
        "horizon": 8,
        "settings": {"steps": None, "sensitivity": "first order"},
    },
}


def loops_of(problem, backend, **options):
    plan = TrialOptions.of(**{"trials": COUNT, "duration": 2.0, "seed": 3} | options)
    pool = Alphabet(LEVELS, inputs=problem.alphabet.inputs)
    return AlphabetLoops.of(problem, pool, plan, backend=backend)


def same(found, other):
    assert np.array_equal(found.lost, other.lost)
    for name in FIGURES:
        assert found.figures[name].shape == (len(SETS), COUNT)
        np.testing.assert_allclose(
            found.figures[name], other.figures[name], rtol=1e-9, atol=1e-9, err_msg=name
        )
    for one, two in zip(found.used, other.used, strict=True):
        assert np.array_equal(one, two)


@needs_compiler
@pytest.mark.parametrize("kind", KINDS)
def test_compiled_loops_decide_like_sSAC_by_numpy(kind):
    problem = swing(**KINDS[kind])
    compiled, plain = (loops_of(problem, backend) for backend in ("c", "numpy"))
    assert compiled.kernel is not None and plain.kernel is None
    found = compiled.run(SETS)
    same(found, plain.run(SETS))
    if kind == "steepest":  # whatever is run beside it, and however many threads there are
        one = dataclasses.replace(compiled, threads=1).run(SETS[1:2], slice(5, 9))
        for name in FIGURES:
            assert np.array_equal(one.figures[name], found.figures[name][1:2, 5:9])


@needs_compiler
def test_noise_and_delays_are_those_of_trials():
    options = {"noise": 0.05, "delay": 0.13, "disturbance": 0.02}
    both = [loops_of(swing(), backend, **options).run(SETS) for backend in ("c", "numpy")]
    same(*both)


@pytest.mark.parametrize("kind", ["steepest", "schedule", "error"])
def test_a_loop_is_that_of_sSAC_for_the_problem_with_its_alphabet(kind):
    problem, own = swing(**KINDS[kind]), SETS[1]
    loops = loops_of(problem, "auto")
    alphabet = Alphabet(LEVELS[list(own)])
    small = with_alphabet(problem, alphabet)
    controller = batch_controller(Formulation.of(small, transcribe(small)))
    values = np.vstack([alphabet.values, small.default_control])

    def ssac(time, states):
        around = (states[:, 0] + np.pi) % (2 * np.pi) - np.pi if kind != "error" else states[:, 0]
        box = small.domain
        near = np.clip(np.stack([around, states[:, 1]], axis=1), box.lower, box.upper)
        return values[controller.symbols(near)]

    trials = loops.test.trials
    inside = loops.run([own])
    ways = simulate(
        ssac, trials["state"], 2.0, 10.0, model=small, stop_at_target=True,
        substeps=loops.test.experiment.loop.substeps,
    )  # fmt: skip
    kept = ~inside.lost[0]
    assert kept.any()
    np.testing.assert_allclose(
        inside.figures["cost"][0][kept], ways.costs[np.arange(COUNT), ways.last][kept], rtol=1e-9
    )
    assert np.array_equal(inside.figures["switches"][0][kept], ways.switches[kept])


@pytest.mark.parametrize(
    "changes",
    [
        {"delay": 0.2},
        {"switching": Switching(price=0.1), "settings": {"on_no_descent": "default"}},
    ],
)
def test_what_is_not_compiled_is_decided_by_numpy(changes):
    loops = loops_of(swing(**changes), "auto")
    assert loops.kernel is None
    found = loops.run(SETS[:2])
    assert np.isfinite(found.figures["cost"]).all()
    assert found.figures["cost"][0].mean() != found.figures["cost"][1].mean()


def test_states_that_loops_visit_have_the_symbols_in_force():
    loops = loops_of(swing(), "auto")
    states, symbols = loops.visited(SETS[0])
    used = loops.run([SETS[0]]).used[0]
    assert [np.sum(symbols == k) for k in SETS[0]] == used.tolist()
    assert states.shape == (used.sum(), 2) and np.isfinite(states).all()
