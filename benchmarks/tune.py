"""What tuning finds: docking from weights that are wrong by ten, the knee of a pendulum's price."""

import json
import time

import casadi as ca
import numpy as np

import capsyn
from capsyn import problems
from capsyn.problems import docking
from tails import docked, judged, loops, nine_symbols, row, rows, starts

REACH, TRIALS = 20.0, 40
GOOD = {"speed": 12.3, "effort": 0.4, "tail": 1.0}
"""Weights of docking that do well: of speed, of effort in the choice, of effort in the tail."""
SHARE = [0.9, 0.9, 0.9, 0.2, 0.2, 0.2]
"""Where satellites start: shares of the domain."""


def arrived(x):
    """Return whether a satellite is in the port, as `docked` judges it."""
    near = ca.logic_and(x[0] ** 2 + x[1] ** 2 < 0.05**2, 1 - ca.cos(x[2]) < 0.004)
    slow = ca.logic_and(x[3] ** 2 + x[4] ** 2 < 0.03**2, ca.fabs(x[5]) < 0.05)
    return ca.logic_and(near, slow)


def from_wrong(factor):
    """Return the docking whose weights are searched around a multiple of those that do well."""
    plain = nine_symbols()
    ranges = [capsyn.Free(factor * v / REACH, factor * v * REACH) for v in GOOD.values()]

    def problem(speed=ranges[0], effort=ranges[1], tail=ranges[2]):
        def cost(x):
            place, rates = x[0] ** 2 + x[1] ** 2, x[3] ** 2 + x[4] ** 2
            return place + 1.2 * (1 - np.cos(x[2])) + speed * rates + 5.9 * x[5] ** 2

        settings = capsyn.SsacSettings(rule="steepest", control_weight=effort, sample_time=0.1)
        return plain.replace(
            running_cost=cost,
            tail=f"riccati:{tail}",
            horizon=None,
            settings=settings,
            target=arrived,
        )

    return problem


def found(problem, **options):
    """Return what tuning finds, with the seconds and the processor seconds that it took."""
    began, work = time.perf_counter(), time.process_time()
    result = capsyn.tune(problem, **options)
    return result, time.perf_counter() - began, time.process_time() - work


domain = problems.get("docking").domain
reach = np.array(SHARE) * domain.upper
for factor in (10.0, 0.1):
    what = f"docking, {len(GOOD)} weights {factor:g} times what does well, {TRIALS} settings"
    result, seconds, work = found(
        from_wrong(factor),
        success=0.99,
        least="effort",
        trials=TRIALS,
        effort=lambda u: docking.THRUST * u.sum(),
        initial=capsyn.Box(-reach, reach, names=domain.names),
        synthesis={"max_solves": 60_000},
        duration=60,
        rate=10,
    )
    first = result.tried[0].figures
    row(f"{what}: success before", 100 * first.success, "%")
    row(f"{what}: mean fuel before", first.effort, "N s")
    good, fuel = loops(result.policy, starts(result.policy, SHARE), 60, 10, docked)
    judged(what, good, ">= 99")
    row(f"{what}: mean fuel", fuel.mean(), "N s", "<= 2.9")
    row(f"{what}: time", seconds, "s", "<= 300")
    row(f"{what}: processor time", work, "s")

what = "cart-pendulum, 24 prices of a switch"
result, seconds, work = found(
    problems.get("cart-pendulum"),
    free={"price": capsyn.Free("0.01%", "30%")},
    success=0.99,
    least="knee",
    trials=24,
    duration=15,
    rate=1000,
    hold=5,
)
cheapest = min(one.figures.cost for one in result.front)
same = next(one.figures for one in result.tried if one.settings == result.settings)
row(f"{what}: price at the knee", float(result.settings["price"].removesuffix("%")), "%")
row(f"{what}: switches there", result.figures.switches, "1/s")
row(f"{what}: most switches on the front", max(o.figures.switches for o in result.front), "1/s")
row(f"{what}: cost at the knee over the least", same.cost / cheapest, "", "<= 1.03")
row(f"{what}: success there, 1,000 fresh starts", 100 * result.figures.success, "%", ">= 99")
row(f"{what}: processor time", work, "s")
print(json.dumps(rows))
