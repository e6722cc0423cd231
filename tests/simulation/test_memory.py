"""Closed loops that remember: least times of symbols and inputs, forbidden transitions, delay."""

import dataclasses
import itertools

import numpy as np
import pytest

from capsyn import (
    Alphabet,
    Box,
    Problem,
    SsacSettings,
    Switching,
    monte_carlo,
    online_controller,
    simulate,
    synthesize,
)
from capsyn.errors import CapsynWarning, ProblemError
from support.closed_loops import BACKENDS

both = pytest.mark.parametrize("backend", BACKENDS)


def house(**changes):
    """Return a house with heating and cooling, in minutes."""
    fields = {
        "name": "house",
        "dynamics": lambda x, u: [(1.5 - 0.1 * x[0] + u[0]) / 10],
        "domain": Box([10], [30], names=["T"]),
        "alphabet": Alphabet([0, 2, -2], names=["off", "heat", "cool"]),
        "default": 0.6,
        "horizon": 15.0,
        "running_cost": lambda x: (x[0] - 21) ** 2,
        "settings": SsacSettings(rule="steepest", sample_time=0.5),
        "partitions": 20,
        "max_level": 1,
        "outside": "nearest",
        "time_unit": "min",
        "switching": Switching(
            hold={"heat": 10, "off": 5, "cool": 10},
            forbidden=[("heat", "cool"), ("cool", "heat")],
        ),
    }
    return Problem(**fields | changes)


def rooms(**changes):
    """Return two rooms, a compressor of three settings that must rest, and a valve that is free."""
    settings = [[0, 0], [1, 0], [1, 1], [2, 0], [2, 1]]
    fields = {
        "name": "rooms",
        "dynamics": lambda x, u: [
            0.5 - 0.1 * x[0] - 0.5 * u[0] * (1 - 0.5 * u[1]),
            0.4 - 0.1 * x[1] - 0.3 * u[0] * u[1],
        ],
        "domain": Box([-2, -2], [2, 2]),
        "alphabet": Alphabet(settings, inputs=["compressor", "valve"]),
        "default": [0.5, 0.5],
        "horizon": 3.0,
        "running_cost": lambda x: x[0] ** 2 + x[1] ** 2,
        "settings": SsacSettings(rule="steepest", sample_time=0.1),
        "max_level": 2,
        "outside": "nearest",
        "switching": Switching(price={"compressor": 0.01}, hold={"compressor": 1.0}),
    }
    return Problem(**fields | changes)


def runs_of(values):
    """Return the lengths of runs of equal values, but for the last, and what they are."""
    return [(key, len(list(group))) for key, group in itertools.groupby(values)][:-1]


@both
def test_least_times_of_symbols_and_forbidden_transitions(backend):
    policy = synthesize(house())
    found = simulate(policy, np.linspace(12, 28, 40)[:, None], 300, noise=0.5, backend=backend)
    held = {0: 10, 1: 20, 2: 20}
    seen = set()
    for symbols in found.symbols.tolist():
        seen |= set(itertools.pairwise(key for key, _ in itertools.groupby(symbols)))
        assert all(length >= held[key] for key, length in runs_of(symbols))
    assert seen == {(0, 1), (1, 0), (0, 2), (2, 0)}


@both
def test_an_input_is_held_while_others_change(backend):
    policy = synthesize(rooms())
    states = policy.domain.sample(40, 1)
    found = simulate(policy, states, 30, noise=0.3, backend=backend)
    valve = []
    for controls in found.controls:
        assert all(length >= 10 for _, length in runs_of(controls[:, 0].tolist()))
        valve += [length for _, length in runs_of(controls[:, 1].tolist())]
    assert min(valve) < 5  # which need not wait
    assert (found.switches > 0).all()


def test_backends_take_the_same():
    for problem in (house(), rooms()):
        policy = synthesize(problem)
        states = policy.domain.sample(16, 2)
        one, two = (
            simulate(policy, states, 40, noise=0.3, backend=backend, seed=3) for backend in BACKENDS
        )
        assert np.array_equal(one.symbols, two.symbols)
        assert np.array_equal(one.switches, two.switches)
        for found in (one, two):
            changed = np.diff(found.symbols, axis=1) != 0
            assert np.array_equal(changed.sum(axis=1), found.switches)


def test_a_million_steps_keep_the_rules():
    policy = synthesize(house())
    found = simulate(policy, policy.domain.sample(500, 4), 1000, noise=1.0)
    symbols = found.symbols
    assert symbols.size == 1_000_000
    before, after = symbols[:, :-1], symbols[:, 1:]
    assert not ((before == 1) & (after == 2) | (before == 2) & (after == 1)).any()
    time = np.arange(symbols.shape[1])
    start = np.maximum.accumulate(
        np.where(np.diff(symbols, axis=1, prepend=-9) != 0, time, 0), axis=1
    )
    held = (time - start + 1)[:, :-1][before != after]
    least = np.array([10, 20, 20])[before[before != after]]
    assert (held >= least).all() and len(held) > 5000


def test_one_time_for_all_overrides_those_of_symbols():
    policy = synthesize(house())
    found = simulate(policy, [21.0], 100, noise=0.5, min_dwell=2.0)
    assert min(length for _, length in runs_of(found.symbols.tolist())) == 4
    with pytest.warns(CapsynWarning, match="hold of 10 min is longer than the run of 5 min"):
        simulate(policy, [21.0], 5)


def test_the_plant_has_the_delay_that_its_policy_compensates():
    sampled = SsacSettings(rule="steepest", sample_time=2.0)  # as long as the delay
    plain = house(switching=Switching(), delay=2.0, settings=sampled, max_level=3)
    later = synthesize(plain)
    states = later.domain.sample(60, 5)
    known = simulate(later, states, 200)
    assert np.array_equal(known.states, simulate(later, states, 200, delay=2.0).states)
    ideal = simulate(synthesize(plain.replace(delay=0.0)), states, 200)
    ignored = simulate(synthesize(plain.replace(delay=0.0)), states, 200, delay=2.0)

    def ripple(found):
        return found.states[:, 50:, 0].std()

    assert ripple(known) < 1.02 * ripple(ideal) < 0.7 * ripple(ignored)
    target = Box([18], [24], names=["T"])
    trials = monte_carlo(later, 20, duration=50, target=target)
    assert trials.delays.tolist() == [2.0] * 20 and trials.conditions["delay"] == 2.0


def test_trials_say_their_least_times():
    policy = dataclasses.replace(synthesize(house()), target=Box([18], [24], names=["T"]))
    conditions = monte_carlo(policy, 5, duration=50).conditions
    assert conditions["min_dwell"] == 0.0
    assert conditions["holds"] == {"off": 5.0, "heat": 10.0, "cool": 10.0}


def test_online_controllers_keep_least_times_and_refuse_forbidden_transitions():
    hold = house().switching.hold
    controller = online_controller(house(switching=Switching(price="1%", hold=hold)))
    runs = runs_of(simulate(controller, [25.0], 100, noise=0.5).symbols.tolist())
    least = {-1: 1, 0: 10, 1: 20, 2: 20}
    assert all(length >= least[key] for key, length in runs) and len(runs) > 4
    assert (1, 2) in set(itertools.pairwise(key for key, _ in runs))
    one_way = Switching(hold=hold, forbidden=[("heat", "cool")])
    with pytest.raises(ProblemError, match="`source` must have no forbidden transitions"):
        online_controller(house(switching=one_way))
