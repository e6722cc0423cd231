"""Decision trees as policies: every lookup and loop gives the same."""

import dataclasses
import json

import casadi as ca
import matplotlib

from capsyn.errors import PolicyFormatError
from support.split_trees import BOXED, guarantee, tree_of

matplotlib.use("Agg")

import numpy as np
import pytest

import capsyn
from capsyn import Ball, Box, DecisionTree, Policy, online_controller, problems, simulate
from capsyn.errors import OutsideDomainError, ProblemError
from capsyn.policies.file import content_hash
from capsyn.policies.lookup import COMPILED_FROM
from capsyn.policies.report import hints, report
from capsyn.verification.agreement import agreement
from capsyn.verification.lyapunov import lyapunov, lyapunov_grid
from capsyn.verification.monte_carlo import monte_carlo
from capsyn.verification.trials import Uniform
from support.backends import backends, needs_compiler
from support.closed_loops import BACKENDS, assert_same_trials, linear_problem, random_grid_policy
from support.split_trees import all_points, leaf_of, random_split_tree
from support.trees import states_at_faces

NAN, INF = float("nan"), float("inf")
HUGE = 1.7976931348623157e308
ONE_BOX = "^a tree with oblique splits has no boxes; compress in mode exact or freedom$"
PENDULUM = problems.plain("cart-pendulum")


@pytest.fixture(scope="module")
def pendulum():
    """A policy with its model, and its exact tree."""
    policy = capsyn.synthesize(PENDULUM, partitions=5, max_level=3)
    return policy, capsyn.compress(policy)


@pytest.fixture(scope="module")
def linear():
    """A policy of three states and inputs with random labels, and its exact tree."""
    policy = dataclasses.replace(random_grid_policy(linear_problem()), outside="nearest")
    return policy, capsyn.compress(policy)


# lookups


def by_the_rule(tree, state, nearest):
    """Return the symbol of one state, or None where it has none, from the documented rules."""
    domain, counts, steps = tree.domain, tree.cells.counts, []
    for i, x in enumerate(state.tolist()):
        low, high = float(domain.lower[i]), float(domain.upper[i])
        if not np.isfinite(x):
            return None
        if domain.periodic[i] and not low <= x < high:
            x = float(domain.wrap(state[None])[0, i])
        if not low <= x <= high and not nearest:
            return None
        k = sum(x >= f for f in domain.faces(i, np.arange(1, counts[i]), counts[i]).tolist())
        steps.append(k)
    label = int(tree.cells.threshold[leaf_of(tree.cells, steps)[0]])
    return -1 if label == len(tree.alphabet) else label


def hard_states(tree, size, seed=0):
    """Return states on faces and seams, beside them, turns away, and outside."""
    domain = tree.domain
    states = states_at_faces(domain, tree.cells.counts, size, seed)
    rng = np.random.default_rng(seed)
    turns = rng.integers(-3, 4, states.shape) * domain.widths * (rng.random(states.shape) < 0.2)
    return np.vstack([states, states + turns])


@pytest.mark.parametrize("counts", BOXED)
@pytest.mark.parametrize("planes", [0, 3])
@pytest.mark.parametrize("periodic", range(3))
@backends
def test_lookups_follow_the_rule(counts, planes, periodic, backend):
    tree = tree_of(counts, planes, periodic, seed=len(counts))
    states = hard_states(tree, 40)
    wanted = [by_the_rule(tree, state, True) for state in states]
    assert tree(states, outside="nearest", backend=backend).tolist() == wanted
    inside = [by_the_rule(tree, state, False) for state in states]
    for symbol in (0, 1, -1):
        given = [symbol if k is None else k for k in inside]
        assert tree(states, outside=symbol, backend=backend).tolist() == given
    lost = [i for i, k in enumerate(inside) if k is None]
    if lost:
        with pytest.raises(OutsideDomainError, match=f"^state {lost[0]} must lie in the domain"):
            tree(states, outside="error", backend=backend)


