"""Trees that closed loops judge: what they guarantee, within which budget, and what is refused."""

import dataclasses
import re

import numpy as np
import pytest

import capsyn
from capsyn.compression import curve
from capsyn.compression.fitted.plane_tree import Node
from capsyn.compression.fitted.surface import Samples
from capsyn.compression.looped.choice import JUDGING
from capsyn.compression.looped.growing import growing, pruning
from capsyn.compression.looped.loops import LOOPS, Loops
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.plots.curve import save_curve_plot
from capsyn.policies.guarantee import Guarantee, LoopFigures
from capsyn.policies.report import report
from capsyn.random_streams import derived_seed
from capsyn.verification.trials import TrialOptions

# small grids and budgets lose symbols, which is told: see test_lost.py
pytestmark = pytest.mark.filterwarnings("ignore:the tree gives some symbols")
NEAR = capsyn.Box([-1, -1], [1, 1], names=["x", "v"])
LOOP = {"duration": 6.0, "rate": 10, "trials": 40, "states": 2000, "initial": NEAR}


def point(**changes):
    """Return the problem of bringing a point to rest, that forward, backward or nothing pushes."""
    known = {
        "name": "point",
        "dynamics": lambda x, u: [x[1], u[0]],
        "domain": capsyn.Box([-2, -2], [2, 2], names=["x", "v"]),
        "alphabet": [-1, 0, 1],
        "default": 0,
        "horizon": 1.0,
        "running_cost": lambda x: x[0] ** 2 + x[1] ** 2,
        "settings": capsyn.SsacSettings(steps=10, control_weight=0.05),
        "outside": "nearest",
        "target": capsyn.Ball([0, 0], 0.3),
        "partitions": 6,
        "max_level": 2,
    }
    return capsyn.Problem(**known | changes)


@pytest.fixture(scope="module")
def policy():
    return capsyn.synthesize(point())


@pytest.fixture(scope="module")
def tree(policy):
    return capsyn.compress(policy, judge="loop", nodes=15, **LOOP)


def test_a_tree_whose_loops_are_lost_is_not_near_its_policy(tree):
    figures = tree.guarantee.loop
    assert figures.near and figures.lost == figures.own_lost == 0
    assert not dataclasses.replace(figures, lost=5).near
    assert dataclasses.replace(figures, lost=5, own_lost=1).near
    for changes in ({"rate": 0.0}, {"duration": -1.0}, {"size": -1}, {"measure": "a\nb"}):
        with pytest.raises(ProblemError, match="do not make sense"):
            dataclasses.replace(figures, **changes)


def test_a_small_tree_does_what_its_policy_does(policy, tree):
    figures = tree.guarantee.loop
    assert tree.node_count == figures.size <= figures.limit == 15
    assert tree.guarantee.reached and tree.guarantee.mode == "linear"
    assert figures.successes >= figures.own_successes - 1 and figures.own_successes >= 38
    assert figures.ratio < 1.05 and figures.low < figures.cost - figures.own_cost < figures.high
    assert figures.trials == 40 and figures.lost == figures.own_lost == 0
    assert 0.5 < figures.agreement <= 1 and figures.measure == "nodes"


def test_its_successes_are_those_of_fresh_trials(policy, tree):
    trials = {key: value for key, value in LOOP.items() if key not in ("states", "trials")}
    seed = derived_seed(0, LOOPS, JUDGING)
    for controller, count in (
        (tree, tree.guarantee.loop.successes),
        (policy, tree.guarantee.loop.own_successes),
    ):
        assert capsyn.monte_carlo(controller, 40, seed=seed, **trials).success.sum() == count


def test_costs_are_the_running_cost_and_effort_times_a_scale(policy):
    options = TrialOptions.of(duration=3.0, rate=20, trials=5, initial=NEAR, seed=1)
    loops = dataclasses.replace(Loops.of(policy, options), scale=2.0, tests={})
    outcome, test = loops.outcome(policy, 5), loops.tests[5][0]
    run = capsyn.simulate(
        policy, test.drawn.initial, 3.0, rate=20, target=policy.target, stop_at_target=True
    )
    ends = np.take_along_axis(run.costs, run.last[:, None], axis=1)[:, 0]
    effort = np.nansum(run.controls[..., 0] ** 2, axis=1) * 0.05 / 20
    np.testing.assert_allclose(outcome.costs, ends + 2 * effort, rtol=1e-9)
    switches = sum(run.switches) / (run.last.sum() / 20)
    assert outcome.switches == pytest.approx(switches)


