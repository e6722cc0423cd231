"""A policy with its exogenous inputs fixed is the whole policy at them, exactly.

All cuts are asked at more than a million states, those on faces of cells among them.
"""

import dataclasses
import functools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import Ball, Box, Policy, Switching, compress, synthesize
from capsyn.cells.cut import cut
from capsyn.cells.split_tree import LEAF
from capsyn.compression.proof import prove
from capsyn.errors import ProblemError
from capsyn.modelling.targets import target_program
from support.backends import has_compiler
from support.exports.remembering import random_prices, random_rows
from support.split_trees import all_points, random_split_tree, tree_of
from support.told import ROOMS, told, values_to_fix
from support.trees import random_affine_policy, random_policy, random_tree, states_at_faces

SIZE = 400
BACKENDS = ["numpy", "c"] if has_compiler() else ["numpy"]


def checked(policy, count=6, seed=0):
    """Assert that cuts of a policy are the policy there, and return the last of them."""
    k, symbols = policy.exogenous.n, len(policy.alphabet)
    for w in values_to_fix(policy, count, seed):
        at = policy.at(w)
        assert type(at) is type(policy) and at.exogenous is None
        assert at.domain is policy.domain and at.space is at.domain
        assert at.cells.counts == policy.cells.counts[:-k]
        at.cells.check(symbols + 1, at.transitions)
        x = states_at_faces(at.domain, at.cells.counts, SIZE, seed)
        for outside in ("nearest", 0, -1)[policy.gaps :]:
            assert np.array_equal(
                at(x, outside=outside, backend="numpy"),
                policy(x, w, outside=outside, backend="numpy"),
            )
        for backend in BACKENDS:
            for current in range(-1, symbols if policy.remembers else 0):
                options = {"outside": 0, "backend": backend, "current": current}
                assert np.array_equal(at(x, **options), policy(x, w, **options))
        assert np.array_equal(at.covers(x), policy.covers(x, w))
        inside = at.domain.contains(x)
        assert np.array_equal(at.control(x[inside], outside=0), policy.control(x[inside], w, 0))
    return at


@pytest.mark.parametrize("some_axes", [False, True])
@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize(("grid", "k"), [(3, 1), (4, 1), (5, 1), (6, 1), (6, 2), (7, 1), (7, 3)])
def test_constant_cells(grid, k, periodic, some_axes):
    for seed in range(3):
        policy = told(random_policy(grid, periodic, seed, some_axes), k)
        at = checked(policy, seed=seed)
        x = states_at_faces(at.domain, at.cells.counts, SIZE, seed)
        x = x[at.domain.contains(x)]
        w = values_to_fix(policy, 6, seed)[-1]
        assert np.array_equal(at.rows(x), policy.rows(x, w))
        assert mixed_of(at, x) == mixed_of(policy, policy.readings(x, w))


def mixed_of(policy, states):
    """Return for each state the labels seen in its cell where they did not agree, or None."""
    cells = policy.cells
    places = cells.find(policy.space.locate(states, cells.counts))
    known = dict(zip(cells.mixed_cells.tolist(), cells.mixed_labels.tolist()))
    return [known.get(place) for place in places.tolist()]


@pytest.mark.parametrize("some_axes", [False, True])
@pytest.mark.parametrize(("grid", "k"), [(3, 1), (5, 1), (6, 2), (7, 1), (7, 2)])
def test_affine_leaves(grid, k, some_axes):
    for seed in range(3):
        checked(told(random_affine_policy(grid, True, seed, some_axes), k), seed=seed)


@pytest.mark.parametrize("some_axes", [False, True])
@pytest.mark.parametrize(("grid", "k"), [(3, 1), (6, 2), (7, 2)])
def test_what_remembers(grid, k, some_axes):
    rows = told(random_rows(grid, some_axes), k)
    prices = told(random_prices(grid, some_axes), k)
    assert rows.remembers and prices.remembers
    checked(rows)
    checked(prices)


def test_gaps():
    policy = dataclasses.replace(told(random_policy(6), 1), gaps=True, outside=1)
    at = checked(policy)
    assert at.gaps and not at.covers(at.domain.sample(200)).all()