@pytest.mark.parametrize("planes", [0, 2])
@pytest.mark.parametrize("periodic", range(3))
@backends
def test_numbers_that_are_none_and_huge_ones(planes, periodic, backend):
    tree = tree_of((12, 7), planes, periodic)
    middle = tree.domain.lower + tree.domain.widths / 3
    odd = [NAN, INF, -INF, HUGE, -HUGE, 1e300, 5e-324, -0.0]
    states = np.array([(x, middle[1]) for x in odd] + [(middle[0], x) for x in odd])
    states = np.vstack([states, np.tile(middle, (60, 1)), states])
    wanted = [by_the_rule(tree, state, False) for state in states]
    assert tree(states, outside=0, backend=backend).tolist() == [
        0 if k is None else k for k in wanted
    ]
    finite = np.isfinite(states).all(axis=1)
    near = [by_the_rule(tree, state, True) for state in states[finite]]
    assert tree(states[finite], outside="nearest", backend=backend).tolist() == near
    for rule in ("error", "nearest"):
        with pytest.raises(OutsideDomainError, match="^state 0 must be finite; got"):
            tree(states, outside=rule, backend=backend)


@needs_compiler
@pytest.mark.parametrize("planes", [0, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 63, 64, 65, 127, 128, 129, 1000])
def test_batches_of_every_size(planes, count):
    tree = tree_of((30, 17), planes, 1, seed=3)
    states = np.resize(hard_states(tree, 200), (1000, 2))[:count]
    found = tree(states, outside="nearest", backend="c")
    assert found.shape == (count,) and found.dtype == np.int32
    assert np.array_equal(found, tree(states, outside="nearest", backend="numpy"))
    assert found.tolist() == [int(tree(state, outside="nearest", backend="c")) for state in states]


@needs_compiler
@pytest.mark.parametrize("planes", [0, 3])
def test_large_batches_take_the_compiled_lookup(planes, monkeypatch):
    tree = tree_of((300, 170, 9), planes, 1, seed=7, depth=10)
    states = np.resize(hard_states(tree, 9000), (COMPILED_FROM + 137, 3))
    wanted = tree(states, outside="nearest", backend="numpy")
    assert len(set(wanted.tolist())) == 3
    monkeypatch.setattr(type(tree.cells), "labels", None)
    assert np.array_equal(tree(states, outside="nearest"), wanted)


@needs_compiler
@pytest.mark.parametrize("seed", range(20))
def test_compiled_lookups_of_random_trees(seed):
    rng = np.random.default_rng(seed)
    counts = tuple(rng.integers(1, [2000, 40, 9, 6][n := seed % 4], n + 1).tolist())
    tree = tree_of(counts, int(rng.integers(4)), seed % 3, seed, depth=9)
    states = hard_states(tree, 300, seed)
    for rule in ("nearest", 1):
        assert np.array_equal(
            tree(states, outside=rule, backend="c"), tree(states, outside=rule, backend="numpy")
        )


@needs_compiler
def test_arrays_of_other_integers_are_looked_up_the_same():
    tree = tree_of((30, 17), 2, seed=3)
    names = ("split", "threshold", "second", "planes")
    wide = {name: getattr(tree.cells, name).astype(np.int64) for name in names}
    other = dataclasses.replace(tree, cells=dataclasses.replace(tree.cells, **wide))
    states = hard_states(tree, 200)
    for backend in ("c", "numpy"):
        assert np.array_equal(
            other(states, outside="nearest", backend=backend), tree(states, outside="nearest")
        )


@backends
def test_a_tree_of_one_leaf(backend):
    for label, symbol in ((0, 0), (1, 1), (2, -1)):
        cells = random_split_tree((7, 5), depth=0)
        cells = dataclasses.replace(cells, threshold=np.array([label], np.int32))
        tree = tree_of((7, 5), cells=cells)
        states = tree.domain.sample(130)
        assert tree(states, backend=backend).tolist() == [symbol] * 130
        assert (tree.node_count, tree.depth, tree.cells.leaf_count) == (1, 0, 1)
        assert tree.volume_shares.tolist() == [label == k for k in range(3)]


@backends
def test_planes_with_large_numbers(backend):
    """Sums near the ends of 32 bits, on a lattice of 2 ** 30 steps."""
    cells = random_split_tree((9, 3), 6, depth=7, seed=2)
    planes = np.array([[1, 5], [-1, 7], [1, -(2**28)], [-1, 2**28], [1, 2**28], [-1, -1]], "i4")
    point = np.array([2**29 + 12345, 1])
    split = cells.split
    planes = planes[np.arange(len(cells.planes)) % 6]
    cut = planes.astype(int) @ point
    shifted = cells.threshold + np.where(split == 0, point[0] - 4, 0)
    threshold = np.where(split >= 2, cut[split - 2], shifted).astype(np.int32)
    large = {"counts": (2**30, 3), "planes": planes, "threshold": threshold}
    tree = tree_of((2**30, 3), cells=dataclasses.replace(cells, **large))
    steps = point + np.array([(a, b) for a in range(-5, 6) for b in (-1, 0, 1)])
    middles = tree.domain.lower + (steps + 0.5) / tree.cells.counts * tree.domain.widths
    wanted = [int(tree.cells.threshold[leaf_of(tree.cells, z.tolist())[0]]) for z in steps]
    found = tree(middles, backend=backend)
    assert np.array_equal(np.where(found < 0, 2, found), wanted) and len(set(wanted)) > 1


