"""What `certify` says: of plants whose answers are known, and of what cannot be asked."""

import dataclasses
import math
import time

import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Ball, Box, Problem, SsacSettings, certify, problems
from capsyn.certification.question import Asked, question
from capsyn.certification.refute import refute, states_of_rest
from capsyn.errors import ProblemError


def mover(**options):
    """Return a policy that drives two integrators to 0, each by -1, 0 or 1."""
    values = [(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)]
    problem = Problem(
        name="mover",
        dynamics=lambda x, u: [u[0], u[1]],
        domain=Box([-1, -1], [1, 1], names=["a", "b"]),
        alphabet=Alphabet(values),
        default=[0, 0],
        horizon=0.2,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        target=Ball([0, 0], 0.2),
        settings=SsacSettings(rule="steepest", sample_time=0.01),
        outside="nearest",
        **options,
    )
    return capsyn.synthesize(problem)


@pytest.fixture(scope="module")
def policy():
    return mover()


@pytest.fixture(scope="module")
def pendulum():
    return capsyn.synthesize(problems.get("cart-pendulum"))


@pytest.fixture(scope="module")
def tanks():
    return capsyn.synthesize(problems.get("double-tank-b"))


def test_a_start_with_a_fixed_state_is_proved_with_a_little_around_it(policy):
    certificate = certify(policy, initial=Box([-1, 0.5], [1, 0.5]), counts=32)
    assert certificate.arrival == certificate.staying == 1.0
    assert certificate.conditions["initial"] == "a in [-1, 1], b = 0.5"


def test_two_integrators_arrive_as_fast_as_they_can(policy):
    certificate = certify(policy, counts=32)
    assert certificate.arrival == certificate.staying == 1.0
    assert certificate.open == 0.0 and not len(certificate.refuted)
    # the farthest start has 1 to go along each axis, at a speed of 1, to within 0.2 / sqrt(2)
    least = 1 - 0.2 / math.sqrt(2)
    assert least <= certificate.within <= 1.3 * least
    assert (np.abs(certificate.ripple) <= 0.3).all()


def test_a_loop_is_proved_for_delay_noise_and_a_plant_in_a_range(policy):
    certificate = certify(
        policy,
        model=lambda x, u, p: [p[0] * u[0], p[0] * u[1]],
        parameters={"speed": (0.8, 1.2)},
        delay=0.005,
        noise=0.005,
        counts=24,
        seconds=8,
    )
    assert certificate.arrival > 0.99
    assert certificate.within >= (1 - 0.2 / math.sqrt(2)) / 0.8
    assert certificate.conditions["noise"] == [0.005, 0.005]
    assert certificate.conditions["parameters"] == {"speed": [0.8, 1.2]}


def test_a_plant_that_may_stand_still_is_not_proved(policy):
    certificate = certify(
        policy,
        model=lambda x, u, p: [p[0] * u[0], p[0] * u[1]],
        parameters={"speed": (0.0, 1.0)},
        counts=24,
        seconds=5,
    )
    assert certificate.arrival < 0.1


def test_what_must_be_avoided_is(policy):
    wall = Box([0.4, -0.1], [0.6, 0.1], names=["a", "b"])
    certificate = certify(policy, avoid=wall, counts=24, seconds=8)
    assert 0.5 < certificate.avoiding < 1.0
    assert "enters avoid" in certificate.failures
    behind = certificate.refuted[np.array(certificate.failures) == "enters avoid"]
    assert (behind[:, 0] > 0.3).all()


def test_tanks_are_proved_to_arrive_and_to_stay(tanks):
    certificate = certify(tanks, Box([0.1, 0.1], [0.9, 0.9]))
    assert certificate.arrival == certificate.staying == 1.0
    assert 4.4 < certificate.within <= 10  # the latest simulated start takes 4.4 s
    far = np.abs(certificate.ripple - np.array([[0.4], [0.6]])).max(axis=1)
    assert np.hypot(*far) <= 0.1


