"""Controllers beside sSAC: how fast and how small tables, predictive control and episodes are.

The tables are static controllers of SCOTS in the directory that the environment variable
``CAPSYN_TABLES`` names; without it their rows are left out.
"""

import json
import os
import time
from pathlib import Path

import numpy as np

import capsyn
from capsyn import Alphabet, problems
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.target import TARGET
from capsyn.exports.golden import decide, golden_vectors
from capsyn.exports.plan import OUTSIDE, Plan
from capsyn.sources.finite_control_set import finite_control_set
from capsyn.sources.scots import read_scots

ROUNDS = 5
rows = []


def row(what, value, unit="", wanted=""):
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def seconds_of(work, rounds=ROUNDS):
    """Return the median time of some work, and what it gave last."""
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        found = work()
        times.append(time.perf_counter() - started)
    return float(np.median(times)), found


def wrong_points(policy, points, symbols):
    """Return at how many points a policy is not its table, gaps among them."""
    inside = policy.covers(points)
    found = np.where(inside, policy(points, outside=-1), -1)
    return int(np.count_nonzero(found != symbols))


def cart_nodes(points, symbols):
    """Return the nodes of scikit-learn's tree of a table, with outside as a class."""
    from sklearn.tree import DecisionTreeClassifier

    return int(DecisionTreeClassifier(random_state=0).fit(points, symbols).tree_.node_count)


def measure_table(path):
    size = path.stat().st_size
    seconds, policy = seconds_of(lambda: read_scots(path).policy(path.stem))
    table = read_scots(path)
    points, symbols = table.points(), table.symbols.ravel()
    name = path.name
    row(f"{name}: winning states", int(np.count_nonzero(symbols >= 0)))
    row(f"{name}: import", seconds, "s", "<= 1.5")
    row(f"{name}: grid points where the policy is not the table", wrong_points(
        policy, points, symbols), "", "<= 0")  # fmt: skip
    seconds, tree = seconds_of(lambda: capsyn.compress(policy), 1)
    row(f"{name}: grid points where the exact tree is not the table", wrong_points(
        tree, points, symbols), "", "<= 0")  # fmt: skip
    cart = cart_nodes(points, symbols)
    row(f"{name}: exact tree", tree.node_count, f"nodes in {seconds:.1f} s", f"<= {cart}")
    row(f"{name}: scikit-learn CART, outside a class", cart, "nodes")
    plan = Plan.of(tree)
    golden = golden_vectors(plan)
    made = TARGET.files(plan, golden).files
    flash = sizes(made, path.stem).get("host")
    if flash:
        share = 100 * (flash["decision"] + flash["quantiser"]) / size
        row(f"{name}: C export, compiled, of the file's bytes", share, "%", "<= 10")
    row(f"{name}: C export, source text, of the file's bytes", 100 * len(
        made[f"{path.stem}.c"]) / size, "%")  # fmt: skip
    statuses = decide(plan, points[symbols < 0]).statuses
    row(f"{name}: states without a symbol and without status OUTSIDE", int(
        np.count_nonzero(statuses != OUTSIDE)), "", "<= 0")  # fmt: skip


def measure_prediction():
    problem = problems.plain("cart-pendulum").replace(alphabet=Alphabet([-5.0, 0.0, 5.0]))
    states = problem.domain.sample(200_000, 1)
    for blocks, wanted in ((1, ">= 200000"), (2, "")):
        control = finite_control_set(problem, 5, sample_time=0.05, blocks=blocks)
        control(states[:64])
        seconds, _ = seconds_of(lambda control=control: control(states))
        what = f"predictive control, depth 5, 3 symbols, 2-D, {blocks} step(s) a move"
        row(what, int(len(states) / seconds), "states/s", wanted)


def measure_episodes():
    from gymnasium.utils.env_checker import check_env

    from capsyn.integrations.gymnasium import environment, evaluate

    passed = 0
    for name in problems.names():
        check_env(environment(problems.plain(name)), skip_render_check=True)
        passed += 1
    row(
        "built-in problems that pass Gymnasium's checker", passed, "", f">= {len(problems.names())}"
    )
    problem = problems.plain("cart-pole").replace(horizon=1.5, outside="nearest")
    tree = capsyn.compress(capsyn.synthesize(problem, max_level=2), "linear", agreement=0.99)
    mirrored = {"observation": lambda o: [-o[0], -o[1], o[2], o[3]], "actions": [1, 0]}
    seconds, found = seconds_of(lambda: evaluate(tree, "CartPole-v1", 100, **mirrored), 1)
    row("100 episodes of CartPole-v1, a 4-D policy", seconds, "s", "<= 10")
    row("steps of these", int(found.lengths.sum()))
    row("mean return of these, of 500", found.mean)


if __name__ == "__main__":
    directory = os.environ.get("CAPSYN_TABLES")
    for path in sorted(Path(directory).glob("*.scs")) if directory else []:
        measure_table(path)
    measure_prediction()
    measure_episodes()
    print(json.dumps(rows))
