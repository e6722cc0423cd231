"""Switching: relays with known sliding and crossing, tables against states moved a little."""

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Problem, problems, subdivide, synthesize
from capsyn.automata.face_rates import (
    DOWNWARD,
    IMPOSSIBLE,
    POSSIBLE,
    REPELLING,
    SLIDING,
    UNDECIDED,
    UPWARD,
)
from capsyn.automata.switching import switching
from capsyn.cells.split_tree import LEAF, SplitTree
from capsyn.errors import ProblemError
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.policy import DecisionTree
from support.relays import below, hysteresis, relay

LINE = Box([-1.0], [1.0])
PLANE = Box([-2.0, -2.0], [2.0, 2.0])


def drift(x, u):
    """Filippov: u = -sign(x2) slides on x2 = 0 for abs(x1) < 1 and crosses outside."""
    return [1.0, x[0] + u[0]]


def test_a_relay_on_a_line_slides_on_the_whole_face():
    found = switching(relay(lambda x, u: [u[0]], LINE, below()))
    assert len(found.faces) == 1 and found.labels.tolist() == [[0, 1]]
    assert found.shares[0].tolist() == [0, 0, 1, 0]
    assert found.statuses[0].tolist() == [POSSIBLE] * 3
    assert found.rate == 0 and found.sliding_share == 1
    assert found.sliding_rates[:2, :2] == pytest.approx(np.array([[0, 0.5], [0.5, 0]]))
    assert found.exit_rates.tolist() == [0, 0, 0]


def test_a_relay_that_pushes_away_never_switches():
    found = switching(relay(lambda x, u: [u[0]], LINE, below(), alphabet=[-1.0, 1.0]))
    assert found.shares[0, REPELLING] == 1
    assert (found.switches == IMPOSSIBLE).all() and (found.slidings == IMPOSSIBLE).all()
    assert found.exit_rates == pytest.approx([0.5, 0.5, 0])


@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_a_relay_with_hysteresis_goes_to_and_fro_and_does_not_slide(speed):
    rule = {"partitions": 6, "in_force": True}
    found = switching(relay(lambda x, u: [speed * u[0]], LINE, hysteresis, **rule))
    assert found.labels.tolist() == [[0, 1], [0, 1]]  # at -1/3 downwards, at 1/3 upwards
    assert found.sliding_share == 0 and not found.slidings.any()
    onward = np.array([[0, 1], [1, 0]])
    if speed > 0:  # in the band either symbol is as likely
        assert np.array_equal(found.switches[:2, :2], POSSIBLE * onward)
        assert found.switch_rates[:2, :2] == pytest.approx(onward / 4)
        assert found.shares.tolist() == [[0, 1, 0, 0], [1, 0, 0, 0]]
        assert found.exit_rates.tolist() == [0, 0, 0]
    else:
        assert not found.switches.any() and found.rate == 0
        assert found.exit_rates == pytest.approx([0.5, 0.5, 0])


def test_a_relay_without_a_band_slides_though_it_may_remember():
    def label(x):  # but for the start it is the same whatever is in force
        return np.stack([below()(x), below()(x), 1 - below()(x)], axis=1)

    found = switching(relay(lambda x, u: [u[0]], LINE, label, in_force=True))
    plain = switching(relay(lambda x, u: [u[0]], LINE, below()))
    for name in ("slidings", "sliding_rates", "areas_between", "exit_rates"):
        assert np.array_equal(getattr(found, name), getattr(plain, name)), name


def test_a_double_integrator_slides_where_its_speed_is_0():
    policy = relay(lambda x, u: [x[1], u[0]], PLANE, below(axis=1), partitions=8)
    found = switching(policy)
    assert set(found.faces.axis) == {1}
    assert found.shares[:, SLIDING] == pytest.approx(1)
    assert found.sliding_areas[0, 1] == found.areas_between[0, 1] == pytest.approx(1)
    assert found.switch_rates.sum() == 0


@pytest.mark.parametrize("max_level", [0, 1, 3])
def test_a_sliding_interval_is_found_to_its_ends(max_level):
    found = switching(relay(drift, PLANE, below(axis=1), partitions=4, max_level=max_level))
    middle = found.faces.axis == 1
    x1 = PLANE.points(found.faces.lower, found_counts(max_level))[middle, 0]
    slides = (x1 >= -1) & (x1 < 1)
    assert np.array_equal(found.statuses[middle, SLIDING] == POSSIBLE, slides)
    assert (found.statuses[middle, SLIDING][~slides] == IMPOSSIBLE).all()
    assert found.sliding_areas[0, 1] == pytest.approx(0.5)
    # integral of x1 + 1 over [1, 2], and over [-1, 1], by the area of the domain
    assert found.switch_rates[0, 1] == found.switch_rates[1, 0] == pytest.approx(2.5 / 16)
    assert found.sliding_rates[0, 1] == found.sliding_rates[1, 0] == pytest.approx(2 / 16)
    assert found.shares[middle & (found.shares[:, UPWARD] > 0)][:, UPWARD] == pytest.approx(1)
    assert found.shares[:, DOWNWARD].sum() == pytest.approx(found.shares[:, UPWARD].sum())
    assert found.slidings[0, 1] == found.slidings[1, 0] == POSSIBLE


