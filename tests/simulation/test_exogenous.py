"""Closed loops with exogenous inputs: constant, by time, by steps, drawn; what follows them."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import (
    Alphabet,
    Box,
    Problem,
    SsacSettings,
    Uniform,
    monte_carlo,
    simulate,
    synthesize,
    tracking,
)
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.simulation.exogenous import exogenous_signal, steps_from_csv


def tank(**changes):
    """A tank whose level h is filled by a pump, and empties into a load that is measured."""
    own = {
        "name": "tank",
        "dynamics": lambda x, u, w: [u[0] - w[1] * x[0]],
        "domain": Box([0], [2], ["h"], ["m"]),
        "exogenous": Box([0.5, 0.1], [1.5, 0.4], ["wanted", "load"], ["m", "1/s"]),
        "alphabet": Alphabet([0, 1], ["off", "on"], ["pump"]),
        "default": lambda x, w: w[0] * w[1],
        "horizon": 0.5,
        "running_cost": lambda x, w: (x[0] - w[0]) ** 2,
        "target": lambda x, w: ca.fabs(x[0] - w[0]) < 0.1,
        "settings": SsacSettings(rule="steepest", sample_time=0.02, steps=4),
        "outside": "nearest",
        "partitions": (20, 10, 2),
        "max_level": 2,
    }
    return Problem(**own | changes)


POLICY = synthesize(tank())
TOLD = POLICY.exogenous


@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_a_constant_is_the_policy_at_it(backend):
    w = [1.2, 0.3]
    told = simulate(POLICY, [[0.3], [1.9]], 4, exogenous=w, backend=backend)
    fixed = simulate(POLICY.at(w), [[0.3], [1.9]], 4, backend=backend)
    for name in ("states", "symbols", "costs", "arrived"):
        np.testing.assert_array_equal(getattr(told, name), getattr(fixed, name))
    assert (told.exogenous == w).all() and fixed.exogenous.shape == (2, 201, 0)


@pytest.mark.parametrize("backend", ["c", "numpy"])
@pytest.mark.parametrize(
    "exogenous",
    [
        lambda t: [1.2 if t >= 2 else 0.8, 0.3],
        {"wanted": {0: 0.8, 2: 1.2}, "load": 0.3},
        {"wanted": [(0, 0.8), (2, 1.2)], "load": lambda t: 0.3},
        {"load": np.array([0.3]), "wanted": {-5: 7, 0: 0.8, 2.0: 1.2, 99: 0}},
    ],
)
def test_steps_are_taken_at_their_sample(exogenous, backend):
    found = simulate(POLICY, [[0.3]], 4, exogenous=exogenous, backend=backend)
    times = found.times
    np.testing.assert_array_equal(found.exogenous[0, :, 0], np.where(times < 2, 0.8, 1.2))
    first = simulate(POLICY, [[0.3]], 2, exogenous=[0.8, 0.3], backend=backend)
    second = simulate(POLICY, first.states[:, -1], 2, exogenous=[1.2, 0.3], backend=backend)
    np.testing.assert_array_equal(found.states[:, :101], first.states)
    np.testing.assert_array_equal(found.states[:, 100:], second.states)
    np.testing.assert_array_equal(found.symbols[:, 100:], second.symbols)


@pytest.mark.filterwarnings("ignore:`exogenous` leaves its box")
@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_compiled_and_numpy_loops_agree(seed):
    rng = np.random.default_rng(seed)
    steps = {float(k): float(v) for k, v in enumerate(rng.uniform(0.4, 1.6, 4))}
    options = {
        "exogenous": {"wanted": steps, "load": rng.uniform(0.1, 0.4, 3)},
        "noise": [0.02, 0.01, 0.005],
        "delay": 0.03,
    }
    loops = [simulate(POLICY, [[0], [1], [2]], 4, backend=b, **options) for b in ("c", "numpy")]
    for name in ("states", "symbols", "exogenous", "switches", "outside"):
        np.testing.assert_array_equal(*(getattr(loop, name) for loop in loops))


def test_functions_and_other_plants_are_told():
    def law(time, x, w):
        return np.where(x < w[:, :1], 1.0, 0.0)

    own = simulate(law, [0.3], 4, 50, model=POLICY, exogenous=[1.2, 0.3])
    assert abs(own.states[-1, 0] - 1.2) < 0.02
    leaky = simulate(
        POLICY, [0.3], 4, model=lambda x, u, w, p: [u[0] - (w[1] + p[0]) * x[0]],
        parameters={"leak": 0.0}, exogenous=[1.2, 0.3],
    )  # fmt: skip
    np.testing.assert_allclose(
        leaky.states, simulate(POLICY, [0.3], 4, exogenous=[1.2, 0.3]).states, atol=1e-12
    )


LEAVES = "`exogenous` leaves its box, which counts as outside the domain: "


@pytest.mark.parametrize(
    ("exogenous", "text"),
    [
        ([7, 0.3], "wanted = 7 is not in [0.5, 1.5]"),
        ({"wanted": {0: 1, 2: 0.25, 99: 9}, "load": 0.3}, "wanted = 0.25 is not in [0.5, 1.5]"),
        (
            lambda t: [1.5 + t, 0.1 - t],
            "wanted = 5.5 is not in [0.5, 1.5], load = -3.9 is not in [0.1, 0.4]",
        ),
    ],
)
def test_what_leaves_its_box_is_named_once(exogenous, text):
    with pytest.warns(CapsynWarning) as caught:
        found = simulate(POLICY, [0.3], 4, exogenous=exogenous)
    assert [str(one.message) for one in caught] == [LEAVES + text]
    assert found.outside > 0


def test_trials_name_what_leaves_its_box():
    drawn = {"wanted": Uniform(0.5, 1.5), "load": Uniform(0.0, 0.1)}
    with pytest.warns(CapsynWarning) as caught:
        monte_carlo(POLICY, 20, duration=1.0, exogenous=drawn)
    (message,) = (str(one.message) for one in caught)
    assert message.startswith(f"{LEAVES}load = 0.0") and message.endswith("not in [0.1, 0.4]")


def test_files_hold_exogenous_inputs(tmp_path):
    found = simulate(POLICY, [[0.3], [1.9]], 0.1, exogenous=[1.2, 0.3])
    found.save(tmp_path / "t.csv")
    header, first, *_ = (tmp_path / "t.csv").read_text().splitlines()
    assert header == "trial,time,h,wanted,load,cost,symbol,pump"
    assert first == "0,0.0,0.3,1.2,0.3,0.0,1,1.0"
    assert found.to_json()["exogenous_names"] == ("wanted", "load")


def test_steps_come_from_csv(tmp_path):
    path = tmp_path / "steps.csv"
    path.write_text("time,wanted,load\n0,0.8,0.3\n\n2,1.2,\n3,,0.2\n")
    assert steps_from_csv(path) == {"wanted": {0: 0.8, 2: 1.2}, "load": {0: 0.3, 3: 0.2}}
    for text, message in (
        ("", "it has no header"),
        ("time\n1\n", "must have a column 'time', then one"),
        ("t,wanted\n0,1\n", "must have a column 'time', then one"),
        ("time,wanted\n0\n", "must have 2 numbers in row 2"),
        ("time,wanted\n,1\n", "must have 2 numbers in row 2"),
        ("time,wanted\n0,x\n", "must have 2 numbers in row 2"),
    ):
        path.write_text(text)
        with pytest.raises(ProblemError, match=message):
            steps_from_csv(path)
    with pytest.raises(ProblemError, match="cannot be read from .*No such file"):
        steps_from_csv(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("exogenous", "message"),
    [
        (None, "`exogenous` must be given: wanted, load; got None"),
        ([1.0], "`exogenous` must be numbers of shape (..., 2): wanted, load; got shape (1,)"),
        ([1.0, np.nan], "`exogenous` must be finite; 'load' is not"),
        ("x", "`exogenous` must be numbers; got 'x'"),
        ({"wanted": 1}, "`exogenous` must name wanted, load; 'load' is missing"),
        (
            {"wanted": 1, "load": 1, "h": 1},
            "`exogenous` must name wanted, load; 'h' is no exogenous input",
        ),
        ({"wanted": {2: 1, 0: 1}, "load": 1}, "`exogenous wanted` must be steps (time, value)"),
        ({"wanted": {}, "load": 1}, "`exogenous wanted` must be steps (time, value)"),
        ({"wanted": lambda t: 1 / 0, "load": 1}, "`exogenous wanted` failed: ZeroDivisionError"),
        (lambda t: [1], "`exogenous` must return 2 finite number(s); got array([1.]) at time 0"),
        (np.ones((3, 2)), "`exogenous` must fit initial states of shape"),
    ],
)
def test_refusals(exogenous, message):
    with pytest.raises(ProblemError) as caught:
        simulate(POLICY, [[0.3], [1.9]], 1, exogenous=exogenous)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_nothing_is_told_to_a_plant_without_exogenous_inputs():
    fixed = POLICY.at([1, 0.2])
    with pytest.raises(ProblemError, match="`exogenous` must be left out"):
        simulate(fixed, [0.3], 1, exogenous=[1, 0.2])
    with pytest.raises(ProblemError, match=r"must have 1 state\(s\) and 1 input\(s\) like the con"):
        simulate(fixed, [0.3], 1, model=POLICY)


def test_steps_hold_at_times_that_are_no_whole_samples():
    signal = exogenous_signal({"a": {0: 1, 0.25: 2}}, Box([0], [3], ["a"]), (1,), 0.1, 4)
    assert signal.samples[:, 0].tolist() == [1, 1, 1, 2, 2]
    thirds = exogenous_signal({"a": {0: 1, 1.0: 2}}, Box([0], [3], ["a"]), (1,), 1 / 3, 4)
    assert thirds.samples[:, 0].tolist() == [1, 1, 1, 2, 2]  # 3 * (1 / 3) is 1, rounded or not


def test_trials_draw_from_the_box_unless_told():
    found = monte_carlo(POLICY, 200, duration=40, exogenous={"wanted": Uniform(0.8, 1.0)})
    wanted, load = found.exogenous.T
    assert (wanted >= 0.8).all() and (wanted <= 1.0).all() and np.ptp(wanted) > 0.15
    assert (load >= 0.1).all() and (load <= 0.4).all() and np.ptp(load) > 0.25
    assert found.initial.shape == found.final.shape == (200, 1)
    assert found.success_rate == 1.0
    said = found.to_json()["conditions"]["exogenous"]
    assert said == {"wanted": {"low": 0.8, "high": 1.0}, "load": {"low": 0.1, "high": 0.4}}
    again = monte_carlo(POLICY, 10, duration=40, exogenous={"wanted": Uniform(0.8, 1.0)})
    np.testing.assert_array_equal(again.exogenous, found.exogenous[:10])


def test_trials_say_how_closely_states_follow():
    options = {"duration": 80.0, "hold": 1.0, "exogenous": {"wanted": {0: 0.8, 40: 1.2}}}
    found = monte_carlo(POLICY, 40, track={"h": "wanted"}, **options)
    plain = monte_carlo(POLICY, 40, **options)
    np.testing.assert_array_equal(found.final, plain.final)
    (figures,) = found.tracking.values()
    one = {"wanted": {0: 0.8, 40: 1.2}, "load": found.exogenous[7, 1]}
    alone = tracking(simulate(POLICY, found.initial[7], 80.0, exogenous=one), "h", "wanted")
    for name in ("rms", "bias", "overshoot", "settling"):
        np.testing.assert_equal(getattr(figures, name)[7], getattr(alone, name))
    data = found.to_json()
    assert data["tracking"]["h - wanted"]["bias"]["max"] < 0.02
    trial = found.trial(7)
    assert trial["exogenous"] == {"wanted": {"0": 0.8, "40": 1.2}, "load": one["load"]}
    with pytest.raises(ProblemError, match="`reference` must be one of"):
        monte_carlo(POLICY, 4, track={"h": "level"}, **options)
    with pytest.raises(ProblemError, match="`track` must be a mapping"):
        monte_carlo(POLICY, 4, track="h", **options)


def test_pairs_are_tuples_and_lists_are_numbers_for_each_trial():
    x0 = np.full((2, 2, 1), 0.5)
    lists = {"wanted": [[0.8, 0.9], [1.0, 1.1]], "load": 0.2}
    run = simulate(POLICY, x0, 1, exogenous=lists)
    assert (run.exogenous[:, :, 0, 0] == lists["wanted"]).all()
    steps = simulate(POLICY, x0, 1, exogenous={"wanted": [(0.0, 0.8), (0.5, 0.9)], "load": 0.2})
    assert (steps.exogenous[..., 0, 0] == 0.8).all() and (steps.exogenous[..., -1, 0] == 0.9).all()


def test_constants_take_no_memory_for_each_sample():
    constants = {"wanted": 1.0, "load": 0.2}
    assert exogenous_signal(constants, TOLD, (3,), 1.0, 10**15).samples is None


def test_conditions_do_not_repeat_what_each_trial_was_told():
    each = np.linspace(0.8, 1.0, 500)
    found = monte_carlo(POLICY, 500, duration=1, exogenous={"wanted": each})
    assert found.conditions["exogenous"]["wanted"] == "given for each trial"
    assert (found.exogenous[:, 0] == each).all()
    one = monte_carlo(POLICY, 5, duration=1, exogenous=[0.9, 0.2])
    assert one.conditions["exogenous"] == [0.9, 0.2]


def test_trials_may_measure_exogenous_inputs_with_noise():
    run = monte_carlo(POLICY, 50, duration=20, noise=[0.0, 0.3, 0.0], seed=1)
    none = monte_carlo(POLICY, 50, duration=20, noise=[0.0, 0.0, 0.0], seed=1)
    plain = monte_carlo(POLICY, 50, duration=20, seed=1)
    assert run.noises.shape == (50, 3) and (none.switches == plain.switches).all()
    assert run.switches.sum() > 2 * plain.switches.sum()
