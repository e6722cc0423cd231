"""How small decision trees get, beside scikit-learn's, in what time, and how fast they are."""

import json
import resource
import subprocess
import sys
import time

import numpy as np

from capsyn import agreement, compress, problems, synthesize
from capsyn.compression.freedom import exact_prices
from capsyn.compression.induction import induce
from capsyn.compression.proof import changed_cells

STATES = 200_000
CASES = {
    "cart-pendulum": {"level": 4, "linear": 0.99, "nodes": 60, "loss": None},
    "cart-pendulum-4": {"level": 4, "linear": 0.97, "nodes": None, "loss": 1.5},
    "double-tank-a": {"level": 4, "linear": 0.99, "nodes": None, "loss": 1.5},
    "double-tank-b": {"level": 4, "linear": 0.99, "nodes": None, "loss": 1.5},
    "cart-pole": {"level": 3, "linear": 0.999, "nodes": 300, "loss": None},
}
"""Levels of the policies, agreements asked of linear trees, most nodes of these, and most points
of agreement that freedom may lose."""


def cart_nodes(policy):
    """Return the nodes of scikit-learn's tree, fitted to the centres of all finest cells."""
    from sklearn.tree import DecisionTreeClassifier

    counts = policy.cells.counts
    steps = np.stack(np.unravel_index(np.arange(np.prod(counts)), counts), axis=1)
    centres = policy.domain.points(2 * steps + 1, tuple(2 * count for count in counts))
    tree = DecisionTreeClassifier(random_state=0).fit(centres, policy.cells.labels(steps))
    return tree.tree_.node_count


def lookup_speed(tree):
    """Return the million states per second that a tree looks up, compiled, on one core."""
    states = tree.domain.sample(1_000_000, 0)
    seconds = []
    for _ in range(7):
        started = time.perf_counter()
        tree(states, backend="c")
        seconds.append(time.perf_counter() - started)
    return 1 / float(np.median(seconds))


def measure(name):
    """Return the rows of one policy; its memory is that of this process."""
    case = CASES[name]
    policy = synthesize(problems.plain(name), max_level=case["level"])
    own = agreement(policy, STATES, seed=7).share
    rows = []

    def row(what, value, unit="", wanted=""):
        what = f"{name} level {case['level']}: {what}"
        rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})

    trees = {}
    for mode in ("exact", "freedom", "linear"):
        started = time.perf_counter()
        options = {"agreement": case["linear"]} if mode == "linear" else {}
        trees[mode] = compress(policy, mode, **options)
        row(f"seconds, {mode}", time.perf_counter() - started, "s", "<= 30")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    row("peak memory of the process", memory, "MB", "<= 1024")
    cart = cart_nodes(policy)
    row("nodes, scikit-learn CART", cart)
    for mode, share in (("exact", 0.95), ("freedom", 0.6)):
        nodes = trees[mode].node_count
        row(f"nodes, {mode}", nodes)
        small = cart < 10  # nothing to save
        row(f"nodes, {mode}, over CART's", nodes / cart, "ratio", "" if small else f"<= {share}")
    if policy.domain.n == 2:  # the whole domain by dynamic programming
        fewest = induce(policy.cells, exact_prices(policy), budget=10**9).node_count
        row("nodes, fewest of all exact trees", fewest)
    row("nodes, linear", trees["linear"].node_count, "", case["nodes"] and f"<= {case['nodes']}")
    states = policy.domain.sample(1_000_000, 8)
    different = int(np.count_nonzero(trees["exact"](states) != policy(states)))
    changed = int(np.count_nonzero(changed_cells(trees["exact"].cells, policy.cells)))
    row("cells where exact differs", changed, "", "<= 0")
    row("of a million random states, where exact differs", different, "", "<= 0")
    row("agreement with sSAC, the policy", 100 * own, "%")
    for mode in ("freedom", "linear"):
        share = agreement(trees[mode], STATES, seed=7).share
        least = 100 * case["linear"] if mode == "linear" else None
        if mode == "freedom":
            least = 98 if case["loss"] is None and name == "cart-pendulum" else None
            least = 100 * own - case["loss"] if case["loss"] else least
        row(f"agreement with sSAC, {mode}", 100 * share, "%", least and f">= {least:.4g}")
    for mode, tree in trees.items():
        row(f"tree lookup, {mode}, c, 1 core", lookup_speed(tree), "million states/s", ">= 20")
    return rows


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(measure(sys.argv[1])))
    else:
        found = []
        for case in CASES:
            command = [sys.executable, __file__, case]
            run = subprocess.run(command, capture_output=True, text=True, check=True)
            found += json.loads(run.stdout.splitlines()[-1])
        print(json.dumps(found))