def found_counts(max_level):
    return (4 * 2**max_level,) * 2


@pytest.mark.parametrize("partitions", [[7, 4], [13, 4], [29, 4]])
def test_a_sliding_interval_across_cells_is_found_to_the_resolution(partitions):
    found = switching(relay(drift, PLANE, below(axis=1), partitions=partitions))
    resolution = 1 / partitions[0] / 8  # samples per face
    assert found.sliding_areas[0, 1] == pytest.approx(0.5, abs=2 * resolution)


def test_a_clock_switches_one_way_round_its_seam_too():
    circle = Box([0.0], [3.0], periodic=[True])

    def third(x):
        return np.minimum((x[:, 0]).astype(int), 2)

    found = switching(
        relay(lambda x, u: [2.0 + 0 * u[0]], circle, third, [1.0, 2.0, 3.0], partitions=9)
    )
    onward = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    assert np.array_equal(found.switches[:3, :3], POSSIBLE * onward)
    assert found.switch_rates[:3, :3] == pytest.approx(2 / 3 * onward)
    assert found.exit_rates.tolist() == [0] * 4 and found.sliding_share == 0


def test_each_side_of_a_seam_is_taken_at_its_own_end():
    # the model is wrong as one of an angle, which shows where it is evaluated
    circle = Box([0.0], [2.0], periodic=[True])
    found = switching(relay(lambda x, u: [x[0] - 0.5], circle, below(at=1.0 - 1e-9), partitions=2))
    seam = found.faces.lower[:, 0] == 0
    assert found.labels[seam].tolist() == [[1, 0]]
    assert found.shares[seam, REPELLING].sum() == 0  # 1.5 from below, -0.5 above
    assert found.shares[seam, SLIDING] == 1
    assert found.sliding_rates[1, 0] == pytest.approx(1.5 / 2)
    assert found.sliding_rates[0, 1] == pytest.approx(0.5 / 2)


def test_the_default_control_comes_last():
    policy = relay(
        lambda x, u: [u[0]], LINE, lambda x: np.where(x[:, 0] > 0, -1, 0), [1.0], default=0.5
    )
    found = switching(policy)
    assert found.labels.tolist() == [[0, 1]]
    assert found.switch_rates.tolist() == [[0, 0.5], [0, 0]]
    assert found.volume_shares == pytest.approx([0.5, 0.5])
    assert found.exit_rates == pytest.approx([0, 0.25])


@pytest.mark.parametrize(
    ("rate", "wanted"),
    [
        (lambda x: -(x * x - 0.6 * x + 0.1), IMPOSSIBLE),  # bisection proves it
        (lambda x: -(x * x - 0.6 * x + 0.09), UNDECIDED),  # it touches 0 at 0.3
        (lambda x: -(x * x - 0.6 * x + 0.08), POSSIBLE),
        (lambda x: ca.sqrt(x) - 9, UNDECIDED),  # undefined where x < 0
        (lambda x: ca.sin(x) - ca.sin(x), IMPOSSIBLE),
    ],
)
def test_three_valued_answers(rate, wanted):
    plane = Box([-1.0, -1.0], [1.0, 1.0])
    found = switching(relay(lambda x, u: [0.0, rate(x[0])], plane, below(axis=1), partitions=2))
    assert found.switches[0, 1] == wanted
    assert np.isfinite(found.switch_rates).all()


def test_rates_that_are_rounding_are_none():
    plane = Box([-1.0, -1.0], [1.0, 1.0])
    found = switching(relay(lambda x, u: [0.0, 1e-15], plane, below(axis=1), partitions=2))
    assert not found.shares.any() and not found.switch_rates.any()
    assert (found.statuses == IMPOSSIBLE).all()


