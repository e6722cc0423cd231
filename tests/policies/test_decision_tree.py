"""Decision trees as policies: every lookup and loop gives the same; files are hardened."""

import dataclasses
import json
import struct

import casadi as ca
import matplotlib

matplotlib.use("Agg")

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from safetensors.numpy import save_file

import capsyn
from capsyn import Alphabet, Ball, Box, DecisionTree, Policy, online_controller, problems, simulate
from capsyn.cells.packing import packed_bytes, smallest_type
from capsyn.errors import OutsideDomainError, PolicyFormatError, ProblemError
from capsyn.plots.policy import plot_policy, save_policy_plot
from capsyn.policies.colors import PALETTE
from capsyn.policies.file import VERSION, content_hash
from capsyn.policies.guarantee import Guarantee
from capsyn.policies.lookup import COMPILED_FROM
from capsyn.policies.report import hints, report
from capsyn.verification.agreement import agreement
from capsyn.verification.lyapunov import lyapunov, lyapunov_grid
from capsyn.verification.monte_carlo import Uniform, monte_carlo
from cells.test_split_tree import all_points, leaf_of, random_split_tree
from plots.test_plots import area
from policies.test_policy import backends, needs_compiler
from policies.test_policy_file import (
    TRIALS,
    array,
    at,
    canonical,
    delete,
    full,
    put,
    read,
    refuse,
    resize,
    rewrite,
    set_version,
    with_header,
)
from support.closed_loops import BACKENDS, linear_problem, random_grid_policy
from support.trees import states_at_faces
from verification.test_monte_carlo import same

NAN, INF = float("nan"), float("inf")
HUGE = 1.7976931348623157e308
SOURCE = "0" * 64
ONE_BOX = "^a tree with oblique splits has no boxes; compress in mode exact or freedom$"
LATTICES = [(1,), (19,), (12, 7), (30, 1), (5, 6, 4), (3, 4, 3, 5), (2,) * 14]
PENDULUM = problems.get("cart-pendulum")


def guarantee(mode="exact", **known):
    return Guarantee(mode, SOURCE, **known)


def tree_of(counts, planes=0, periodic=0, seed=0, depth=6, **changes):
    """Return a tree over a box with bounds that do not divide; `periodic`: none, some, all."""
    rng, n = np.random.default_rng(seed), len(counts)
    lower = rng.normal(size=n)
    turning = [[False] * n, [i % 2 == 0 for i in range(n)], [True] * n][periodic]
    domain = Box(lower, lower + rng.uniform(0.1, 7, n), periodic=turning)
    cells = changes.pop("cells", None)
    cells = cells or random_split_tree(counts, planes, depth=depth, seed=seed)
    made = guarantee("linear" if planes else "exact")
    fields = {"default": np.zeros(1), "cells": cells, "guarantee": made}
    return DecisionTree("tree", domain, Alphabet([-1, 1]), **fields | changes)


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


@pytest.mark.parametrize("counts", LATTICES)
@pytest.mark.parametrize("planes", [0, 3])
@pytest.mark.parametrize("periodic", range(3))
@backends
def test_lookups_follow_the_rule(counts, planes, periodic, backend):
    tree = tree_of(counts, planes, periodic, seed=len(counts))
    states = hard_states(tree, 40)
    wanted = [by_the_rule(tree, state, True) for state in states]
    assert tree(states, "nearest", backend).tolist() == wanted
    inside = [by_the_rule(tree, state, False) for state in states]
    for symbol in (0, 1, -1):
        given = [symbol if k is None else k for k in inside]
        assert tree(states, symbol, backend).tolist() == given
    lost = [i for i, k in enumerate(inside) if k is None]
    if lost:
        with pytest.raises(OutsideDomainError, match=f"^state {lost[0]} must lie in the domain"):
            tree(states, "error", backend)


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
    assert tree(states, 0, backend).tolist() == [0 if k is None else k for k in wanted]
    finite = np.isfinite(states).all(axis=1)
    near = [by_the_rule(tree, state, True) for state in states[finite]]
    assert tree(states[finite], "nearest", backend).tolist() == near
    for rule in ("error", "nearest"):
        with pytest.raises(OutsideDomainError, match="^state 0 must be finite; got"):
            tree(states, rule, backend)