# loops


@pytest.mark.parametrize("backend", BACKENDS)
def test_simulate_gives_the_same_as_with_the_policy(linear, pendulum, backend):
    for (policy, tree), duration in ((linear, 1.0), (pendulum, 2.0)):
        states = policy.domain.sample(12, 3)
        one, two = (
            simulate(controller, states, duration, 20.0, backend=backend)
            for controller in (policy, tree)
        )
        assert one.symbols.min() == -1 or policy is not linear[0]
        assert len(np.unique(one.symbols)) > 1
        for name, value in vars(one).items():
            other = getattr(two, name)
            if isinstance(value, np.ndarray):
                assert np.array_equal(value, other, equal_nan=value.dtype.kind == "f"), name


@pytest.mark.parametrize("backend", BACKENDS)
def test_monte_carlo_gives_the_same_as_with_the_policy(linear, backend):
    options = {
        "duration": 1.0,
        "rate": 10,
        "target": Ball([0, 0, 0], 0.5),
        "noise": Uniform(0, [0.1, 0.2, 0]),
        "delay": Uniform(0.05, 0.25),
        "backend": backend,
    }
    one, two = (monte_carlo(controller, 40, seed=4, **options) for controller in linear)
    assert_same_trials(one, two)
    assert one.final.std() > 0


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_tree_as_background_of_an_online_controller(pendulum, backend):
    states = PENDULUM.domain.sample(40, 1)
    one, two = (
        online_controller(PENDULUM, default=background, backend=backend).actions(states)
        for background in pendulum
    )
    for name, value in vars(one).items():
        if isinstance(value, np.ndarray):
            other = getattr(two, name)
            assert np.array_equal(value, other, equal_nan=value.dtype.kind == "f"), name
    assert len(np.unique(one.symbol)) > 1


@pytest.mark.parametrize("planes", [0, 2])
def test_an_online_controller_around_trees_is_the_same_in_c_and_numpy(planes):
    cells = random_split_tree((30, 20), planes, depth=8, seed=5)
    controls = {"alphabet": PENDULUM.alphabet, "domain": PENDULUM.domain, "outside": "nearest"}
    tree = dataclasses.replace(tree_of((30, 20), cells=cells), **controls)
    states = PENDULUM.domain.sample(30, 2)
    one, two = (
        online_controller(PENDULUM, default=tree, backend=backend).actions(states)
        for backend in BACKENDS
    )
    assert np.array_equal(one.base_symbol, two.base_symbol)
    assert np.array_equal(one.symbol, two.symbol)
    assert one.base_symbol.tolist() == tree(states).tolist()


# evidence and reports


def test_agreement_of_a_tree(pendulum):
    policy, tree = pendulum
    found = agreement(tree, 3000, controller=policy)
    assert found.agreeing == found.states == found.mixed_states == 3000
    assert found.island_cells == 0 and found.level_states.tolist() == [3000]
    one, two = agreement(tree, 3000, seed=2), agreement(policy, 3000, seed=2)
    assert one.agreeing == two.agreeing < 3000 and np.array_equal(one.pairs, two.pairs)
    assert np.array_equal(one.disagreeing_states, two.disagreeing_states)
    json.dumps(one.to_json())


def test_agreement_of_an_oblique_tree():
    tree, other = tree_of((30, 20), 3, seed=1), tree_of((30, 20), 2, seed=1)
    found = agreement(tree, 2000, controller=other, seed=7)
    states = tree.domain.sample(2000, 7)
    assert found.agreeing == (tree(states) == other(states)).sum() < 2000
    assert found.island_cells == 0


def energy(x):
    return ca.cos(x[0]) + x[1] ** 2