def moved(policy, count, dt, seed=3):
    """Return the switches [1/s] of evenly spread states that hold their symbol a little while."""
    states = policy.domain.sample(count, seed)
    symbols = policy(states)
    rates = policy.model.dynamics.evaluate(states.T, policy.controls[symbols].T)[0].T
    after = states + dt * rates
    number = len(policy.alphabet) + 1
    table = np.zeros((number, number))
    np.add.at(table, (symbols, policy(after, outside="nearest")), 1 / count / dt)
    np.fill_diagonal(table, 0)
    left = (~policy.domain.contains(after)).mean() / dt
    return table, left


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a"])
def test_rates_are_those_of_states_moved_a_little(name):
    policy = synthesize(problems.plain(name), max_level=2)
    count, dt = 400_000, 1e-3
    table, left = moved(policy, count, dt)
    found = switching(policy)
    rates = found.switch_rates + found.sliding_rates
    noise = 4 * np.sqrt(np.maximum(rates, 0.02) / count / dt)
    assert (np.abs(table - rates) < noise + 0.02 * rates.max()).all()
    assert left == pytest.approx(found.exit_rates.sum(), abs=4 * np.sqrt(0.2 / count / dt))
    assert found.volume_shares == pytest.approx(policy.volume_shares)
    assert (found.switches[found.switch_rates > 0] == POSSIBLE).all()


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a"])
def test_no_state_on_a_face_contradicts_what_is_proved(name):
    policy = synthesize(problems.plain(name), max_level=2)
    found = switching(policy)
    faces, domain = found.faces, policy.domain
    low, high = (domain.points(z, policy.cells.counts) for z in (faces.lower, faces.upper))
    rng, rows = np.random.default_rng(0), np.arange(len(faces))
    for _ in range(50):
        states = low + rng.random(low.shape) * (high - low)
        along = []
        for side in range(2):
            at = states.copy()
            seam = faces.lower[rows, faces.axis] == 0
            if side == 0:
                at[rows[seam], faces.axis[seam]] = domain.upper[faces.axis[seam]]
            control = policy.controls[found.labels[:, side]]
            along.append(policy.model.dynamics.evaluate(at.T, control.T)[0][faces.axis, rows])
        lower, upper = along[0] > 1e-9, along[1] < -1e-9
        for column, occurs in enumerate((lower, upper, lower & upper)):
            assert (found.statuses[occurs, column] == POSSIBLE).all()
    assert (found.statuses[found.shares[:, SLIDING] > 0, SLIDING] == POSSIBLE).all()


GUARANTEE = Guarantee("exact", 64 * "0")


def halves(counts, cut):
    """Return a tree of two leaves on either side of a step of the second axis."""
    split, threshold, second = np.array([[1, LEAF, LEAF], [cut, 0, 1], [2, 1, 2]], np.int32)
    return SplitTree(counts, split, threshold, second, np.empty((0, 2), np.int32))


def test_a_tree_of_splits_gives_the_same_tables():
    policy = relay(drift, PLANE, below(axis=1), partitions=4)
    tree = halves((4, 4), 2)
    one, two = switching(policy), switching(DecisionTree.of(policy, tree, GUARANTEE))
    assert len(two.faces) == 4  # in pieces of a finest cell
    assert (two.faces.below == 1).all() and (two.faces.above == 2).all()
    assert np.array_equal(one.switches, two.switches)
    for name in ("switch_rates", "sliding_rates", "sliding_areas", "exit_rates"):
        assert getattr(one, name) == pytest.approx(getattr(two, name))


def test_large_faces_are_sampled_in_pieces():
    policy = relay(drift, PLANE, below(axis=1), partitions=2, max_level=0)
    tree = halves((1000, 2), 1)
    found = switching(DecisionTree.of(policy, tree, GUARANTEE))
    assert len(found.faces) == 32 and found.areas.sum() == pytest.approx(1)
    assert found.sliding_areas[0, 1] == pytest.approx(0.5, abs=2 / 32 / 8)
    assert found.switch_rates[0, 1] == pytest.approx(2.5 / 16, abs=1e-3)


def test_three_states_and_one_symbol():
    box = Box([-1.0] * 3, [1.0] * 3)
    problem = Problem("still", lambda x, u: [x[1], x[2], u[0]], box, [1.0], 0.0, 1.0, ca.sumsqr)
    found = switching(synthesize(problem, max_level=1, partitions=2))
    assert len(found.faces) == 0 and found.rate == 0 and found.sliding_share == 0
    slab = switching(relay(lambda x, u: [x[1], u[0], x[0]], box, below(axis=1), max_level=1))
    assert slab.sliding_share == 1 and slab.sliding_areas[0, 1] == pytest.approx(1)


def test_a_policy_without_a_model_is_refused():
    policy = subdivide(lambda x: (x[:, 0] > 0).astype(int), LINE, 2)
    with pytest.raises(ProblemError, match="`policy` must have a model to follow; 'policy'"):
        switching(policy)
    with pytest.raises(ProblemError, match="`policy` must be a Policy; got 7"):
        switching(7)


def crossing(below_zero, above_zero):
    """Return what the loop does on x2 = 0 where the dynamics switch there, too."""

    def dynamics(x, v):
        return [0, v[0] + ca.if_else(x[1] < 0, below_zero, above_zero)]

    found = switching(relay(dynamics, PLANE, below(axis=1), alphabet=(1e-3, -1e-3)))
    return found.switches[0, 1], found.switches[1, 0], found.slidings[0, 1]


@pytest.mark.parametrize(
    "below_zero, above_zero", [(1.0, -1.0), (0.5, -1.5), (2.0, 1.0), (-1.0, 1)]
)
def test_dynamics_that_switch_on_a_face_are_never_excluded_wrongly(below_zero, above_zero):
    up, down, slides = crossing(below_zero, above_zero)
    assert up != IMPOSSIBLE or below_zero <= 0
    assert down != IMPOSSIBLE or above_zero >= 0
    assert slides != IMPOSSIBLE or not (below_zero > 0 > above_zero)
    assert up != POSSIBLE or below_zero > 0
    assert slides != POSSIBLE or below_zero > 0 > above_zero