@needs_compiler
@pytest.mark.parametrize("planes", [0, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 63, 64, 65, 127, 128, 129, 1000])
def test_batches_of_every_size(planes, count):
    tree = tree_of((30, 17), planes, 1, seed=3)
    states = np.resize(hard_states(tree, 200), (1000, 2))[:count]
    found = tree(states, "nearest", "c")
    assert found.shape == (count,) and found.dtype == np.int32
    assert np.array_equal(found, tree(states, "nearest", "numpy"))
    assert found.tolist() == [int(tree(state, "nearest", "c")) for state in states]


@needs_compiler
@pytest.mark.parametrize("planes", [0, 3])
def test_large_batches_take_the_compiled_lookup(planes, monkeypatch):
    tree = tree_of((300, 170, 9), planes, 1, seed=7, depth=10)
    states = np.resize(hard_states(tree, 9000), (COMPILED_FROM + 137, 3))
    wanted = tree(states, "nearest", "numpy")
    assert len(set(wanted.tolist())) == 3
    monkeypatch.setattr(Policy, "_labels", None)
    assert np.array_equal(tree(states, "nearest"), wanted)


@needs_compiler
@pytest.mark.parametrize("seed", range(20))
def test_compiled_lookups_of_random_trees(seed):
    rng = np.random.default_rng(seed)
    counts = tuple(rng.integers(1, [2000, 40, 9, 6][n := seed % 4], n + 1).tolist())
    tree = tree_of(counts, int(rng.integers(4)), seed % 3, seed, depth=9)
    states = hard_states(tree, 300, seed)
    for rule in ("nearest", 1):
        assert np.array_equal(tree(states, rule, "c"), tree(states, rule, "numpy"))


@needs_compiler
def test_arrays_of_other_integers_are_looked_up_the_same():
    tree = tree_of((30, 17), 2, seed=3)
    names = ("split", "threshold", "second", "planes")
    wide = {name: getattr(tree.cells, name).astype(np.int64) for name in names}
    other = dataclasses.replace(tree, cells=dataclasses.replace(tree.cells, **wide))
    states = hard_states(tree, 200)
    for backend in ("c", "numpy"):
        assert np.array_equal(other(states, "nearest", backend), tree(states, "nearest"))


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
    same(one, two)
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


# evidence, pictures and figures


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


def test_a_picture_of_a_tree_has_its_colours():
    tree = tree_of((12, 7, 5), periodic=1, seed=3)
    ax = plot_policy(tree, (2, 0), ax=Figure().add_subplot())
    paths = [path for cells in ax.collections for path in cells.get_paths()]
    colours = [color for cells in ax.collections for color in cells.get_facecolor()]
    widths = tree.domain.widths
    assert len(paths) > 3 and sum(map(area, paths)) == pytest.approx(widths[2] * widths[0])
    states = np.tile(tree.domain.lower + widths / 2, (len(paths), 1))
    states[:, [2, 0]] = [path.vertices[:4].mean(axis=0) for path in paths]
    palette = [*PALETTE[:2], "#FFFFFF"]
    assert [to_hex(c).upper() for c in colours] == [palette[k] for k in tree(states)]