def test_visits_are_states_of_the_loops_with_what_was_in_force(policy):
    options = TrialOptions.of(duration=2.0, rate=10, trials=3, initial=NEAR, seed=1)
    loops = Loops(policy, options, 1.0)
    visits, test = loops.visits(policy, 4, 10**6), loops.tests[4][0]
    run = capsyn.simulate(
        policy, test.drawn.initial, 2.0, rate=10, target=policy.target, stop_at_target=True
    )
    known = {
        tuple(np.round(state, 9)): before
        for states, symbols, last in zip(run.states, run.symbols, run.last)
        for state, before in zip(states[:last], [-1, *symbols])
    }
    assert len(visits.states) == run.last.sum() == len(known)
    for state, before in zip(visits.states, visits.in_force):
        assert known[tuple(np.round(state, 9))] % 4 == before


def test_the_same_seed_gives_the_same_tree_whatever_the_threads(policy, tree):
    again = capsyn.compress(policy, judge="loop", nodes=15, threads=1, **LOOP)
    assert again.cells == tree.cells or np.array_equal(again.cells.threshold, tree.cells.threshold)
    assert again.guarantee == tree.guarantee


def test_the_file_and_the_report_say_what_loops_did(tree, tmp_path):
    tree.save(tmp_path / "tree.cap")
    kept = capsyn.Policy.load(tmp_path / "tree.cap").guarantee
    assert kept == tree.guarantee and isinstance(kept.loop, LoopFigures)
    told = report(tree)["guarantee"]
    assert told["loop"]["successes"] == tree.guarantee.loop.successes and told["reached"]
    for words in ("of 40 closed loops", "the policy in", "mean cost", "that its loops visit"):
        assert words in told["text"]


def test_what_volume_judges_says_nothing_of_loops(policy):
    plain = capsyn.compress(policy, "exact").guarantee.to_json()
    assert "loop" not in plain and Guarantee.from_json(plain).loop is None


@pytest.mark.parametrize("change", [{"cost": float("nan")}, {"successes": 50}, {"trials": 0}])
def test_figures_that_make_no_sense_are_refused(tree, change):
    plain = tree.guarantee.to_json()
    with pytest.raises(ProblemError, match="do not make sense"):
        Guarantee.from_json(plain | {"loop": plain["loop"] | change})


def test_without_a_budget_it_is_the_smallest_that_is_near_its_policy(policy):
    small = capsyn.compress(policy, judge="loop", **LOOP)
    assert small.guarantee.reached and small.guarantee.loop.limit is None
    assert small.node_count <= 11


def test_bytes_are_those_of_a_measure(policy, tree):
    seen = []

    def size(one):
        seen.append(one.node_count)
        return 100 + 10 * one.node_count

    found = capsyn.compress(policy, judge="loop", bytes=200, size=size, **LOOP)
    assert found.node_count <= 10 and found.guarantee.loop.size == 100 + 10 * found.node_count
    assert len(seen) < 25, "bisection measures few trees"
    packed = capsyn.compress(policy, judge="loop", bytes=60, **LOOP)
    assert packed.guarantee.loop.measure == "bytes packed"
    assert packed.guarantee.loop.size == report(packed)["packed_bytes"] <= 60


@pytest.mark.parametrize(
    ("budget", "words"),
    [
        ({"bytes": 1}, "no tree of at most 1 bytes packed was found: the smallest takes "),
        ({"nodes": 1}, "the best tree, of 1 nodes, loses more than 10% against the policy: it "),
    ],
)
def test_what_no_tree_meets_is_told_in_one_line(policy, budget, words):
    with pytest.warns(CapsynWarning, match=re.escape(words)) as caught:
        found = capsyn.compress(policy, judge="loop", **budget, **LOOP)
    assert not found.guarantee.reached
    assert all("\n" not in str(one.message) for one in caught)


def test_trees_of_mode_freedom_are_judged_too_and_proved(policy):
    free = capsyn.compress(policy, "freedom", judge="loop", nodes=200, **LOOP)
    assert free.guarantee.mode == "freedom" and free.guarantee.loop.fits
    assert capsyn.compression.proof.prove(free, policy) == free.guarantee.changed


def test_of_a_policy_that_remembers_what_follows_the_label_in_force_counts():
    problem = point(switching=capsyn.Switching("5%", hold=0.1))
    policy = capsyn.synthesize(problem)
    assert policy.remembers
    found = capsyn.compress(policy, judge="loop", nodes=31, **LOOP)
    figures = found.guarantee.loop
    assert found.guarantee.reached and found.node_count <= 31
    assert figures.switches <= 1.5 * figures.own_switches


def test_exogenous_inputs_are_told_to_trees():
    problem = point(
        running_cost=lambda x, w: (x[0] - w[0]) ** 2 + x[1] ** 2,
        exogenous=capsyn.Box([-0.5], [0.5], names=["goal"]),
        dynamics=lambda x, u, w: [x[1], u[0]],
        target=None,
        max_level=1,
    )
    policy = capsyn.synthesize(problem)
    found = capsyn.compress(
        policy, judge="loop", nodes=11, exogenous={"goal": 0.4}, **LOOP | {"trials": 20}
    )
    assert found.exogenous is not None and not found.guarantee.loop.target
    assert found.guarantee.loop.ratio < 1.1


