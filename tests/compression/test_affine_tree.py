"""Policies with affine leaves elsewhere: trees, exports, evidence, plots, the command line."""

import dataclasses
import json

import matplotlib.pyplot as plt
import numpy as np
import pytest

from capsyn import (
    Automaton,
    Ball,
    Policy,
    agreement,
    compress,
    lyapunov,
    monte_carlo,
    problems,
    simulate,
    synthesize,
)
from capsyn.cells.packing import packed_bytes
from capsyn.compression.complexity import complexity
from capsyn.compression.curve import size_curve
from capsyn.compression.proof import prove
from capsyn.errors import ProblemError
from capsyn.exports.export import TARGETS, all_targets
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.plots.policy import plot_policy
from capsyn.policies.report import report
from support.exports.c_machines import Library
from support.exports.c_plans import assert_golden, files
from support.exports.policies import made_by, module
from support.processes.command_line import capsyn, error_of
from support.trees import GRIDS, random_affine_policy


@pytest.fixture(scope="module")
def pendulum():
    return synthesize(problems.plain("cart-pendulum"), leaves="affine", max_level=3)


@pytest.mark.parametrize("grid", range(len(GRIDS)))
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("some_axes", [False, True])
def test_the_exact_tree_is_the_policy_at_every_lattice_step(grid, seed, some_axes):
    policy = random_affine_policy(grid, seed=seed, some_axes=some_axes)
    tree = compress(policy)
    counts = policy.cells.counts
    total = int(np.prod(counts))
    places = np.arange(total) if total < 200_000 else np.random.default_rng(seed).integers(
        0, total, 200_000
    )  # fmt: skip
    steps = np.stack(np.unravel_index(places, counts), axis=1)
    assert np.array_equal(tree.cells.labels(steps), policy.cells.labels(steps))
    assert tree.guarantee.mode == "exact" and tree.guarantee.changed == 0.0
    assert prove(tree, policy) == 0.0


def test_a_tree_with_another_plane_is_no_proof(pendulum):
    tree = compress(pendulum)
    threshold = tree.cells.threshold.copy()
    place = int(np.flatnonzero(tree.cells.split >= 2)[3])
    threshold[place] += 1
    other = dataclasses.replace(tree, cells=dataclasses.replace(tree.cells, threshold=threshold))
    with pytest.raises(ProblemError, match="does not keep its word"):
        prove(other, pendulum)


def test_trees_of_several_symbols_are_compiled_alike():
    policy = synthesize(problems.plain("spacecraft"), leaves="affine", max_level=0)
    tree = compress(policy)
    states = policy.domain.sample(100_000, 2)
    found = policy(states, backend="c")
    assert len(np.unique(found)) >= 6
    for other in (policy, tree):
        for backend in ("c", "numpy"):
            assert np.array_equal(other(states, backend=backend), found)


def test_an_export_gives_the_same_symbols(pendulum, tmp_path):
    made = module(made_by(pendulum, "python", tmp_path))
    states = pendulum.domain.sample(2000, 4)
    found = [made.decide(state)[0] for state in states.tolist()]
    assert np.array_equal(np.where(np.array(found) == 2, -1, found), pendulum(states))


