"""What telling a controller its setpoint and its disturbances brings, and what it costs."""

import json
import runpy
from pathlib import Path

import numpy as np

import capsyn
from capsyn import problems

EXAMPLES = Path(__file__).parents[1] / "examples"
MIDDLE = {"setpoint": 22.5, "outdoor": 32.0}
rows = []


def row(what, value, unit="", wanted=""):
    value = value if isinstance(value, int) else float(value)
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def told_only(problem, names):
    """Return a problem of `building` that is told some of its inputs; the others are fixed."""
    box = problem.exogenous
    place = [box.names.index(name) for name in names]
    exogenous = None
    if names:
        exogenous = capsyn.Box(box.lower[place], box.upper[place], names=names)

    def fill(function):
        def filled(*arguments):
            arguments, w = (arguments[:-1], arguments[-1]) if names else (arguments, ())
            known = MIDDLE | {name: w[k] for k, name in enumerate(names)}
            return function(*arguments, [known[name] for name in box.names])

        return filled

    functions = {
        name: fill(getattr(problem, name))
        for name in ("dynamics", "running_cost", "target", "default")
    }
    grid = problem.partitions[: 2 + len(names)]
    return problem.replace(exogenous=exogenous, partitions=grid, refinement=2, **functions)


def loop_agreement(tree, policy, count=200, seed=1):
    """Return the share of states that loops of a policy visit where a tree says the same."""
    rng = np.random.default_rng(seed)
    starts, told = (
        rng.uniform(box.lower, box.upper, (count, box.n))
        for box in (policy.domain, policy.exogenous)
    )
    run = capsyn.simulate(policy, starts, 2 * 24 * 60.0, exogenous=told)
    states, w = run.states[:, 1:-1].reshape(-1, 2), run.exogenous[:, 1:-1].reshape(-1, 2)
    current = run.symbols[:, :-1].reshape(-1)
    return np.mean(tree(states, w, current=current) == policy(states, w, current=current))


if __name__ == "__main__":
    problem = problems.get("building")
    offsets = runpy.run_path(str(EXAMPLES / "setpoint.py"))["offsets"]
    policy = capsyn.synthesize(problem)
    found = np.abs(offsets(policy, count=1000))
    row("building, law as default: largest mean error of 1,000 days", found.max(), "K", "<= 0.1")
    constant = capsyn.synthesize(problem.replace(default=[0.5, 0.5]))
    row("building, constant default: the same", np.abs(offsets(constant, count=1000)).max(), "K")

    tree = capsyn.compress(policy, "linear", agreement=0.995)
    row("building, tree: nodes", tree.node_count, "", "<= 40")
    row("building, tree: agreement where the loop goes", 100 * loop_agreement(tree, policy),
        "%", ">= 97")  # fmt: skip
    row("building, tree: largest mean error of 1,000 days", np.abs(offsets(tree, 1000)).max(), "K")

    for names in ((), ("setpoint",), ("setpoint", "outdoor")):
        one = told_only(problem, list(names))
        what = "building, told " + (" and ".join(names) or "nothing")
        affine = capsyn.synthesize(one)
        grid = (24, 12, 15, 2)[: one.space.n]
        plain = capsyn.synthesize(one, leaves="constant", partitions=grid, max_level=2)
        for leaves, made in (("affine", affine), ("constant", plain)):
            row(f"{what}, {leaves} leaves: cells", made.cells.leaf_count)
            row(f"{what}, {leaves} leaves: solves", made.statistics["solves"])
        tree = capsyn.compress(affine, "linear", agreement=0.99)
        row(f"{what}, tree at 99 %: nodes", tree.node_count)

    example = runpy.run_path(str(EXAMPLES / "measured_load.py"))
    policy = capsyn.synthesize(example["problem"], refine="adaptive", leaf_error=5e-4)
    found = np.abs(example["offsets"](policy, np.linspace(30, 50, 21), np.linspace(10, 40, 31)))
    row("boost converter told its load: largest mean error, 30 to 50 V, 10 to 40 ohm", found.max(),
        "V", "<= 0.1")  # fmt: skip
    row("boost converter told its load: cells", policy.cells.leaf_count)
    print(json.dumps(rows))