def test_a_picture_of_an_oblique_tree_has_its_colours(tmp_path, monkeypatch):
    monkeypatch.setattr("capsyn.plots.policy.PIXELS", 40)
    tree = tree_of((12, 7, 5), 3, periodic=1, seed=3)
    point = tree.domain.lower + 0.3 * tree.domain.widths
    ax = plot_policy(tree, (2, 0), {"x2": point[1]}, Figure().add_subplot())
    (image,) = ax.get_images()
    left, right, bottom, top = image.get_extent()
    low, high = tree.domain.lower, tree.domain.upper
    assert (left, right, bottom, top) == (low[2], high[2], low[0], high[0])
    pixels, palette = image.get_array(), [*PALETTE[:2], "#FFFFFF"]
    assert pixels.shape == (40, 40, 3)
    seen = set()
    for i, j in np.random.default_rng(0).integers(0, 40, (200, 2)):
        state = point.copy()
        state[2] = left + (j + 0.5) * (right - left) / 40
        state[0] = bottom + (i + 0.5) * (top - bottom) / 40
        symbol = int(tree(state))
        seen.add(symbol)
        assert to_hex(pixels[i, j]).upper() == palette[symbol]
    assert len(seen) > 1
    assert image.origin == "lower"
    for name in ("one.svg", "two.svg"):
        save_policy_plot(tree, tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


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


def test_packed_bytes():
    for values, kind in (
        ([], "i1"),
        ([127, -128], "i1"),
        ([128], "u1"),
        ([255], "u1"),
        ([-129], "i2"),
        ([128, -1], "i2"),
        ([256], "i2"),
        ([2**15], "u2"),
        ([2**16], "i4"),
        ([-(2**31)], "i4"),
    ):
        assert smallest_type(np.array(values, dtype=np.int64)) == np.dtype(kind), values
    cells = random_split_tree((300, 7), 2, seed=1)
    one_each = cells.node_count + cells.planes.size + cells.node_count
    size = smallest_type(cells.threshold).itemsize
    assert packed_bytes(cells) == one_each + size * cells.node_count
    policy = random_grid_policy(linear_problem())
    assert packed_bytes(policy.cells) == len(policy.cells.entries)


# guarantees


@pytest.mark.parametrize(
    "known",
    [
        {"mode": "other"},
        {"mode": []},
        {"controller": "other"},
        {"controller": None},
        {"source": "0" * 63},
        {"source": "G" * 64},
        {"source": None},
        {"level": -1},
        {"level": 64},
        {"level": 1.0},
        {"level": True},
        {"changed": -0.1},
        {"changed": 1.1},
        {"changed": NAN},
        {"changed": "0"},
        {"changed": True},
        {"states": -1},
        {"states": 1.0},
        {"states": 2**53, "controller": "ssac"},
        {"states": 5},
        {"controller": "ssac"},
        {"states": 5, "agreeing": 6, "controller": "ssac"},
        {"agreeing": -1},
        {"target": 1.5},
        {"target": "0.5"},
        {"target": NAN},
    ],
)
def test_guarantees_that_make_no_sense_are_refused(known):
    with pytest.raises(ProblemError) as caught:
        Guarantee(**{"mode": "exact", "source": SOURCE} | known)
    assert "\n" not in str(caught.value)


def test_guarantees_in_a_sentence():
    assert guarantee().text == "equal to the policy in every cell (proved)"
    assert np.isnan(guarantee().agreement)
    cut = guarantee(level=2, changed=0.125).text
    assert "policy cut off at level 2 in every cell (proved); another symbol" in cut
    assert cut.endswith("in 12.50% of the volume")
    free = guarantee("freedom", controller="ssac", states=200, agreeing=199)
    assert free.agreement == 0.995
    assert "test points agreed, and a symbol seen in the cell elsewhere (proved);" in free.text
    assert free.text.endswith(
        "agrees with sSAC at 99.50% of 200 random states (97.24% to 99.988% with 95% confidence)"
    )
    linear = guarantee("linear", changed=0.5, controller="policy", states=10, agreeing=5)
    assert linear.text.startswith("another symbol than the policy's in 50.00% of the volume (est")
    assert "proved" not in linear.text and "agrees with the policy at 50.00%" in linear.text
    assert Guarantee(**json.loads(json.dumps(free.to_json()))) == free


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


# files


def full_tree(planes=1, **changes):
    """Return a tree whose every field is something."""
    policy = full()
    fields = {f.name: getattr(policy, f.name) for f in dataclasses.fields(Policy)}
    known = {
        "mode": "linear" if planes else "freedom",
        "source": "0123456789abcdef" * 4,
        "level": 1,
        "changed": 0.25,
        "controller": "ssac",
        "states": 10,
        "agreeing": 9,
        "target": 0.99,
    }
    fields |= {"cells": random_split_tree((12, 18), planes, seed=4), "timings": {}}
    return DecisionTree(**fields | {"guarantee": Guarantee(**known)} | changes)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "p.cap"
    full_tree().save(path)
    return path


def assert_equal(one, other):
    assert type(one) is type(other) is DecisionTree
    for field in dataclasses.fields(DecisionTree):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "cells":
            assert a.counts == b.counts
            for name in ("split", "threshold", "second", "planes"):
                x, y = getattr(a, name), getattr(b, name)
                assert np.array_equal(x, y) and x.dtype == y.dtype and x.shape == y.shape
        elif field.name == "default":
            assert a.tobytes() == b.tobytes()
        elif field.name != "timings":
            assert a == b and type(a) is type(b), field.name


SOME = {
    "oblique": full_tree(3),
    "axes": full_tree(0),
    "one leaf": tree_of((7,), cells=random_split_tree((7,), depth=0)),
    "with evidence": full_tree().with_evidence(monte_carlo=TRIALS),
    "plain guarantee": full_tree(0, guarantee=guarantee()),
    **{f"lattice {k}": tree_of(counts, k % 3, 1, k) for k, counts in enumerate(LATTICES)},
}


@pytest.mark.parametrize("name", SOME)
def test_save_and_load_is_equality(name, tmp_path):
    tree = SOME[name]
    tree.save(tmp_path / "p.cap")
    loaded = Policy.load(tmp_path / "p.cap")
    assert_equal(loaded, tree)
    loaded.save(tmp_path / "again.cap")
    assert (tmp_path / "again.cap").read_bytes() == (tmp_path / "p.cap").read_bytes()
    assert content_hash(loaded) == content_hash(tree) == read(tmp_path / "p.cap")[0]["sha256"]
    assert read(tmp_path / "p.cap")[0]["version"] == 2
    states = tree.domain.sample(200)
    assert np.array_equal(loaded(states), tree(states))


def test_cells_are_still_written_as_version_1(tmp_path):
    full().save(tmp_path / "p.cap")
    assert read(tmp_path / "p.cap")[0]["version"] == 1
    rewrite(tmp_path / "p.cap", set_version(2))
    assert type(Policy.load(tmp_path / "p.cap")) is Policy


def test_the_hash_is_that_of_every_field():
    base = full_tree()
    cells, held = base.cells, base.guarantee
    leaf = int(np.flatnonzero(cells.split == -1)[0])
    others = [
        full_tree(name="other"),
        full_tree(guarantee=dataclasses.replace(held, agreeing=8)),
        full_tree(cells=dataclasses.replace(cells, counts=(12, 19))),
        full_tree(cells=dataclasses.replace(cells, planes=cells.planes + np.int32(1))),
        full_tree(
            cells=dataclasses.replace(
                cells, threshold=put(leaf, (cells.threshold[leaf] + 1) % 3)(cells.threshold.copy())
            )
        ),
    ]
    assert len({content_hash(tree) for tree in (base, *others)}) == len(others) + 1


LAST = full_tree().cells.node_count - 1
INNER = int(np.flatnonzero(full_tree().cells.split >= 0)[-1])
TYPE = "must be one-dimensional int32"
SENSE = "the guarantee of a tree does not make sense"
held = "guarantee"
TAMPERED = {
    # arrays
    "unknown axis": (array("split", put(INNER, 99)), "splits an unknown axis"),
    "plane used out of order": (array("split", put(INNER, 3)), "use each plane of the tree once"),
    "axis far off": (array("split", put(INNER, 2**31 - 1)), "splits an unknown axis"),
    "axis below": (array("split", put(LAST, -2)), "splits an unknown axis"),
    "inner end": (array("split", put(LAST, 0)), "."),
    "unknown label": (array("threshold", put(LAST, 3)), "unknown label"),
    "negative label": (array("threshold", put(LAST, -1)), "unknown label"),
    "cycle": (array("second", put(INNER, 0)), "in depth-first order"),
    "itself": (array("second", put(INNER, INNER)), "in depth-first order"),
    "beyond": (array("second", put(0, LAST + 1)), "in depth-first order"),
    "two parents": (array("second", put(0, LAST)), "in depth-first order"),
    "shorter": (array("second", lambda x: x[:-1]), "differ in length"),
    "longer": (array("threshold", lambda x: np.append(x, x[-1:])), "differ in length"),
    "empty": (
        lambda d, a: a.update({k: a[k][:0] for k in ("split", "threshold", "second")}),
        "or are empty",
    ),
    "no planes": (array("planes", lambda x: x[:0]), "unknown axis"),
    "planes of 3": (array("planes", lambda x: np.hstack([x, x[:, :1]])), "2 coefficients"),
    "huge planes": (array("planes", lambda x: x * 0 + np.int32(2**31 - 1)), "beyond 32 bits"),
    # types
    "64 bits": (array("split", lambda x: x.astype(np.int64)), TYPE),
    "unsigned": (array("second", lambda x: x.view(np.uint32)), TYPE),
    "floats": (array("threshold", lambda x: x.astype("f4")), TYPE),
    "8 bits": (array("split", lambda x: x.astype("i1")), TYPE),
    "2-D": (array("split", lambda x: x[None]), TYPE),
    "flat planes": (array("planes", lambda x: x.ravel()), "'planes' must be two-dimensional int32"),
    "3-D planes": (array("planes", lambda x: x[None]), "'planes' must be two-dimensional int32"),
    "planes of floats": (
        array("planes", lambda x: x.astype("f8")),
        "must be two-dimensional int32",
    ),
    "a missing array": (lambda d, a: a.pop("planes"), "does not hold the arrays"),
    "one more array": (lambda d, a: a.update(x=np.zeros(1)), "does not hold the arrays"),
    "arrays of both": (
        lambda d, a: a.update(entries=np.zeros(1, np.int32)),
        "does not hold the arrays",
    ),
    "arrays of cells": (
        lambda d, a: [
            a.clear(),
            a.update(
                entries=np.full(1, -1, np.int32),
                mixed_cells=np.zeros(0, np.int32),
                mixed_labels=np.zeros(0, np.uint64),
            ),
        ],
        "keys are not those",
    ),
    # keys and versions
    "version 1": (set_version(1), "keys are not those of this format version"),
    "newer version": (set_version(VERSION + 1), "upgrade"),
    "one key more": (lambda d, a: d["policy"].update(extra=1), "keys are not those"),
    "gaps too early": (lambda d, a: d["policy"].update(gaps=True), "keys are not those"),
    "keys of cells": (lambda d, a: d["policy"].update(partitions=[3, 2]), "keys are not those"),
    "no counts": (delete("counts"), "keys are not those"),
    "no guarantee": (delete("guarantee"), "keys are not those"),
    "no domain": (delete("domain"), "keys are not those"),
    # counts
    "huge counts": (at("counts")([2**31, 18]), r"`counts\[0\]` must be"),
    "counts past any float": (at("counts")([10**400, 18]), r"`counts\[0\]` must be"),
    "counts that planes forbid": (at("counts")([2**31 - 1] * 2), "beyond 32 bits"),
    "no steps": (at("counts")([0, 18]), r"`counts\[0\]` must be"),
    "negative counts": (at("counts")([12, -18]), r"`counts\[1\]` must be"),
    "broken counts": (at("counts")([12.0, 18]), r"`counts\[0\]` must be"),
    "counts of 3": (at("counts")([12, 18, 1]), "`counts` must be"),
    "counts of text": (at("counts")("12"), "`counts` must be"),
    "counts of nothing": (at("counts")(None), "`counts` must be"),
    "domain too narrow": (at("domain", "upper")([1e-310, 5]), "`max_level` is too high|steps of"),
    # the guarantee
    "guarantee a list": (at(held)([1]), "TypeError"),
    "guarantee a text": (at(held)("exact"), "TypeError"),
    "guarantee of nothing": (at(held)(None), "TypeError"),
    "guarantee empty": (at(held)({}), "TypeError"),
    "guarantee with more": (lambda d, a: d["policy"][held].update(x=1), "TypeError"),
    "guarantee with less": (delete(held, "source"), "TypeError"),
    "mode unknown": (at(held, "mode")("any"), "`mode` must be"),
    "mode a list": (at(held, "mode")(["exact"]), "`mode` must be"),
    "controller unknown": (at(held, "controller")("any"), "`controller` must be"),
    "source of text": (at(held, "source")("\x1b[31m" + "0" * 59), SENSE),
    "source a list": (at(held, "source")(["0"] * 64), SENSE),
    "level negative": (at(held, "level")(-1), SENSE),
    "level huge": (at(held, "level")(10**400), SENSE),
    "level of text": (at(held, "level")("1"), SENSE),
    "changed beyond 1": (at(held, "changed")(1.5), SENSE),
    "changed huge": (at(held, "changed")(10**400), SENSE),
    "changed of nothing": (at(held, "changed")(None), SENSE),
    "states huge": (at(held, "states")(10**400), SENSE),
    "states broken": (at(held, "states")(10.5), SENSE),
    "states true": (at(held, "states")(True), SENSE),
    "more agree": (at(held, "agreeing")(11), SENSE),
    "target beyond 1": (at(held, "target")(2), SENSE),
    # the rest is that of all policies
    "outside no symbol": (at("outside")(2), "`outside` must be"),
    "name with an escape": (at("name")("\x1b[31m"), "`name` must be a printable string"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_tampered_content_with_a_valid_checksum_is_refused(name, file):
    change, message = TAMPERED[name]
    before = file.read_bytes()
    rewrite(file, change)
    assert file.read_bytes() != before
    refuse(file, message)


@pytest.mark.parametrize("value", ["", [], {}, False])
def test_a_target_of_another_kind_is_refused(file, value):
    rewrite(file, at(held, "target")(value))
    refuse(file, SENSE)


def test_a_guarantee_of_states_without_a_controller_is_refused(file):
    rewrite(file, at(held, "controller")(""))
    refuse(file, SENSE)


def test_changes_do_not_match_the_checksum(file):
    before = file.read_bytes()
    for change in (
        at(held, "agreeing")(10),
        at(held, "mode")("exact"),
        at("counts")([12, 19]),
        array("threshold", put(LAST, 0)),
        array("planes", lambda x: x + np.int32(1)),
    ):
        file.write_bytes(before)
        rewrite(file, change, checksum=False)
        assert file.read_bytes() != before
        refuse(file, "content does not match its checksum")


def test_version_1_knows_no_arrays_of_trees(tmp_path):
    path = tmp_path / "p.cap"
    full().save(path)

    def change(document, arrays):
        arrays.clear()
        arrays.update({k: getattr(full_tree().cells, k) for k in ("split", "threshold", "second")})
        arrays["planes"] = np.ascontiguousarray(full_tree().cells.planes)

    rewrite(path, change)
    refuse(path, "keys are not those of this format version")
    full_tree().save(path)
    for version in (1, 0, None, "2", 2.0, True):
        full_tree().save(path)
        rewrite(path, set_version(version))
        refuse(path, "keys are not those|it has no format version")


def test_truncated_files_are_refused(file):
    raw = file.read_bytes()
    for length in sorted({*range(64), *range(64, len(raw), 97), len(raw) - 8, len(raw) - 1}):
        file.write_bytes(raw[:length])
        refuse(file, "is no policy file")
    file.write_bytes(raw + b"\0")
    refuse(file, "is no policy file")


def test_flipped_bytes_are_refused_or_harmless(file):
    raw, wanted, refused = file.read_bytes(), full_tree(), 0
    (size,) = struct.unpack("<Q", raw[:8])
    rng = np.random.default_rng(2)
    places = [*rng.integers(8 + size - 500, len(raw), 300), *rng.integers(0, len(raw), 100)]
    for place, mask in zip(places, rng.integers(1, 256, len(places))):
        damaged = bytearray(raw)
        damaged[place] ^= int(mask)
        file.write_bytes(damaged)
        try:
            loaded = Policy.load(file)
        except PolicyFormatError as error:
            assert "\n" not in str(error)
            refused += 1
        else:
            assert_equal(loaded, wanted)
    assert refused > 385


@pytest.mark.parametrize("name", ["split", "planes"])
@pytest.mark.parametrize(
    ("dtype", "size"), [("BF16", 2), ("F16", 2), ("U8", 1), ("I64", 8), ("F32", 4), ("X9", 8)]
)
def test_other_types_of_arrays_are_refused(file, name, dtype, size):
    with_header(file, resize(name, dtype, size))
    refuse(file, "is no policy file|must be .*-dimensional int32")


def test_trees_that_are_too_deep_are_refused(file):
    depth = 1001

    def change(document, arrays):
        split = np.append(np.tile([0, -1], depth), -1)
        second = np.arange(2 * depth + 1)
        second[:-1:2] += 2
        kinds = {"split": split, "threshold": 0 * split, "second": second}
        arrays.update({k: v.astype(np.int32) for k, v in kinds.items()})

    rewrite(file, change)
    refuse(file, "takes more than 1000 comparisons")


def test_not_a_number_is_no_json_number(file):
    document, arrays = read(file)
    document["policy"][held]["low"] = float("nan")
    save_file(arrays, file, {"capsyn-policy": canonical(document)})
    refuse(file, "is damaged: ValueError")