@pytest.mark.parametrize(("name", "level"), [("cart-pendulum", 3), ("planar-quadrotor", 0)])
def test_exported_c_gives_the_same_symbols_without_overflow(name, level, tmp_path):
    plan = Plan.of(synthesize(problems.plain(name), leaves="affine", max_level=level))
    golden = golden_vectors(plan)
    options = ["-O1", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover"]
    for style in ("cells", "table"):
        library = Library(
            files(plan, golden, style=style), tmp_path / style, plan.n, "gcc", options
        )
        assert_golden(library, golden, True)


def test_what_a_policy_of_affine_leaves_cannot_do_is_one_line(pendulum):
    for work, message in (
        (lambda: compress(pendulum, "freedom"), "modes exact and linear"),
        (lambda: compress(pendulum, level=1), "modes exact and linear"),
        (lambda: size_curve(pendulum, states=1000), "has affine leaves"),
        (lambda: Automaton.of(pendulum), "has affine leaves"),
        (lambda: lyapunov(pendulum, lambda x: x[1] ** 2), "leaves='constant'"),
    ):
        with pytest.raises(ProblemError, match=message) as caught:
            work()
        assert "\n" not in str(caught.value)


def test_evidence_and_loops(pendulum):
    states = pendulum.domain.sample(3, 5)
    found = agreement(pendulum, states=20_000)
    assert found.share > 0.995 and found.islands
    for island in found.islands:  # a disagreeing state of the island, with the policy's symbol
        assert island.symbol == pendulum(island.example)
    for state in states:
        loops = [
            simulate(pendulum, state, duration=1.0, rate=500.0, outside="nearest", backend=backend)
            for backend in ("c", "numpy")
        ]
        assert np.array_equal(loops[0].symbols, loops[1].symbols)
    trials = monte_carlo(pendulum, 50, duration=10.0, rate=500.0)
    assert trials.success.mean() > 0.9
    linear = compress(pendulum, "linear", agreement=0.9, states=5000)
    assert linear.guarantee.agreement > 0.9


def test_reports_and_plots(pendulum):
    data = report(pendulum)
    assert data["max_level"] == 3 and data["affine_leaves"] == len(pendulum.cells.affine) > 0
    assert data["cells"] == pendulum.statistics["cells"]
    rows = sum(table.nbytes for table in pendulum.cells.affine.arrays().values())
    assert data["table_bytes"] == pendulum.cells.entries.nbytes + rows
    assert packed_bytes(pendulum.cells) < data["table_bytes"]
    assert np.isclose(sum(symbol["volume_share"] for symbol in data["symbols"]), 1.0)
    assert abs(pendulum.volume_shares[0] - 0.5) < 0.01
    sizes = complexity(pendulum)
    assert sizes["tree"]["planes"] > 0 and sizes["table"]["comparisons"] > 0
    fig, ax = plt.subplots()
    plot_policy(pendulum, ax=ax)
    (image,) = ax.images
    assert len(np.unique(image.get_array().reshape(-1, 3), axis=0)) == 2
    plt.close(fig)


def test_command_line(tmp_path):
    path = tmp_path / "pole.cap"
    out, _ = capsyn(
        "synth", "cart-pole", "--leaves", "affine", "--max-level", 3, "--max-solves", 3000,
        "-o", path, "--json",
    )  # fmt: skip
    data = json.loads(out)
    assert data["statistics"]["solves"] <= 3000 and data["statistics"]["leaves"] == "affine"
    policy = Policy.load(path)
    assert data["affine_leaves"] == len(policy.cells.affine)
    shown, _ = capsyn("info", path)
    assert f"{data['affine_leaves']:,} of the cells" in shown
    symbol = json.loads(capsyn("query", path, 0.1, 0.2, 0.3, 0.4, "--json")[0])
    assert symbol["symbol"] == policy([0.1, 0.2, 0.3, 0.4])
    line = error_of("synth", "cart-pole", "--leaves", "linear", "-o", path)
    assert "`leaves` must be one of 'constant', 'affine'" in line
    line = error_of("compress", path, "--mode", "freedom", "-o", tmp_path / "t.cap")
    assert "affine leaves" in line
    capsyn("export", path, "--to", "c", "-o", tmp_path / "c")
    assert (tmp_path / "c" / "golden.csv").exists()


def test_wrong_test_points_of_affine_leaves_are_no_coarse_boundaries():
    policy = synthesize(problems.plain("spacecraft"), leaves="affine", max_level=0)
    assert policy.mixed_share > 0.9
    assert not [hint for hint in report(policy)["hints"] if "coarse" in hint]


def test_targets_travel_with_the_problems():
    for name in ("planar-quadrotor", "spacecraft"):
        policy = synthesize(problems.plain(name), leaves="affine", max_level=0)
        assert isinstance(policy.target, Ball) and policy.outside == "nearest"


def test_all_targets_but_dot():
    policy = synthesize(problems.plain("cart-pendulum"), leaves="affine", max_level=2)
    assert set(TARGETS) - set(all_targets(policy)) == {"dot"}
