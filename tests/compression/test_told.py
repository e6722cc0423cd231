"""Small trees of policies that are told exogenous inputs: features are functions of x and w."""

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Policy, Problem, compress, subdivide, synthesize
from capsyn.cells.feature_tree import FeatureTree
from capsyn.compression import compress as compression
from capsyn.compression.features import controller_fit
from capsyn.errors import ProblemError
from capsyn.modelling.transcription import feature_program
from support.relays import relay

FEATURES = {"error": lambda x, w: x[0] - w[0], "unused": lambda x, w: ca.exp(x[1] * w[0])}


@pytest.fixture(scope="module")
def policy():
    """Return a policy that acts on the error x1 - w1, in three bands."""
    return relay(
        lambda x, u, w: [u[0], x[0] - w[0]],
        Box([-1.0, -1.0], [1.0, 1.0]),
        lambda z: np.digitize(z[:, 0] - z[:, 2], [-0.26, 0.24]),
        alphabet=[1.0, 0.0, -1.0],
        partitions=[4, 1, 2],
        max_level=3,
        exogenous=Box([-0.5], [0.5], names=["setpoint"]),
    )


def test_features_take_states_and_exogenous_inputs_apart():
    space = Box([-1.0, 0.0, 2.0], [1.0, 8.0, 3.0])
    functions = {"all": lambda x, w: x[0] + 10 * x[1] + 100 * w[0], "size": lambda x, w: 1.0}
    program = feature_program(functions, space, (4, 8, 10), 1)
    steps = np.array([[0, 0, 0], [3, 7, 9], [1, 2, 3]])
    centres = space.lower + (steps + 0.5) * space.widths / [4, 8, 10]
    values = np.broadcast_to(program.evaluate(steps.T)[0], (2, 3))
    np.testing.assert_allclose(values[0], centres @ [1, 10, 100])
    np.testing.assert_array_equal(values[1], 1.0)


@pytest.mark.parametrize("mode", ["exact", "freedom"])
def test_a_tree_with_the_error_as_feature_is_the_policy_and_small(policy, mode, tmp_path):
    tree = compress(policy, mode, features=FEATURES, states=20_000)
    assert isinstance(tree.cells, FeatureTree) and tree.cells.features.names == ("error",)
    assert tree.node_count < compress(policy, mode, states=20_000).node_count / 4
    assert tree.exogenous == policy.exogenous and tree.domain == policy.domain
    readings = policy.space.sample(100_000, 3)
    if mode == "exact":
        np.testing.assert_array_equal(tree(readings), policy(readings))
    else:
        assert tree.guarantee.agreement > 0.95
    tree.save(tmp_path / "tree.cap")
    again = Policy.load(tmp_path / "tree.cap")
    np.testing.assert_array_equal(
        again(readings[:1000, :2], readings[:1000, 2:]), tree(readings[:1000])
    )


def test_a_tree_with_features_of_fixed_exogenous_inputs_has_their_symbols(policy):
    tree = compress(policy, features=FEATURES)
    x = policy.domain.sample(20_000, 5)
    for w in (-0.5, 0.1234, 0.5):
        np.testing.assert_array_equal(tree.at(w)(x), policy(x, [w]))


def test_a_fitted_tree_compares_the_error_alone(policy, monkeypatch):
    monkeypatch.setattr(compression, "FEATURE_STEPS", 512)
    for name in ("SAMPLES", "PAIRS"):
        monkeypatch.setattr(controller_fit, name, 20_000)

    def controller(z):
        return np.digitize(z[:, 0] - z[:, 2], [-0.26, 0.24])

    tree = compress(
        policy, "linear", agreement=0.97, features=FEATURES, controller=controller, states=20_000
    )
    assert tree.guarantee.reached and tree.node_count <= 7
    readings = policy.space.sample(50_000, 8)
    assert (tree(readings) == controller(readings)).mean() > 0.97


def test_judges_draw_readings(policy):
    seen = []

    def controller(z):
        seen.append(z)
        return policy(z)

    tree = compress(policy, "freedom", controller=controller, states=4_000)
    drawn = np.concatenate(seen)
    assert drawn.shape[1] == 3 and policy.space.contains(drawn).all()
    assert np.ptp(drawn[:, 2]) > 0.95
    own = policy(drawn)
    share = (tree(drawn) == own).mean()
    assert share == pytest.approx(tree.guarantee.agreement, abs=0.02)


@pytest.mark.parametrize(
    ("feature", "message"),
    [
        (lambda x: x[0], r"`features\['f'\]` failed.*function of x and w"),
        (lambda x, w: x[2], r"x: 2, w: 1"),
        (lambda x, w: ca.log(w[0]), r"got nan at x1 = .*, setpoint = -"),
        (lambda x, w: ca.SX.sym("q"), "use only its arguments"),
    ],
)
def test_what_is_no_feature_of_readings_is_refused(policy, feature, message):
    with pytest.raises(ProblemError, match=message):
        compress(policy, features={"f": feature})


def test_features_of_policies_that_are_told_nothing_take_states_alone():
    policy = subdivide(lambda x: (x[:, 0] > x[:, 1]).astype(int), Box([0, 0], [1, 1]), 2,
                       partitions=4, max_level=3)  # fmt: skip
    tree = compress(policy, features={"below": lambda x: x[0] - x[1]})
    assert isinstance(tree.cells, FeatureTree)
    with pytest.raises(ProblemError, match="it must be a function of x, and of w where"):
        compress(policy, features={"below": lambda x, w: x[0] - w[0]})


def test_trees_of_synthesized_policies_agree_at_readings():
    problem = Problem(
        "line",
        lambda x, u, w: [u[0] + w[1]],
        Box([-1.0], [1.0]),
        [-1.0, 0.0, 1.0],
        0.0,
        0.5,
        running_cost=lambda x, w: (x[0] - w[0]) ** 2,
        exogenous=Box([-0.5, -0.2], [0.5, 0.2]),
        partitions=4,
        max_level=2,
    )
    policy = synthesize(problem)
    readings = policy.space.sample(50_000, 3)
    exact = compress(policy)
    np.testing.assert_array_equal(exact(readings), policy(readings))
    fitted = compress(policy, "linear", agreement=0.9, states=20_000)
    assert fitted.guarantee.reached
    assert fitted.exogenous == problem.exogenous and fitted.model is policy.model