def test_the_state_in_which_the_pendulum_stands_still_is_named(pendulum):
    asked = question(pendulum, Asked(counts=64), None, 0)
    cells = np.arange(asked.cells.total)
    rests, homes = states_of_rest(asked, cells)
    still = math.pi + math.atan(5 / 9.81)
    distance = np.abs(rests - [still, 0.0]).max(axis=1)
    assert distance.min() < 1e-9
    home = homes[distance.argmin()]
    states, failures, _ = refute(asked, np.array([home]))
    named = dict(zip(map(tuple, states.round(3).tolist()), failures))
    assert named[(round(still, 3), 0.0)] == "stands still"


def test_a_proof_that_is_stopped_keeps_what_it_has(pendulum):
    certificate = certify(pendulum, counts=64, seconds=2)
    assert certificate.stopped
    assert 0 < certificate.arrival < 1
    assert certificate.open > 0


def test_time_is_kept_where_a_start_takes_long(policy):
    began = time.monotonic()
    certificate = certify(policy, noise=0.3, counts=48, seconds=2)
    assert time.monotonic() - began < 60  # one start alone would take minutes
    assert certificate.stopped


def test_finer_cells_are_taken_where_larger_ones_are_in_vain(pendulum, monkeypatch):
    monkeypatch.setattr("capsyn.reach.arrive.VAIN", -1)
    certificate = certify(pendulum, seconds=4)
    assert certificate.cells.counts > (72, 72)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"target": Ball([0, 0], 0.02), "counts": 8}, "`target` must be a set that a cell fits"),
        ({"initial": Box([0, 0], [2, 2])}, "`initial` must be within the domain"),
        ({"initial": "all"}, "`initial` must be a Ball or a Box"),
        ({"avoid": Ball([0, 0], 0.5)}, "`avoid` must leave some of the target"),
        ({"avoid": 3}, "`avoid` must be"),
        ({"delay": 0.02}, "`delay` must be at most one sample"),
        ({"noise": -1}, "`noise`"),
        ({"noise": [1, 2, 3]}, "`noise`"),
        ({"parameters": {"speed": (2, 1)}}, "must be (low, high)"),
        ({"parameters": {"speed": 1}}, "`parameters` need a `model`"),
        ({"exogenous": {"w": 1}}, "`exogenous` must be left out"),
        ({"counts": 1 << 19}, "`counts` must be cells that fit memory"),
        ({"counts": 0}, "`counts`"),
        ({"seconds": 0}, "`seconds`"),
        ({"seed": -1}, "`seed`"),
    ],
)
def test_what_cannot_be_asked_is_said_in_one_line(policy, given, message):
    with pytest.raises(ProblemError) as caught:
        certify(policy, **given)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_policy_without_a_model_or_a_target_is_refused(policy):
    with pytest.raises(ProblemError, match="model"):
        certify(dataclasses.replace(policy, model=None))
    with pytest.raises(ProblemError, match="target"):
        certify(dataclasses.replace(policy, target=None))


def test_a_tree_is_proved_by_its_own_splits(policy):
    tree = capsyn.compress(policy, "exact")
    one = certify(policy, counts=16, seconds=6)
    two = certify(tree, counts=16, seconds=6)
    assert two.arrival == one.arrival
    assert two.within == one.within


def test_a_policy_that_is_told_is_proved_for_a_value_and_for_a_range():
    values = [(-1.0,), (0.0,), (1.0,)]
    problem = Problem(
        name="follower",
        dynamics=lambda x, u, w: [u[0]],
        domain=Box([-1], [1], names=["a"]),
        exogenous=Box([-0.5], [0.5], names=["goal"]),
        alphabet=Alphabet(values),
        default=[0],
        horizon=0.2,
        running_cost=lambda x, w: (x[0] - w[0]) ** 2,
        target=lambda x, w: (x[0] - w[0]) ** 2 <= 0.04,
        settings=SsacSettings(rule="steepest", sample_time=0.01),
        outside="nearest",
    )
    told = capsyn.synthesize(problem)
    one = certify(told, exogenous={"goal": 0.25}, seconds=5)
    assert one.arrival == 1.0
    assert 1.05 <= one.within <= 1.3  # from -1 to 0.2 before the goal
    both = certify(told, counts=48, seconds=5)
    assert both.arrival > 0.9
    assert both.within >= 1.3 - 1e-9  # from -1 to a goal of 0.5
