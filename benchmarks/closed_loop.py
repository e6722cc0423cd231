"""How long closed loops, whole online actions, an interval proof and the reproduction take."""

import dataclasses
import json
import tempfile
import time

import numpy as np

from capsyn import online_controller, problems, synthesize
from capsyn.paper.reproduction import reproduce
from capsyn.problems import cart_pendulum
from capsyn.simulation.experiment import set_up
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import plant_of
from capsyn.verification.lyapunov import lyapunov

TRIALS, SECONDS, RATE = 1000, 15.0, 1000.0


def median_of(run, rounds):
    """Return the median seconds of a call, after one that warms up."""
    run()
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def closed_loops(policy, rounds, **options):
    """Return the seconds of 1,000 trials of 15 s at 1 kHz, from start to end."""
    loop = LoopOptions(SECONDS, RATE, **options)
    experiment = set_up(policy, plant_of(policy), loop)
    states = policy.domain.sample(TRIALS, 0)

    def run():
        trials = experiment.trials(states, np.zeros(TRIALS), np.zeros((TRIALS, 0)))
        experiment.run(trials, None, None)

    return median_of(run, rounds)


def measure():
    """Return the rows."""
    rows = []
    for name in ("cart-pendulum", "double-tank-a", "cart-pole"):
        policy = synthesize(problems.plain(name))
        if name == "cart-pendulum":
            pendulum = policy
        seconds = closed_loops(policy, 5, outside="nearest")
        rows.append(
            {
                "what": f"closed loop: {name}, 1,000 trials of 15 s at 1 kHz, all processors",
                "value": seconds,
                "unit": "s",
                "wanted": "<= 2.5",
            }
        )
    two, one = (closed_loops(pendulum, 5, threads=k) for k in (2, 1))
    rows.append({"what": "closed loop: two threads over one", "value": one / two, "unit": "ratio"})
    for what, method, changes, wanted in (
        ("sSAC, tau now", "ssac", {}, "<= 40"),
        ("sSAC, tau searched", "ssac", {"application_time": "search"}, ""),
        ("SAC, tau now", "sac", {}, ""),
        ("sSAC around the policy", "ssac", {"default": pendulum}, ""),
    ):
        default = changes.pop("default", None)
        settings = dataclasses.replace(pendulum.settings, **changes)
        controller = online_controller(pendulum, method, settings=settings, default=default)
        states = pendulum.domain.sample(1000, 1)
        times = []
        for state in states:
            started = time.perf_counter()
            controller.actions(state)
            times.append(time.perf_counter() - started)
        rows.append(
            {
                "what": f"one whole action from Python: {what}, pendulum, T = 1.2",
                "value": 1e6 * float(np.median(times)),
                "unit": "us",
                "wanted": wanted,
            }
        )
    rows.append(
        {
            "what": "interval proof of the pendulum, V = abs(E)",
            "value": median_of(lambda: lyapunov(pendulum, cart_pendulum.energy_error), 3),
            "unit": "s",
            "wanted": "<= 5",
        }
    )
    with tempfile.TemporaryDirectory() as directory:
        started = time.perf_counter()
        reproduce(directory)
        rows.append(
            {
                "what": "reproduce: the paper's policies, figures and numbers",
                "value": time.perf_counter() - started,
                "unit": "s",
                "wanted": "<= 60",
            }
        )
    return rows


if __name__ == "__main__":
    print(json.dumps(measure()))
