"""Figures of tracking against responses whose figures are known."""

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.simulation.simulate import Trajectory
from capsyn.simulation.tracking import tracking


def response(values, wanted, period=0.01):
    """A trajectory of one state that should follow an exogenous input."""
    values, wanted = np.broadcast_arrays(values, wanted)
    size = len(values)
    none = np.zeros(size - 1)
    return Trajectory(
        np.arange(size) * period, values[:, None], none, none[:, None], np.zeros(size),
        np.float64(0), np.int64(0), np.int64(0), np.str_("time"), np.int64(size - 1),
        np.float64(np.nan), ("x", "u"), ("", ""),
        exogenous=wanted[:, None], exogenous_names=("w",), exogenous_units=("",),
    )  # fmt: skip


TIMES = np.arange(1001) * 0.01


def test_a_first_order_response():
    found = tracking(response(1 - np.exp(-TIMES), 1.0), "x", "w")
    assert found.settling == pytest.approx(np.log(50), abs=0.01)
    assert found.overshoot == 0.0
    assert found.rms == pytest.approx(np.sqrt(np.mean(np.exp(-2 * TIMES))))
    assert found.bias == pytest.approx(-np.exp(-TIMES[500:]).mean())


def test_a_second_order_response():
    damping = 0.3
    fast = np.sqrt(1 - damping**2)
    wave = np.cos(fast * 3 * TIMES) + damping / fast * np.sin(fast * 3 * TIMES)
    found = tracking(response(1 - np.exp(-damping * 3 * TIMES) * wave, 1.0), "x", 1.0)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * damping / fast), rel=1e-3)


def test_steps_down_overshoot_below():
    values = np.r_[np.full(100, 2.0), 1.0, 0.4, np.full(98, 0.5)]
    wanted = np.r_[np.full(100, 2.0), np.full(100, 0.5)]
    found = tracking(response(values, wanted), "x", "w")
    assert found.overshoot == pytest.approx(0.1)
    assert found.settling == pytest.approx(0.02) and found.bias == 0.0


def test_the_worst_segment_counts_for_bias_and_settling():
    values = np.r_[np.full(100, 1.1), np.full(100, 1.8)]
    wanted = np.r_[np.full(100, 1.0), np.full(100, 2.0)]
    found = tracking(response(values, wanted), "x", "w", band=0.15)
    assert found.bias == pytest.approx(-0.2) and np.isnan(found.settling)
    assert tracking(response(values, wanted), "x", "w", band=0.25).settling == 0.0
    assert found.rms == pytest.approx(np.sqrt(0.025))


def test_a_reference_that_moves_is_one_segment():
    wanted = np.sin(TIMES)
    found = tracking(response(wanted + 0.1, wanted), "x", "w", band=0.2)
    assert found.bias == pytest.approx(0.1) and found.settling == 0.0


def test_samples_after_the_end_do_not_count():
    values = np.full(101, np.nan)
    values[:11] = 1.0
    one = response(values, 1.0)
    ended = Trajectory(**{**vars(one), "last": np.int64(10)})
    assert tracking(ended, "x", "w").rms == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_has_no_figures(bad):
    values = np.r_[np.full(50, 0.9), bad]
    found = tracking(response(values, 1.0), "x", "w")
    assert np.isnan([found.rms, found.bias, found.overshoot, found.settling]).all()
    assert found.to_json() == dict.fromkeys(("rms", "bias", "overshoot", "settling"), [None])


def test_nothing_answers_a_change_at_the_last_sample():
    values, wanted = np.full(101, 0.9), np.r_[np.full(100, 1.0), 2.0]
    found = tracking(response(values, wanted), "x", "w", band=0.2)
    assert found.bias == pytest.approx(-0.1) and found.settling == 0.0
    assert found.rms == pytest.approx(0.1)


def test_a_ramp_that_then_holds_is_one_move():
    wanted = np.minimum(0.3 * TIMES, 0.8)  # moves for less than half of the time
    found = tracking(response(wanted - 0.1, wanted), "x", "w", band=0.2)
    assert found.bias == pytest.approx(-0.1) and found.settling == 0.0


def test_the_band_is_a_share_of_the_largest_step():
    values = np.r_[1.0, np.full(99, 1.005), 1.0, np.full(99, 2.0)]  # begins on the reference
    wanted = np.r_[np.full(100, 1.0), np.full(100, 2.0)]
    found = tracking(response(values, wanted), "x", "w")
    assert found.settling == pytest.approx(0.01)


def test_periodic_states_go_the_shorter_way():
    run = Trajectory(**{**vars(response(np.full(50, 6.2), 0.1)), "periods": (2 * np.pi,)})
    assert tracking(run, "x", "w").bias == pytest.approx(6.1 - 2 * np.pi)


def test_no_trajectories_have_no_figures():
    one = vars(response(TIMES, 1.0))
    empty = {name: one[name][None][:0] for name in ("states", "exogenous")}
    found = tracking(Trajectory(**{**one, **empty, "last": np.zeros(0, int)}), "x", "w")
    assert found.rms.shape == found.settling.shape == (0,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("y", "w"), "`state` must be one of 'x'; got 'y'"),
        (("x", "v"), "`reference` must be one of 'w'; got 'v'"),
        (("x", np.nan), "`reference` must be a finite number; got nan"),
        (("x", "w", 0), "`band` must be a finite number > 0; got 0"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ProblemError) as caught:
        tracking(response(TIMES, 1.0), *arguments)
    assert str(caught.value) == message
    with pytest.raises(ProblemError, match="`trajectory` must be a Trajectory; got 3"):
        tracking(3, "x", "w")
