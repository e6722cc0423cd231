"""What a tail brings: closed loops of problems with one and of the same without."""

import json
import time

import numpy as np

import capsyn
from capsyn import problems
from capsyn.problems import docking, double_pendulum
from capsyn.sources.finite_control_set import finite_control_set
from capsyn.statistics import clopper_pearson

COUNT, CHUNK = 1000, 50
rows = []


def row(what, value, unit="", wanted=""):
    rows.append({"what": what, "value": float(value), "unit": unit, "wanted": wanted})


def judged(what, good, wanted=""):
    """Add rows of a success rate and of the lower end of its 95 % interval."""
    row(f"{what}: success", 100 * good.mean(), "%", wanted)
    low, _ = clopper_pearson(int(good.sum()), len(good), 0.95)
    row(f"{what}: success is at least, with 95 % confidence", 100 * low, "%")


def starts(problem, share=1.0, seed=20):
    """Return random states of the domain, shrunk to shares of it."""
    middle = (problem.domain.lower + problem.domain.upper) / 2
    return middle + (problem.domain.sample(COUNT, seed) - middle) * share


def loops(policy, states, duration, rate, judge):
    """Return what a judge says of trajectories (good, figure), over all starts."""
    parts = [
        judge(capsyn.simulate(policy, part, duration, rate=rate))
        for part in np.array_split(states, len(states) // CHUNK)
    ]
    return [np.concatenate(values) for values in zip(*parts)]


def near(axes, radius, first):
    """Return a judge: within a radius of the origin from a sample on; cost."""

    def judge(run):
        off = np.linalg.norm(run.states[:, first:, :axes], axis=-1)
        return (off <= radius).all(axis=1), run.costs[:, -1]

    return judge


def upright(run):
    """Judge whether a pole never fell; cost."""
    return (np.abs(run.states[:, :, 2]) <= 0.6).all(axis=1), run.costs[:, -1]


def nine_symbols(effort=0.4):
    """Return the docking of a satellite, one thruster at a time or none."""
    problem = problems.get("docking")
    flags = [np.eye(8, dtype=int)[k] for k in range(8)]

    def cost(x):
        place, speed = x[0] ** 2 + x[1] ** 2, x[3] ** 2 + x[4] ** 2
        return place + 1.2 * (1 - np.cos(x[2])) + 12.3 * speed + 5.9 * x[5] ** 2

    return capsyn.Problem(
        name="docking-9",
        dynamics=lambda x, u: docking.dynamics(x, u, None),
        domain=problem.domain,
        alphabet=[[0] * 8, *flags],
        default=[0] * 8,
        horizon=5.0,
        running_cost=cost,
        outside="nearest",
        settings=capsyn.SsacSettings(rule="steepest", control_weight=effort, sample_time=0.1),
        partitions=4,
        max_level=1,
        leaves="affine",
    )


def docked(run):
    """Judge whether a satellite arrived within a minute; fuel until then [N s]."""
    place, speed = (np.linalg.norm(run.states[..., k : k + 2], axis=-1) for k in (0, 3))
    turned = 1 - np.cos(run.states[..., 2])
    there = (place < 0.05) & (turned < 0.004) & (speed < 0.03) & (abs(run.states[..., 5]) < 0.05)
    before = np.cumsum(there, axis=1)[:, :-1] == 0
    return there.any(axis=1), docking.THRUST * 0.1 * (run.controls.sum(axis=-1) * before).sum(
        axis=1
    )


def pumped(run):
    """Judge whether a double pendulum holds the energy of standing from 15 to 20 s, within 10 %."""
    x, whole = run.states, 6 * 9.81
    shares = np.abs([double_pendulum.energy(z) for z in x.transpose(0, 2, 1)]) / whole
    return (shares[:, 7500:] <= 0.1).all(axis=1), (shares <= 0.05).any(axis=1)


def docked_cases():
    """Add rows of the docking of a satellite at two efforts, by Riccati, fit and without a tail."""
    share = [0.9, 0.9, 0.9, 0.2, 0.2, 0.2]
    for effort in (0.4, 0.13):
        plain = nine_symbols(effort)
        fit = capsyn.fitted_tail(plain.replace(horizon=2.0), max_solves=60_000)
        for tail, problem in (
            ("with a tail", plain.replace(tail="riccati", horizon=None)),
            ("with a fitted tail", plain.replace(tail=fit, horizon=2.0)),
            ("without a tail", plain),
        ):
            policy = capsyn.synthesize(problem, max_solves=60_000)
            good, fuel = loops(policy, starts(policy, share), 60, 10, docked)
            name = "docking with 9 symbols" + ("" if effort == 0.4 else f", effort {effort:g}")
            what = f"{name} {tail}, arrived within 60 s"
            wanted = tail == "with a tail"
            judged(what, good, ">= 99" if wanted else "")
            bound = "<= 2.8" if wanted and effort == 0.4 else ""
            row(f"{what}: mean fuel", fuel.mean(), "N s", bound)


def fits():
    """Add rows of the planar quadrotor and the cart-pole with fitted tails, and what these take."""
    for name, horizon, share, duration, judge, text in (
        ("planar-quadrotor", 0.2, 1.0, 20, near(6, 0.2, 10_000),
         "planar quadrotor with a fitted tail, within 0.2 of the origin from 10 to 20 s"),
        ("cart-pole", 0.1, 0.05, 10, upright,
         "cart-pole with a fitted tail, starts within 5 % of the domain, up for 10 s"),
    ):  # fmt: skip
        problem = problems.get(name).replace(horizon=horizon, tail="fit")
        started = time.process_time()
        policy = capsyn.synthesize(problem)
        seconds = time.process_time() - started
        good, cost = loops(policy, starts(policy, share), duration, 1000, judge)
        judged(text, good)
        row(f"{text}: mean cost", cost.mean())
        row(f"{text}: processor time of synthesis with the fit", seconds, "s")


def finite_sets():
    """Add rows of predictive control of the boost converter, with a tail and without."""
    problem = problems.plain("boost-converter").replace(min_dwell=0.0)
    states, many = problem.domain.sample(200, 20), problem.domain.sample(200_000, 1)
    bare = problem.replace(terminal_cost=None)
    times = {}
    for how, each, depth in (
        ("with a tail", problem.replace(tail="riccati"), 1),
        ("with a tail", problem.replace(tail="riccati"), 2),
        ("without", bare, 5),
        ("with its own terminal cost", problem, 5),
        ("with its own terminal cost", problem, 1),
    ):
        control = finite_control_set(each, depth, sample_time=1e-5, threads=1)

        def act(_, x, control=control):
            return problem.alphabet.values[control(x)]

        run = capsyn.simulate(act, states, 10e-3, rate=1e5, model=problem)
        what = f"predictive control of the boost converter, depth {depth} {how}"
        row(f"{what}: mean cost", run.costs[:, -1].mean())
        control(many[:64])
        started = time.process_time()
        control(many)
        times[depth, how] = (time.process_time() - started) / len(many)
        row(f"{what}: a state", 1e6 * times[depth, how], "us")
    ratio = times[5, "without"] / times[1, "with a tail"]
    row("predictive control: time of depth 5 over depth 1 with a tail", ratio)


def quadrotors():
    """Add rows of the full quadrotor: of its built-in settings and of other efforts."""
    problem = problems.get("quadrotor")
    for changes in ({"tail": "riccati:0.3"}, {"tail": "riccati:4"}, {"horizon": 0.3}):
        policy = capsyn.synthesize(problem.replace(**changes))
        good, _ = loops(policy, starts(policy), 8, 500, near(3, 0.3, 3000))
        text = ", ".join(f"{name} {value}" for name, value in changes.items())
        judged(f"quadrotor, one cell, {text}, starts from all of the domain", good)
    choices = {
        "one cell": {},
        "adaptive": {
            "max_level": 4,
            "refine": "adaptive",
            "test_points": "center+faces",
            "max_solves": 10_000,
        },
    }
    for how, options in choices.items():
        capsyn.synthesize(problem, **options)  # compiles
        began, spent = time.perf_counter(), time.process_time()
        policy = capsyn.synthesize(problem, **options)
        row(f"quadrotor, 12 states, {how}: time", time.perf_counter() - began, "s", "<= 1")
        row(f"quadrotor, {how}: processor time", time.process_time() - spent, "s")
        row(f"quadrotor, {how}: solves", policy.statistics["solves"], "", "<= 30000")
        row(f"quadrotor, {how}: cells", policy.cells.leaf_count)
        for share in (0.3, 0.6, 1.0):
            good, _ = loops(policy, starts(policy, share), 8, 500, near(3, 0.3, 3000))
            what = f"quadrotor, {how}, starts from {share:g} of the domain, within 0.3 m from 6 s"
            judged(what, good, ">= 99" if share <= 0.6 else "")


if __name__ == "__main__":
    slow = starts(problems.plain("double-pendulum"))
    for how, make in (("", problems.get), (" that knows slow links alone", problems.plain)):
        policy = capsyn.synthesize(make("double-pendulum"))
        good, reached = loops(policy, slow, 20, 500, pumped)
        what = f"double pendulum{how}, within 10 % of the energy from 15 to 20 s"
        judged(what, good, "" if how else ">= 99")
        row(f"double pendulum{how}: within 5 % at some time", 100 * reached.mean(), "%")
        row(f"double pendulum{how}: solves", policy.statistics["solves"])

    for tail, make in (("with", problems.get), ("without", problems.plain)):
        policy = capsyn.synthesize(make("planar-quadrotor"))
        good, cost = loops(policy, starts(policy), 20, 1000, near(6, 0.2, 10_000))
        what = f"planar quadrotor {tail} a tail, within 0.2 of the origin from 10 to 20 s"
        judged(what, good, ">= 99" if tail == "with" else "")
        row(f"{what}: mean cost", cost.mean(), "", "<= 6.5" if tail == "with" else "")
        policy = capsyn.synthesize(make("spacecraft"))
        good, cost = loops(policy, starts(policy), 40, 100, near(6, 0.05, 3000))
        what = f"spacecraft {tail} a tail, within 0.05 of rest from 30 to 40 s"
        judged(what, good, ">= 99" if tail == "with" else "")
        row(f"{what}: mean cost", cost.mean())
        policy = capsyn.synthesize(make("cart-pole"))
        good, cost = loops(policy, starts(policy, 0.05), 10, 1000, upright)
        what = f"cart-pole {tail} a tail, starts within 5 % of the domain, up for 10 s"
        judged(what, good, ">= 99" if tail == "with" else "")
        if tail == "with":  # where the pole falls the cost is not finite
            row(f"{what}: mean cost", cost.mean())

    docked_cases()
    fits()
    finite_sets()
    quadrotors()
    print(json.dumps(rows))
