"""Loops whose arrival, ripple and switching are known by hand, and what is proved of them."""

import casadi as ca
import numpy as np
import pytest

from capsyn import Ball, Box, certify
from support.relays import below, hysteresis, relay

PERIOD = 0.01


@pytest.fixture(scope="module")
def integrator():
    """x' = u towards 0, u = -1 above it and 1 below."""
    return relay(lambda x, u: [u[0]], Box([-1.0], [1.0]), below(), partitions=8, default=0.0)


def certified(policy, **more):
    asked = {"target": Ball([0.0], 0.1), "rate": 1 / PERIOD, "counts": 64, "threads": 1}
    return certify(policy, **asked | more)


def test_arrival_takes_as_long_as_the_way(integrator):
    """x' = -1: from the upper end of each cell to 0.1, in whole samples; the default goes first."""
    found = certified(integrator)
    assert found.arrival == 1.0 and found.open == 0.0
    upper = np.abs(-1 + (np.arange(64)[:, None] + [0, 1]) / 32).max(axis=1)
    takes = np.ceil(np.round((upper - 0.1) / PERIOD, 9)) * PERIOD
    whole = 4 / (PERIOD**-1 / 32)  # a cell takes 3.125 samples, and may be counted as 4
    outside = upper > 0.1 + 1 / 32
    assert (found.cells.within[outside] >= takes[outside] - 1e-9).all()
    assert 0.9 <= found.within <= 0.9 * whole


def test_a_relay_overshoots_by_a_sample(integrator):
    """It changes at most a sample late: the ripple is +-h, a change each sample."""
    found = certified(integrator)
    assert found.staying == 1.0
    (low, high), rate = found.ripple[0], found.switch_rate
    assert low <= -PERIOD and high >= PERIOD
    assert low >= -1.5 * PERIOD and high <= 1.5 * PERIOD
    assert rate == pytest.approx(1 / PERIOD, rel=0.1)


def test_a_hold_overshoots_by_its_samples(integrator):
    """Three samples held: the ripple is +-3 h, a change each three samples."""
    found = certified(integrator, min_dwell=3 * PERIOD)
    assert found.arrival == 1.0 and found.staying == 1.0
    low, high = found.ripple[0]
    assert low <= -3 * PERIOD + 1e-9 and high >= 3 * PERIOD - 1e-9
    assert low >= -4 * PERIOD and high <= 4 * PERIOD
    assert 1 / (3 * PERIOD) <= found.switch_rate * (1 + 1e-9)
    assert found.switch_rate <= 1.3 / (3 * PERIOD)


def test_a_delay_overshoots_by_itself(integrator):
    """Half a sample late: +-1.5 h."""
    found = certified(integrator, delay=PERIOD / 2)
    low, high = found.ripple[0]
    assert low <= -1.5 * PERIOD + 1e-9 and high >= 1.5 * PERIOD - 1e-9
    assert low >= -2.1 * PERIOD and high <= 2.1 * PERIOD


def test_an_error_shifts_the_change(integrator):
    """Readings within 2 h: the ripple is +-3 h."""
    found = certified(integrator, noise=2 * PERIOD)
    low, high = found.ripple[0]
    assert low <= -3 * PERIOD + 1e-9 and high >= 3 * PERIOD - 1e-9
    assert low >= -4 * PERIOD and high <= 4 * PERIOD


def test_hysteresis_swings_between_its_ends():
    """0 rises to 1/3, 1 falls to -1/3: +-(1/3 + h), a change each 2/3 time units at most."""
    policy = relay(lambda x, u: [u[0]], Box([-1.0], [1.0]), hysteresis, partitions=6, in_force=True)
    found = certified(policy, target=Ball([0.0], 0.3))
    assert found.arrival == 1.0 and found.staying == 1.0
    low, high = found.ripple[0]
    assert low <= -1 / 3 - PERIOD * 0.6 and high >= 1 / 3 + PERIOD * 0.6
    assert low >= -1 / 3 - 3 * PERIOD and high <= 1 / 3 + 3 * PERIOD
    true = 1 / (67 * PERIOD)  # 66.7 samples from end to end
    assert true * (1 - 1e-9) <= found.switch_rate <= 2 * true


def test_what_leaves_is_not_proved():
    """x' = x + u/2 runs away from beyond +-1/2, and comes back from within."""
    policy = relay(lambda x, u: [x[0] + u[0] / 2], Box([-1.0], [1.0]), below(), partitions=8)
    found = certified(policy)
    middle = -1 + (np.arange(64) + 0.5) / 32
    away, back = np.abs(middle) > 0.5, np.abs(middle) < 0.45
    assert (found.cells.arrives[away] == 0).all() and (found.cells.arrives[back] == 1).all()
    assert found.staying == found.arrival == pytest.approx(0.5, abs=2 / 64)


def test_what_is_to_be_avoided_is_met_between_samples():
    """A wall as thin as a tenth of a sample, between 0.5 and the target, is not jumped over."""
    policy = relay(lambda x, u: [u[0]], Box([-1.0], [1.0]), below(), partitions=8)
    wall = Box([0.3 + 1e-4], [0.3 + 11e-4])
    found = certified(policy, avoid=wall)
    middle = -1 + (np.arange(64) + 0.5) / 32
    assert (found.cells.arrives[middle > 0.35] == 0).all()
    assert (found.cells.arrives[middle < 0.25] == 1).all()


def test_unknown_parameters_are_those_of_their_ends():
    """x' = p u, p in [0.5, 2]: slow arrival by the one end, a wide ripple by the other."""
    policy = relay(lambda x, u: [u[0]], Box([-1.0], [1.0]), below(), partitions=8)
    found = certified(policy, model=lambda x, u, p: [p[0] * u[0]], parameters={"p": (0.5, 2.0)})
    assert found.arrival == 1.0
    assert 1.8 - 1e-9 <= found.within + 2 / 64 + PERIOD
    assert found.within <= 1.8 + 2 / 64 + 4 * PERIOD
    low, high = found.ripple[0]
    assert -3 * PERIOD <= low <= -2 * PERIOD + 1e-9 and 2 * PERIOD - 1e-9 <= high <= 3 * PERIOD


def test_a_turning_axis_arrives_over_its_seam():
    """An angle that only rises arrives from everywhere, within a turn."""
    policy = relay(
        lambda x, u: [1.0 + 0 * ca.sin(x[0]) + 0 * u[0]],
        Box([-np.pi], [np.pi], periodic=[True]), below(), partitions=8,
    )  # fmt: skip
    found = certified(policy, target=Ball([0.0], 0.2), counts=64)
    assert found.arrival == 1.0
    assert found.within == pytest.approx(2 * np.pi - 0.4, abs=0.25)
