"""What rollouts make of greedy policies: closed-loop cost over the optimum's, and no harm."""

import dataclasses
import json
import time

import casadi as ca
import numpy as np

import capsyn
import tails
from capsyn import problems
from capsyn.improvement.charged_loop import ChargedLoop
from capsyn.improvement.judged import Comparison

TANKS = capsyn.Box([0.1, 0.1], [0.9, 0.9], names=["x1", "x2"])
CASES = {
    "double-tank-a": (50, 6.0, TANKS, ("", "<= 1.03", "<= 1.01")),
    "double-tank-b": (50, 6.0, TANKS, ("", "<= 1.005", "<= 1.005")),
    "cart-pendulum": (100, 8.0, None, ("", "", "<= 1.006")),
    "boost-converter": (100_000, 10e-3, None, ("", "", "")),
}
"""Samples per second, time, starts, and what is wanted before, after one round, and after two."""
RANDOM, DURATION, STARTS = 30, 5.0, 400
rows = []


def row(what, value, unit="", wanted=""):
    value = value if isinstance(value, int) else float(value)
    rows.append({"what": what, "value": value, "unit": unit, "wanted": wanted})


def over_the_optimum():
    """Add rows of the built-in problems without prices, by rounds."""
    for name, (rate, duration, initial, wanted) in CASES.items():
        problem = problems.plain(name)
        options = {"rate": rate, "duration": duration, "initial": initial}
        policy = capsyn.synthesize(problem)
        capsyn.improve(policy, **options, starts=10, max_level=0)  # the kernel is there
        began = time.process_time()
        capsyn.improve(policy, **options, horizons=problem.horizon)
        one = time.process_time() - began
        box = capsyn.Box([-2, -5], [30, 90]) if name == "boost-converter" else None
        best = capsyn.optimum(problem, duration, rate=rate, initial=initial, seed=7, box=box)
        policies, seconds, given = [policy], [], np.nan
        for seed in (1, 2):
            began = time.process_time()
            policies.append(capsyn.improve(policies[-1], **options, seed=seed).policy)
            seconds.append(time.process_time() - began)
        for rounds, (each, bound) in enumerate(zip(policies, wanted)):
            found = best.compare(each)
            what = f"{name}, {rounds} round(s): cost over the optimum's"
            row(what, found.ratio, f"({found.low:.4f} to {found.high:.4f})", bound)
            costs = found.costs
            row(f"{name}, {rounds} round(s): mean cost", costs.mean(), f"(worst {costs.max():.4g})")
            if name == "boost-converter" and rounds:
                row(f"{name}, {rounds} round(s): cost over that before", costs.mean() / given, "",
                    "<= 0.508")  # fmt: skip
            given = costs.mean() if rounds == 0 else given
        row(f"{name}: mean cost of the optimum", best.costs.mean())
        row(f"{name}: processor time of a round with one horizon", one, "s", "<= 3")
        row(f"{name}: processor time of a round with the ladder", max(seconds), "s", "<= 8")


def random_problem(seed):
    """Return a random nonlinear problem of 1 to 4 states, with some of all features."""
    random = np.random.default_rng([seed, 20])
    n, m = 1 + seed % 4, int(random.integers(1, 3))
    a, b, c = (random.normal(size=(n, k)) for k in (n, m, n))
    weights, ends = random.uniform(0.2, 2.0, n), random.uniform(0, 2) * (seed % 3 == 0)
    values = random.uniform(-2, 2, size=(int(random.integers(2, 6)), m))

    def rates(x, u, *w):
        load = [w[0][0] if w else 0, *[0] * (n - 1)]
        swing = ca.mtimes(c, ca.sin(x)) + ca.mtimes(a - 1.5 * np.eye(n), x)
        return swing + ca.mtimes(b, u) + ca.vertcat(*load)

    return capsyn.Problem(
        name=f"random-{seed}",
        dynamics=rates,
        domain=capsyn.Box(-2 * np.ones(n), 2 * np.ones(n)),
        exogenous=capsyn.Box([-0.5], [0.5], names=["load"]) if n < 3 and seed % 5 == 4 else None,
        alphabet=values,
        default=np.zeros(m) if seed % 2 else values[0],
        horizon=float(random.uniform(0.3, 1.0)),
        running_cost=lambda x, *w: ca.dot(weights, x**2),
        terminal_cost=(lambda x, *w: ends * ca.sumsqr(x)) if ends else None,
        outside=("nearest", "error")[seed % 2],
        switching=capsyn.Switching("2%", 0.1 * (seed % 4 == 0)) if seed % 3 == 1 else None,
        settings=capsyn.SsacSettings(
            rule=("steepest", "schedule")[seed % 2],
            control_weight=0.1 * (seed % 5),
            sample_time=0.05,
            steps=10,
        ),
        leaves="affine" if n == 3 else "constant",
        partitions=5 if n < 3 else 3,
        max_level=3 if n < 3 else 1,
    )


def no_harm():
    """Add rows of random problems, whose policies are judged again from fresh starts."""
    improved, worse, shares = 0, 0, []
    for seed in range(RANDOM):
        policy = capsyn.synthesize(random_problem(seed))
        result = capsyn.improve(policy, 2, duration=DURATION)
        improved += result.improved
        loop = ChargedLoop.of(policy, 20, "auto", 2).charging(result.scale)
        states, samples = policy.space.sample(1000, [seed, 21]), round(DURATION * 20)
        after = dataclasses.replace(loop, policy=result.policy).costs_from(states, samples)
        found = Comparison.of(loop.costs_from(states, samples), after, 0.95)
        worse += found.lost > found.lost_before or (found.low > 0 and not found.fewer_lost)
        if np.isfinite(found.before) and found.before > 0 and not found.fewer_lost:
            shares.append(found.after / found.before)
    row(f"{RANDOM} random problems of 1 to 4 states: improved", int(improved))
    row("of them surely worse from 1,000 fresh starts, or with more starts lost", worse, "", "<= 0")
    row("their median cost over that of the policy given", np.median(shares))
    row("the largest", max(shares))


def by_tails():
    """Add rows of policies of six states, which go by fitted tails."""
    for name, problem, options, share, duration, rate, judge, figure, unit in (
        ("planar quadrotor", problems.plain("planar-quadrotor").replace(max_level=0), {}, 1.0,
         20, 1000, tails.near(6, 0.2, 10_000), "cost", ""),
        ("docking with 9 symbols", tails.nine_symbols(), {"max_solves": 60_000},
         [0.9, 0.9, 0.9, 0.2, 0.2, 0.2], 60, 10, tails.docked, "fuel", "N s"),
    ):  # fmt: skip
        policy = capsyn.synthesize(problem, **options)
        started = time.process_time()
        better = capsyn.improve(policy)
        seconds = time.process_time() - started
        for when, each in (("given", policy), ("after one round", better.policy)):
            good, used = tails.loops(each, tails.starts(each, share), duration, rate, judge)
            row(f"{name}, no tail, {when}: success", 100 * good.mean(), "%")
            row(f"{name}, no tail, {when}: mean {figure}", used.mean(), unit)
        row(f"{name}, no tail: processor time of the round", seconds, "s")


if __name__ == "__main__":
    over_the_optimum()
    no_harm()
    by_tails()
    print(json.dumps(rows))