@pytest.mark.parametrize("planes", [0, 1, 6])
@pytest.mark.parametrize("periodic", range(3))
@pytest.mark.parametrize(
    ("counts", "k"), [((12, 7), 1), ((30, 1), 1), ((5, 6, 4), 1), ((5, 6, 4), 2), ((3, 4, 3, 5), 2)]
)
def test_trees(counts, k, periodic, planes):
    for seed in range(3):
        at = checked(told(tree_of(counts, planes, periodic, seed), k), seed=seed)
        assert at.guarantee.cut and "before exogenous inputs were fixed" in at.guarantee.text


@settings(max_examples=200)
@given(
    seed=st.integers(0, 10**6),
    counts=st.lists(st.integers(1, 5), min_size=2, max_size=4),
    planes=st.integers(0, 4),
    data=st.data(),
)
def test_every_step_of_a_cut_tree(seed, counts, planes, data):
    tree = random_split_tree(counts, planes, seed=seed)
    k = data.draw(st.integers(1, len(counts) - 1))
    steps = np.array([data.draw(st.integers(0, c - 1)) for c in counts[-k:]])
    found, points = cut(tree, steps), all_points(counts[:-k])
    found.check(3)
    whole = np.hstack([points, np.tile(steps, (len(points), 1))])
    assert np.array_equal(found.labels(points), tree.labels(whole))
    assert all(np.count_nonzero(plane) > 1 for plane in found.planes)
    assert found.node_count <= tree.node_count


@settings(max_examples=200)
@given(seed=st.integers(0, 10**6), some_axes=st.booleans(), data=st.data())
def test_every_step_of_cut_cells(seed, some_axes, data):
    n = data.draw(st.integers(2, 3))
    partitions = tuple(data.draw(st.integers(1, 3)) for _ in range(n))
    refinement = tuple(data.draw(st.integers(2, 3)) for _ in range(n))
    level = data.draw(st.integers(0, 2))
    tree = random_tree(partitions, refinement, level, seed=seed, some_axes=some_axes)
    k = data.draw(st.integers(1, n - 1))
    steps = np.array([data.draw(st.integers(0, c - 1)) for c in tree.counts[-k:]])
    found, points = cut(tree, steps), all_points(tree.counts[:-k])
    found.check(3)
    whole = np.hstack([points, np.tile(steps, (len(points), 1))])
    assert np.array_equal(found.labels(points), tree.labels(whole))
    assert found.leaf_count <= tree.leaf_count


def test_planes_that_are_left_with_one_axis_or_none():
    """``3 a - 2 b >= -3`` of steps (a, b), which splits an axis where the other is fixed."""
    tree = random_split_tree((4, 5), depth=0)
    tree = dataclasses.replace(
        tree,
        split=np.array([2, LEAF, LEAF], np.int32),
        threshold=np.array([-3, 0, 1], np.int32),
        second=np.array([2, 1, 2], np.int32),
        planes=np.array([[3, -2]], np.int32),
    )
    for b in range(5):
        found = cut(tree, np.array([b]))
        assert not len(found.planes)
        wanted = [int(3 * a - 2 * b >= -3) for a in range(4)]
        assert found.labels(np.arange(4)[:, None]).tolist() == wanted
        assert found.node_count == (1 if len(set(wanted)) == 1 else 3)
    swapped = dataclasses.replace(tree, counts=(5, 4), planes=np.array([[-2, 3]], np.int32))
    for a in range(4):
        found = cut(swapped, np.array([a]))
        wanted = [int(3 * a - 2 * b >= -3) for b in range(5)]
        assert found.labels(np.arange(5)[:, None]).tolist() == wanted


def test_thresholds_of_32_bits_that_fixed_axes_would_move_beyond():
    tree = random_split_tree((2, 2, 2), depth=0)
    for threshold in (2**31 - 1, -(2**31)):
        for sign in (1, -1):
            one = dataclasses.replace(
                tree,
                split=np.array([3, LEAF, LEAF], np.int32),
                threshold=np.array([threshold, 0, 1], np.int32),
                second=np.array([2, 1, 2], np.int32),
                planes=np.array([[1, 2, 9 * sign]], np.int32),
            )
            found = cut(one, np.array([1]))
            assert found.labels(all_points((2, 2))).tolist() == [int(threshold < 0)] * 4


PRICES = Switching(price=0.02, hold={"s2": 3.0})
MADE = {
    "isotropic": {},
    "adaptive": {"refine": "adaptive"},
    "affine": {"leaves": "affine"},
    "affine, adaptive": {"leaves": "affine", "refine": "adaptive"},
    "rows": {"switching": PRICES},
    "affine with prices": {"leaves": "affine", "refine": "adaptive", "switching": PRICES},
    "delay": {"delay": 2.0},
}