@pytest.mark.parametrize(
    ("mode", "options", "message"),
    [
        ("exact", {"judge": "loop"}, "`mode` must be linear or freedom with judge 'loop'; got 'e"),
        (None, {"judge": "jury"}, "`judge` must be one of 'volume', 'loop'; got 'jury'"),
        (None, {"nodes": 9}, "`nodes` is for judge 'loop' only; got 9"),
        (None, {"duration": 9}, "`duration` is for judge 'loop' only; got 9"),
        ("linear", {"judge": "loop", "agreement": 0.9}, "`agreement` is not for judge 'loop'"),
        (None, {"judge": "loop", "features": {"e": lambda x: x[0]}}, "`features` is not for judge"),
        (None, {"judge": "loop", "nodes": 0}, "`nodes` must be a whole number >= 1; got 0"),
        (None, {"judge": "loop", "nodes": 9, "bytes": 9}, "`nodes` and `bytes` exclude each other"),
        (None, {"judge": "loop", "size": len}, "`size` needs `bytes`"),
        (None, {"judge": "loop", "bytes": 9, "size": 1}, "`size` must be a function of a tree"),
        (None, {"judge": "loop", "time": 9}, "there is no argument `time` of closed loops"),
        (None, {"judge": "loop", "executor": 1}, "there is no argument `executor` of closed loops"),
        (
            None,
            {"judge": "loop", "duration": 0.05, "within": 0.001, "trials": 9},
            "`policy` itself succeeds in none of 9 cl",
        ),
    ],
)
def test_refusals(policy, mode, options, message):
    with pytest.raises(ProblemError) as caught:
        capsyn.compress(policy, mode, **options)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_a_policy_without_a_model_needs_one(policy):
    bare = dataclasses.replace(policy, model=None)
    with pytest.raises(ProblemError, match="`model` must be a Problem") as caught:
        capsyn.compress(bare, judge="loop", rate=20)
    assert "\n" not in str(caught.value)
    options = LOOP | {"model": point(), "states": 500}
    found = capsyn.compress(bare, judge="loop", nodes=15, **options)
    assert found.guarantee.controller == "policy" and found.guarantee.loop.ratio < 1.2


def test_a_curve_says_what_loops_do_of_all_kinds_of_controllers(policy, tmp_path, monkeypatch):
    monkeypatch.setattr(curve, "TARGETS", (0.9,))
    monkeypatch.setattr(curve, "LOOP_NODES", (3, 9))
    points = curve.size_curve(policy, judge="loop", **LOOP)
    assert {point.mode for point in points} == {"cells", "exact", "freedom", "linear", "loop"}
    own = [point for point in points if point.mode == "cells"][-1]
    exact = [point for point in points if point.options == "--mode exact"][0]
    assert own.cost_ratio == exact.cost_ratio == 1 and own.success == exact.success >= 0.95
    assert own.visited == exact.visited > 0.5 and own.switches == exact.switches > 0
    best = sorted((point for point in points if point.smallest), key=lambda point: point.nodes)
    scores = [curve.score_of(point) for point in best]
    assert scores == sorted(scores)
    by_loop = [point for point in points if point.mode == "loop"]
    assert by_loop[-1].nodes <= 9 and by_loop[-1].cost_ratio < 1.1
    save_curve_plot(points, "point", tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")


def test_without_loops_a_curve_takes_none_of_their_options(policy):
    with pytest.raises(ProblemError, match="`rate` is for judge 'loop' only"):
        curve.size_curve(policy, rate=20)


def halves():
    """Return samples with three labels: beyond a slanted line, and a strip along an axis."""
    states = np.random.default_rng(1).random((4000, 2))
    slanted = states[:, 0] + 0.5 * states[:, 1] > 0.8
    labels = np.where(states[:, 1] > 0.9, 2, slanted)
    return Samples(states, labels[:, None] == np.arange(3))


def test_trees_grow_to_what_parts_the_samples_and_shrink_again():
    samples = halves()
    grown = [(root.copy(), root.node_count) for root in growing(Node(0), samples, 30)]
    sizes = [count for _, count in grown]
    assert sizes == sorted(sizes) and sizes[0] == 1
    root = grown[-1][0]
    assert samples.count_right(root.labels(samples.states)) >= 0.995 * len(samples)
    shrunk = [one.node_count for one in pruning(root, samples)]
    assert shrunk == sorted(set(shrunk), reverse=True) and shrunk[-1] == 1