def test_lyapunov_of_a_tree(pendulum):
    policy, tree = pendulum
    proof = lyapunov(tree, energy, depth=6)
    assert proof.proved + proof.violated + proof.undecided == pytest.approx(1)
    assert proof.cells == tree.cells.leaf_count
    wanted = lyapunov(policy, energy, depth=12)
    assert 0.2 < proof.proved <= 1 - wanted.violated and proof.violated <= 1 - wanted.proved
    for cells in (proof.violated_cells, proof.undecided_cells):
        middles = (cells.lower + cells.upper) / 2
        assert np.array_equal(tree(middles), cells.symbols)
        assert np.array_equal(policy(middles), cells.symbols)
        assert not cells.levels.any()
    assert len(proof.violated_cells) > 5
    assert np.array_equal(tree(proof.violated_cells.states), proof.violated_cells.symbols)
    assert proof.violated_cells.boundary.any()
    one, two = (lyapunov_grid(p, energy, 0.1) for p in pendulum)
    assert np.array_equal(one.signs, two.signs)


def test_boundary_leaves_are_those_with_an_unlike_neighbour():
    # labels 0 0 1 1 as four leaves of a line: the second and the third are on the boundary
    policy = capsyn.synthesize(
        capsyn.Problem(
            name="line",
            dynamics=lambda x, u: [u[0]],
            domain=Box([-1], [1]),
            alphabet=[1.0, 2.0],
            default=0.0,
            horizon=0.5,
            running_cost=lambda x: x[0] ** 2,
        ),
        partitions=4,
        max_level=0,
    )
    cells = capsyn.cells.split_tree.SplitTree(
        (4,),
        np.array([0, 0, -1, -1, 0, -1, -1], np.int32),
        np.array([2, 1, 0, 0, 3, 1, 1], np.int32),
        np.array([4, 3, 2, 3, 6, 5, 6], np.int32),
        np.zeros((0, 1), np.int32),
    )
    fields = {f.name: getattr(policy, f.name) for f in dataclasses.fields(Policy)}
    tree = DecisionTree(**fields | {"cells": cells, "guarantee": guarantee()})
    proof = lyapunov(tree, lambda x: x[0], depth=2)
    assert proof.violated == 1 and proof.violated_cells.entries.tolist() == [2, 3, 5, 6]
    assert proof.violated_cells.boundary.tolist() == [False, True, True, False]


def test_what_needs_boxes_refuses_oblique_trees(pendulum):
    cells = random_split_tree((30, 20), 2)
    tree = dataclasses.replace(pendulum[1], cells=cells, guarantee=guarantee("linear"))
    with pytest.raises(ProblemError, match=ONE_BOX):
        lyapunov(tree, energy, depth=2)
    assert lyapunov_grid(tree, energy, 0.5).signs.size  # this needs none


@pytest.mark.parametrize("planes", [0, 2])
def test_a_report_of_a_tree_is_plain_data(planes):
    tree = tree_of((12, 7), planes, seed=3)
    data = json.loads(json.dumps(report(tree)))
    assert (data["nodes"], data["depth"]) == (tree.node_count, tree.depth)
    rows = len(tree.cells.planes)
    assert data["planes"] == rows and data["tree_bytes"] == 12 * tree.node_count + 8 * rows
    assert data["guarantee"]["text"] == tree.guarantee.text
    assert data["sha256"] == content_hash(tree)
    assert [state["steps"] for state in data["states"]] == [12, 7]
    assert "cells" not in data and "mixed_share" not in data
    shares = [s["volume_share"] for s in data["symbols"]] + [data["default"]["volume_share"]]
    labels = tree.cells.labels(all_points((12, 7)))
    wanted = np.bincount(labels, minlength=3) / 84
    assert shares == pytest.approx(wanted.tolist(), abs=0.01 if planes else 1e-12)
    assert isinstance(hints(tree), list) and tree.mixed_share == 0
    assert f"{tree.node_count} nodes" in repr(tree) and tree.guarantee.mode in repr(tree)


def test_trees_are_made_of_split_trees_and_guarantees():
    tree = tree_of((12, 7))
    cells = random_grid_policy(linear_problem(2)).cells
    with pytest.raises(ProblemError, match="^`cells` must be a SplitTree; got"):
        dataclasses.replace(tree, cells=cells)
    fields = {f.name: getattr(tree, f.name) for f in dataclasses.fields(Policy)}
    with pytest.raises(ProblemError, match="^`cells` must be a CellTree"):
        Policy(**fields)
    with pytest.raises(ProblemError, match="^`guarantee` must be a Guarantee; got None"):
        dataclasses.replace(tree, guarantee=None)
    with pytest.raises(ProblemError, match="^`cells` must have 2 axes like the domain; got 1"):
        dataclasses.replace(tree, cells=random_split_tree((5,)))
    with pytest.raises(PolicyFormatError, match="unknown label"):
        dataclasses.replace(tree, cells=random_split_tree((12, 7), labels=9))