@functools.cache
def made(case):
    options = MADE[case]
    names = None if "switching" not in options else [f"s{i}" for i in range(5)]
    alphabet = ROOMS.alphabet if names is None else dataclasses.replace(ROOMS.alphabet, names=names)
    problem = ROOMS.replace(
        alphabet=alphabet, target=lambda x, w: ca.fabs(x[0] - w[0]) < 0.5, max_level=2
    )
    return synthesize(problem, **options)


@functools.cache
def compressed(mode):
    if mode == "features":
        return compress(made("isotropic"), features={"miss": lambda x, w: x[0] - w[0]})
    case = "affine" if mode == "linear" else "isotropic"
    return compress(made(case), mode=mode, agreement=0.9 if mode == "linear" else None)


def policy_of(case):
    return made(case) if case in MADE else compressed(case)


CASES = [*MADE, "exact", "freedom", "linear", "features"]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.filterwarnings("ignore:the tree gives some symbols")
def test_policies_of_problems(case, tmp_path):
    policy = policy_of(case)
    at = checked(policy, 12)
    at.save(tmp_path / "cut.cap")
    again = Policy.load(tmp_path / "cut.cap")
    x = again.domain.sample(2000)
    assert np.array_equal(again(x), at(x)) and again.exogenous is None
    again.save(tmp_path / "again.cap")
    assert (tmp_path / "again.cap").read_bytes() == (tmp_path / "cut.cap").read_bytes()
    for kept in ("horizon", "settings", "min_dwell", "delay", "outside", "time_unit", "switching"):
        assert getattr(at, kept) is getattr(policy, kept)
    assert not at.evidence and not at.statistics


@pytest.mark.parametrize("case", ["isotropic", "adaptive", "rows"])
def test_cuts_are_compressed(case):
    at = made(case).at([22.3, 31.0])
    tree = compress(at)
    assert prove(tree, at) == 0.0
    x = states_at_faces(at.domain, at.cells.counts, SIZE)
    assert np.array_equal(tree(x), at(x))


@pytest.mark.filterwarnings("ignore:the tree gives some symbols")
def test_a_cut_is_compressed_against_its_controller():
    tree = compress(made("affine").at([22.3, 31.0]), mode="linear", agreement=0.9)
    assert tree.guarantee.controller == "ssac" and tree.guarantee.reached


@pytest.mark.parametrize("w", [[20, 20], [25, 38], [22.3, 31.0]])
def test_the_model_is_the_model_there(w):
    whole, at = made("isotropic").model, made("isotropic").at(w).model
    compare(whole, at, w, "dynamics step adjoint running_cost terminal_cost insertion".split())
    assert at.prediction is None


@pytest.mark.parametrize("w", [[20, 20], [22.3, 31.0]])
def test_the_prediction_is_the_prediction_there(w):
    law = ROOMS.replace(default=lambda x, w: [ca.tanh(x[0] - w[0]) + 1, 0.5])
    policy = synthesize(law, partitions=2, max_level=0)
    whole, at = policy.model.prediction, policy.at(w).model.prediction
    compare(whole, at, w, ["law", "step", "adjoint", "insertion"])


def compare(whole, at, w, names):
    """Assert that programs of the states alone give what those of readings do at w."""
    rng, x = np.random.default_rng(3), ROOMS.domain.sample(200).T
    for name in names:
        one, other = getattr(at, name), getattr(whole, name)
        assert [port for port, _ in one.inputs] == [port for port, _ in other.inputs]
        own, all_of_it = [], []
        for port, size in one.inputs:
            value = x if port == "x" else rng.normal(size=(size, 200))
            more = {
                "x": np.tile(np.array(w, float)[:, None], 200),
                "rho": rng.normal(size=(2, 200)),
            }
            own.append(value)
            rest = more.get(port.removesuffix("_next"), np.empty((0, 200)))
            all_of_it.append(np.vstack([value, rest]))
        for (port, size), found, wanted in zip(
            one.outputs, one.evaluate(*own), other.evaluate(*all_of_it)
        ):
            assert np.array_equal(*np.broadcast_arrays(found, wanted[:size])), (name, port)


