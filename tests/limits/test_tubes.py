"""Enclosures of flows: what starts in a box stays in its tube and ends in its end."""

import casadi as ca
import numpy as np
import pytest

from capsyn import problems
from capsyn.limits.tubes import Flow
from capsyn.modelling.transcription import transcribe, user_program


def program(function, n, m=1, k=0):
    inputs = (("x", n), ("u", m)) + ((("p", k),) if k else ())
    return user_program(
        "dynamics", function, inputs, (("xdot", n),), rates=True, parameters=bool(k)
    )


def followed(dynamics, x, *inputs, duration, steps=40):
    """Yield the states (n, B) on the way, by small Runge-Kutta steps."""
    h = duration / steps
    for _ in range(steps):
        k1 = dynamics.evaluate(x, *inputs)[0]
        k2 = dynamics.evaluate(x + h / 2 * k1, *inputs)[0]
        k3 = dynamics.evaluate(x + h / 2 * k2, *inputs)[0]
        k4 = dynamics.evaluate(x + h * k3, *inputs)[0]
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        yield x


def outside(x, lower, upper, slack=1e-13):
    return ((x < lower - slack) | (x > upper + slack)).any(axis=0)


def check_held(dynamics, tubes, x, *inputs, duration, slack=1e-12):
    known = ~np.isnan(tubes.lower).any(axis=0)
    for y in followed(dynamics, x, *inputs, duration=duration):
        assert not (outside(y, tubes.lower, tubes.upper, slack) & known).any()
    assert not (outside(y, tubes.end_lower, tubes.end_upper, slack) & known).any()
    return known.mean()


@pytest.mark.parametrize("name", ["boost-converter", "cart-pole", "double-tank-a", "spacecraft"])
@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_states_of_boxes_stay_in_their_tubes(name, backend):
    problem, count = problems.get(name), 3000
    dynamics, duration = transcribe(problem).dynamics, problem.settings.sample_time
    rng = np.random.default_rng(1)
    lower = problem.space.sample(count, 2).T
    upper = lower + 0.02 * rng.random(lower.shape) * problem.space.widths[:, None]
    u = problem.alphabet.values[rng.integers(len(problem.alphabet), size=count)].T
    tubes = Flow.of(dynamics, backend).tubes(lower, upper, u, duration)
    corner = rng.integers(0, 2, lower.shape)  # the worst are there, mostly
    for share in (corner, rng.random(lower.shape)):
        x = lower + share * (upper - lower)
        assert check_held(dynamics, tubes, x, u, duration=duration) > 0.99


def test_a_linear_flow_is_enclosed_closely():
    a = np.array([[-1.0, 2.0], [-3.0, -0.5]])
    dynamics = program(lambda x, u: [*(ca.DM(a) @ x + ca.vertcat(0, u[0])).elements()], 2)
    lower, upper = np.array([[1.0], [2.0]]), np.array([[1.1], [2.1]])
    h = 1e-3
    tubes = Flow.of(dynamics).tubes(lower, upper, np.ones((1, 1)), h)
    corners = np.array(np.meshgrid(*np.hstack([lower, upper]))).reshape(2, -1)
    *_, ends = followed(dynamics, corners, np.ones((1, 4)), duration=h)
    exact = ends.max(axis=1) - ends.min(axis=1)
    got = (tubes.end_upper - tubes.end_lower)[:, 0]
    assert (got >= exact).all() and (got < exact + 20 * h**2).all()
    # without the mean-value form the box grows by t |J| instead of shrinking
    plain = Flow.of(dynamics)
    plain = Flow(plain.dynamics, plain.motion, None).tubes(lower, upper, np.ones((1, 1)), h)
    assert ((plain.end_upper - plain.end_lower)[:, 0] > got + 1e-4).all()


def test_kinks_and_jumps_are_held():
    def kinked(x, u):
        return [ca.fabs(x[1]) - x[0], ca.fmax(x[0], 0.3 * u[0])]

    def jumping(x, u):
        return [ca.if_else(x[0] > 0.5, -3.0, 2.0), ca.sign(x[0] - 0.2) * u[0]]

    rng = np.random.default_rng(3)
    lower = rng.uniform(-1, 1, (2, 4000))
    upper, u = lower + rng.uniform(0, 0.2, (2, 4000)), rng.choice([-1.0, 1.0], (1, 4000))
    x = lower + rng.random((2, 4000)) * (upper - lower)
    for function, slack in ((kinked, 1e-12), (jumping, 1e-2)):  # of Runge-Kutta at the jump
        dynamics = program(function, 2)
        flow = Flow.of(dynamics)
        assert (flow.end is None) == (function is jumping)
        tubes = flow.tubes(lower, upper, u, 0.1)
        assert check_held(dynamics, tubes, x, u, duration=0.1, slack=slack) == 1


def test_parameters_exogenous_inputs_and_parts():
    def dynamics_of(x, u, p):
        return [x[1] * p[0], u[0] - p[1] * x[0] + x[2], 0.0]

    dynamics = program(dynamics_of, 3, k=2)
    rng = np.random.default_rng(4)
    lower = rng.uniform(-1, 1, (3, 2000))
    upper, u = lower + rng.uniform(0, 0.1, (3, 2000)), rng.choice([-1.0, 1.0], (1, 2000))
    ranges = np.array([0.9, -2.0]), np.array([1.2, 3.0])
    p = rng.uniform(*ranges, (2000, 2)).T
    x = lower + rng.random((3, 2000)) * (upper - lower)
    durations = rng.uniform(0.01, 0.4, 2000)
    flow, ends = Flow.of(dynamics), []
    for steps in (1, 8):
        tubes = flow.tubes(lower, upper, u, durations, ranges, steps)
        assert check_held(dynamics, tubes, x, u, p, duration=durations) > 0.999
        ends.append(np.nanmean(tubes.end_upper - tubes.end_lower))
        assert np.nanmax(lower[2] - tubes.end_lower[2]) < 1e-12  # constant
    assert ends[1] < ends[0]  # the remainder falls with the square of a part
    low = np.repeat(ranges[0][:, None], 2000, axis=1), np.repeat(ranges[1][:, None], 2000, axis=1)
    again = flow.tubes(lower, upper, u, durations, low, 8)
    assert np.array_equal(again.end_upper, tubes.end_upper, equal_nan=True)


def test_nothing_is_said_where_solutions_may_blow_up_or_end():
    square = Flow.of(program(lambda x, u: [x[0] ** 2 + u[0]], 1))
    lower, upper = np.array([[0.5, 0.99]]), np.array([[0.6, 1.01]])
    tubes = square.tubes(lower, upper, np.zeros((1, 2)), np.array([0.2, 1.0]))
    assert not np.isnan(tubes.lower[0, 0])
    assert np.isnan([tubes.lower[0, 1], tubes.end_upper[0, 1]]).all()
    root = Flow.of(program(lambda x, u: [-ca.sqrt(x[0]) + u[0]], 1))
    tubes = root.tubes(np.array([[0.0, 1.0]]), np.array([[0.1, 1.1]]), np.zeros((1, 2)), 0.1)
    assert np.isnan(tubes.lower[0, 0]) and not np.isnan(tubes.lower[0, 1])
    still = root.tubes(np.array([[1.0]]), np.array([[1.0]]), np.ones((1, 1)), 0.0)
    assert still.end_lower <= 1 <= still.end_upper
