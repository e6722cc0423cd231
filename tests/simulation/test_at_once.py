"""Readings that do not wait for the dwell time, in closed loops: exact samples of switches."""

import dataclasses

import numpy as np
import pytest

from capsyn import monte_carlo, online_controller, simulate
from capsyn.errors import ProblemError
from capsyn.simulation.closed_loop import new_record
from capsyn.simulation.experiment import set_up
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import plant_of
from support.at_once import DWELL, NAN, RATE, STORIES
from support.closed_loops import BACKENDS, assert_same_trials, relay, relay_problem

both = pytest.mark.parametrize("backend", BACKENDS)
stories = pytest.mark.parametrize("story", STORIES, ids=lambda story: story.name)


class Readings:
    """Readings in place of noise, for a state that stays at 0."""

    def __init__(self, values):
        self.values = np.array(values)

    def draw(self, start, stop):
        return lambda samples: np.tile(self.values[:samples, None], (stop - start, 1, 1))


def run(policy, readings, backend, **options):
    """Return the record and the trials of two loops that see the same readings."""
    duration = len(readings) / RATE
    options = LoopOptions(duration=duration, rate=RATE, backend=backend, **options)
    experiment = set_up(policy, plant_of(policy), options)
    trials = experiment.trials(np.zeros((2, 1)), np.zeros(2), np.zeros((2, 0)))
    record = new_record(2, len(readings), 1, 1)
    experiment.run(trials, Readings(readings), record)
    assert (record.symbols[0] == record.symbols[1]).all()
    return record, trials


@stories
@both
def test_symbols_of_a_story(backend, story):
    record, trials = run(story.policy, story.readings, backend)
    assert record.symbols[0].tolist() == list(story.symbols)
    assert (record.controls[0, :, 0] == story.policy.controls[list(story.symbols), 0]).all()
    assert trials["switches"].tolist() == [story.switches] * 2


@both
def test_an_option_overrides_the_policy(backend):
    waits, at_once = STORIES[2], STORIES[3]
    for policy, told in ((waits.policy, True), (at_once.policy, False)):
        record, _ = run(policy, at_once.readings, backend, outside_at_once=told)
        assert (record.symbols[0].tolist() == list(at_once.symbols)) is told
    record, _ = run(at_once.policy, waits.readings, backend, outside_at_once=False)
    assert record.symbols[0].tolist() == list(waits.symbols)


@both
def test_without_a_safe_symbol_a_reading_that_is_not_finite_ends_a_loop(backend):
    policy = dataclasses.replace(STORIES[0].policy, outside="nearest")
    _, trials = run(policy, [0.5, NAN, 0.5], backend)
    assert trials["end"].tolist() == [1, 1]


@both
def test_a_state_that_leaves_the_domain_switches_at_once(backend):
    # up at 1 a time unit from 0.75, 8 samples a unit: beyond 1 at sample 3, and back under -1
    slow = relay([0, 0], outside=1, min_dwell=1.0)
    options = {"duration": 2.0, "rate": 8, "substeps": 1, "backend": backend}
    waits = simulate(slow, [0.75], **options)
    at_once = simulate(slow, [0.75], outside_at_once=True, **options)
    assert waits.symbols.tolist() == [0] * 8 + [1] * 8
    assert at_once.symbols.tolist() == [0] * 3 + [1] * 8 + [0] * 5
    own = simulate(dataclasses.replace(slow, outside_at_once=True), [0.75], **options)
    assert (own.symbols == at_once.symbols).all()


def test_trials_are_the_same_in_numpy_and_compiled_and_told_apart():
    policy = relay([0, 0, 1, 0], outside=1, min_dwell=0.4)
    options = {"trials": 64, "duration": 3, "rate": 10, "target": lambda x: x[0] > 5, "noise": 0.3}
    c, numpy = (
        monte_carlo(policy, backend=backend, outside_at_once=True, **options)
        for backend in BACKENDS
    )
    assert_same_trials(c, numpy)
    waits = monte_carlo(policy, **options)
    assert (c.switches > waits.switches).any()
    assert c.conditions["outside_at_once"] is True and "outside_at_once" not in waits.conditions


def test_only_policies_have_a_rule_outside():
    problem = relay_problem()
    for controller in (lambda t, x: -x, online_controller(problem)):
        with pytest.raises(ProblemError, match="`outside_at_once` must be given for policies only"):
            simulate(controller, [0.5], 1, 10, model=problem, outside_at_once=True)


def test_a_lost_reading_does_not_wait_whatever_the_controller():
    # a function says 5 where it reads nothing
    controls = {True: 1.0, False: -1.0}

    def controller(time, states):
        return np.array([[5.0 if np.isnan(x) else controls[x < 0]] for x in states[:, 0]])

    policy = STORIES[0].policy
    options = LoopOptions(duration=8 / RATE, rate=RATE, model=policy, min_dwell=DWELL)
    experiment = set_up(controller, plant_of(controller, policy), options)
    trials = experiment.trials(np.zeros((1, 1)), np.zeros(1), np.zeros((1, 0)))
    record = new_record(1, 8, 1, 1)
    experiment.run(trials, Readings([-1, 1, NAN, 1, 1, 1, -1, 1]), record)
    assert record.controls[0, :, 0].tolist() == [1, 1, 5, 5, 5, -1, -1, -1]


def test_three_readings_are_the_dwell_time_of_the_stories():
    assert DWELL * RATE == 3