TARGETS = {
    "ball": (Ball([22, 22], 1.0), lambda x, w: ((x - 22) ** 2).sum(axis=1) <= 1),
    "box": (Box([20, 20], [23, 24]), lambda x, w: ((x >= 20) & (x <= [23, 24])).all(axis=1)),
    "named": (Box([20], [23], names=["T2"]), lambda x, w: (x[:, 1] >= 20) & (x[:, 1] <= 23)),
    "with w": (
        Box([20, 21], [23, 24], names=["T1", "setpoint"]),
        lambda x, w: (x[:, 0] >= 20) & (x[:, 0] <= 23) & (21 <= w[0] <= 24),
    ),
    "function": (
        lambda x, w: ca.fabs(x[0] - w[0]) < 0.5,
        lambda x, w: np.abs(x[:, 0] - w[0]) < 0.5,
    ),
}


@pytest.mark.parametrize("case", TARGETS)
@pytest.mark.parametrize("w", [[20, 20], [22.5, 30]])
def test_targets(case, w, tmp_path):
    target, rule = TARGETS[case]
    at = synthesize(ROOMS.replace(target=target), partitions=2, max_level=0).at(w)
    at.save(tmp_path / "cut.cap")
    at, x = Policy.load(tmp_path / "cut.cap"), at.domain.sample(500)
    inside = target_program(at.target, at.domain).evaluate(x.T)[0][0] != 0
    assert np.array_equal(np.broadcast_to(inside, 500), np.broadcast_to(rule(x, w), 500))


def test_names_numbers_and_broadcasts():
    policy = made("isotropic")
    x, by_name = policy.domain.sample(50), policy.at({"outdoor": 31, "setpoint": 22.3})
    assert np.array_equal(by_name(x), policy.at((22.3, 31))(x))
    one = told(random_policy(3), 1)
    w = one.exogenous.lower[0] + 0.01
    assert np.array_equal(one.at(w)(one.domain.sample(50)), one(one.domain.sample(50), w))


def test_a_periodic_input_may_be_turns_away():
    policy = told(random_policy(6, True), 1)
    turn = policy.exogenous.widths[0]
    w = policy.exogenous.lower + 0.3 * turn
    x = states_at_faces(policy.domain, policy.cells.counts[:-1], 200)
    for turns in (-2, 1):
        at = policy.at(w + turns * turn)
        assert np.array_equal(at(x, outside=0), policy(x, w + turns * turn, outside=0))
        assert np.array_equal(at(x, outside=0), policy.at(w)(x, outside=0))


NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("w", "message"),
    [
        ([19.9, 30], "must be one of each: setpoint in [20, 25], outdoor in [20, 38]; got [19.9"),
        ([22, NAN], "must be one of each: setpoint in [20, 25]"),
        ([22, INF], "must be one of each: setpoint in [20, 25]"),
        ([[22, 30]], "must be one of each"),
        ([[22, 30], [22, 31]], "must be one of each"),
        ([22], "must be numbers of shape (..., 2): setpoint, outdoor; got shape (1,)"),
        (22, "must be numbers of shape (..., 2): setpoint, outdoor; got shape ()"),
        ([22, 30, 1], "must be numbers of shape (..., 2)"),
        (None, "must be"),
        ("warm", "must be"),
        ({"setpoint": 22}, "must give setpoint, outdoor; got setpoint"),
        ({"setpoint": 22, "outside": 30}, "must give setpoint, outdoor; got setpoint, outside"),
        ({"setpoint": 22, "outdoor": [30, 31]}, "must be one of each"),
        ({"setpoint": 22, "outdoor": "warm"}, "must be"),
        ({}, "must give setpoint, outdoor; got"),
    ],
)
def test_wrong_inputs(w, message):
    with pytest.raises(ProblemError) as error:
        made("isotropic").at(w)
    text = str(error.value)
    assert text.startswith("`exogenous` ") and message in text and "\n" not in text


def test_a_policy_that_is_told_nothing():
    with pytest.raises(ProblemError, match="^`exogenous` must be left out: the policy is told"):
        random_policy(3).at([1.0])


def test_a_cut_of_a_cut():
    with pytest.raises(ProblemError, match="^`exogenous` must be left out"):
        made("isotropic").at([22, 30]).at([22, 30])


def test_cuts_of_problems_have_many_cells():
    sizes = {len(made(case).at([22.3, 31.0]).cells.entries) for case in MADE}
    assert min(sizes) > 9 and len(sizes) > 2
