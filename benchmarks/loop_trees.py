"""Small trees judged by closed loops, beside trees of the same size judged by agreement."""

import json
import time
import warnings

import numpy as np

import capsyn
import inverter
import tails
from capsyn import problems
from capsyn.compression.looped.by_loop import trial_options
from capsyn.compression.looped.choice import JUDGING
from capsyn.compression.looped.loops import Loops
from capsyn.improvement.judged import Comparison
from capsyn.policies.guarantee import cost_ratio
from capsyn.problems.docking import has_arrived

TANKS = capsyn.Box([0.1, 0.1], [0.9, 0.9], names=["x1", "x2"])
CASES = {
    "cart-pendulum": {"duration": 8, "rate": 100},
    "cart-pendulum-4": {"duration": 8, "rate": 100},
    "double-tank-a": {"duration": 6, "rate": 50, "initial": TANKS},
    "double-tank-b": {"duration": 6, "rate": 50, "initial": TANKS},
    "inverter": {"duration": 0.01, "rate": 20_000},
}
"""Closed loops of problems without prices, but of the inverter."""
TARGETS = (0.8, 0.95)
"""Agreements asked of trees of mode linear; of the inverter the first."""
rows = []


def row(what, value, unit="", wanted=""):
    value = value if isinstance(value, int) else float(value)
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def docking():
    """Add rows of a satellite with 9 symbols, whose volume hardly has the one that it coasts by."""
    problem = tails.nine_symbols().replace(tail="riccati", horizon=None)
    policy = capsyn.synthesize(problem, max_solves=60_000)
    share = np.array([0.9, 0.9, 0.9, 0.2, 0.2, 0.2])
    domain = policy.domain
    near = capsyn.Box(domain.lower * share, domain.upper * share, names=domain.names)
    fresh = tails.starts(policy, share)

    def told(what, each, own=None):
        good, fuel = tails.loops(each, fresh, 60, 10, tails.docked)
        nodes = each.cells.node_count
        row(f"{what}: {'cells' if own is None else 'nodes'}", nodes, "", "<= 150" if own else "")
        wanted = f">= {90 * own[0]:.4g}" if own else ""
        row(f"{what}: success of 1,000 loops", 100 * good.mean(), "%", wanted)
        wanted = f"<= {1.1 * own[1]:.4g}" if own else ""
        row(f"{what}: mean fuel", fuel.mean(), "N s", wanted)
        return good.mean(), fuel.mean()

    own = told("docking, the policy", policy)
    loop = {"duration": 60, "rate": 10, "initial": near, "target": lambda x: has_arrived(x, [0])}
    for what, budget in (("at most 150 nodes", {"nodes": 150}), ("as small as may be", {})):
        began = time.process_time()
        tree = capsyn.compress(policy, judge="loop", **budget, **loop)
        row(f"docking, judged by loops, {what}: processor time", time.process_time() - began, "s")
        told(f"docking, judged by loops, {what}", tree, own)
        row(f"docking, {what}: agreement by volume", 100 * tree.guarantee.agreement, "%")
        seen = tree.guarantee.loop.agreement
        row(f"docking, {what}: agreement where its loops go", 100 * seen, "%")
    for target in (0.93, 0.97):
        tree = capsyn.compress(policy, "linear", agreement=target)
        good, fuel = tails.loops(tree, fresh, 60, 10, tails.docked)
        what = f"docking, judged by agreement, {target:.0%}"
        row(f"{what}: nodes", tree.node_count)
        row(f"{what}: success of 1,000 loops", 100 * good.mean(), "%")
        row(f"{what}: mean fuel", fuel.mean(), "N s")


def figures(loops, own, tree):
    """Return success and mean cost over the policy's of trials that judge a tree."""
    outcome = loops.outcome(tree, JUDGING)
    found = Comparison.of(own.costs, outcome.costs, 0.95)
    return 100 * outcome.success.mean(), cost_ratio(found.before, found.after)


def compare(name):
    """Add rows of the trees of one problem, by agreement and by loops, of the same sizes."""
    problem = problems.plain(name)
    if name == "inverter":  # in errors of a current of 10 A, with its price
        problem = inverter.of_errors(problems.get(name), inverter.W[1], partitions=(1, 1, 12))
    policy, loop = capsyn.synthesize(problem), CASES[name]
    loops = Loops.of(policy, trial_options(policy, 0, "auto", loop))
    own = loops.outcome(policy, JUDGING)
    row(f"{name}, the policy: success", 100 * own.success.mean(), "%")
    sizes = set()
    for target in TARGETS[:1] if name == "inverter" else TARGETS:
        tree = capsyn.compress(policy, "linear", agreement=target)
        if tree.node_count in sizes:
            continue
        sizes.add(tree.node_count)
        by_loop = capsyn.compress(policy, judge="loop", nodes=tree.node_count, **loop)
        for how, one in (("agreement", tree), ("loops", by_loop)):
            success, ratio = figures(loops, own, one)
            what = f"{name}, at most {tree.node_count} nodes, judged by {how}"
            row(f"{what}: cost over the policy's", ratio, f"({one.node_count} nodes)")
            row(f"{what}: success", success, "%")
    smallest = capsyn.compress(policy, judge="loop", **loop)
    success, ratio = figures(loops, own, smallest)
    row(f"{name}, as small as may be, judged by loops: nodes", smallest.node_count)
    row(f"{name}, as small as may be, judged by loops: cost over the policy's", ratio)


def beside_agreement():
    """Add rows of what the trees of the guide's table do in closed loop, beside their policies."""
    levels = {name: (4, CASES[name]) for name in CASES if name != "inverter"}
    levels["cart-pole"] = 3, {"duration": 10, "rate": 1000, "hold": 10}
    targets = {"cart-pendulum-4": 0.97, "cart-pole": 0.999}
    for name, (level, loop) in levels.items():
        policy = capsyn.synthesize(problems.plain(name), max_level=level)
        if name == "cart-pole":  # up, from within 5 % of the domain, for all of the time
            up = capsyn.Box([-0.6], [0.6], names=["theta"])
            near = policy.domain.lower / 20, policy.domain.upper / 20
            near = capsyn.Box(*near, names=policy.domain.names)
            loop = loop | {"target": up, "initial": near}
        loops = Loops.of(policy, trial_options(policy, 0, "auto", loop | {"trials": 1000}))
        own = loops.outcome(policy, JUDGING)
        row(f"table, {name}, policy: success", 100 * own.success.mean(), "%")
        for mode in ("exact", "freedom", "linear"):
            options = {"agreement": targets.get(name, 0.99)} if mode == "linear" else {}
            tree = capsyn.compress(policy, mode, **options)
            success, ratio = figures(loops, own, tree)
            row(f"table, {name}, {mode}: success", success, f"% ({tree.node_count} nodes)")
            row(f"table, {name}, {mode}: cost over the policy's", ratio)


if __name__ == "__main__":
    warnings.simplefilter("ignore", capsyn.errors.CapsynWarning)
    docking()
    for case in CASES:
        compare(case)
    beside_agreement()
    print(json.dumps(rows))
