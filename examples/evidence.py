"""Measure what the boat's policy is worth, and compare it with online sSAC.

The Monte Carlo trials vary mass and drag, and add noise, delay and a least time between switches.
"""

import numpy as np
from boat import problem

import capsyn

policy = capsyn.synthesize(problem)
arrived = capsyn.Box([-0.5, -0.5], [0.5, 0.5], names=["position", "speed"])


def heavier_boat(x, u, p):
    """Return the rates of a boat whose mass and drag are known only roughly."""
    mass, drag = p[0], p[1]
    return [x[1], (u[0] - u[1] - drag * x[1] * np.fabs(x[1])) / mass]


result = capsyn.monte_carlo(
    policy,
    trials=500,
    duration=40.0,
    rate=20.0,
    target=arrived,
    hold=5.0,
    model=heavier_boat,
    parameters={"mass": capsyn.Uniform(0.9, 1.3), "drag": capsyn.Uniform(0.3, 0.7)},
    noise=[0.02, 0.02],
    delay=capsyn.Uniform(0.0, 0.1),
    min_dwell=0.2,
)
print(
    f"{result.success_rate:.1%} of the trials arrive and stay "
    f"({result.low:.1%} to {result.high:.1%}), {np.mean(result.switches / result.times):.2f} "
    "switches per second"
)

start = [8.0, 0.0]
for name, controller in (
    ("policy", policy),
    ("online sSAC", capsyn.online_controller(problem)),
    ("online sSAC around the policy", capsyn.online_controller(problem, default=policy)),
):
    run = capsyn.simulate(controller, start, duration=20.0, rate=20.0, target=arrived)
    print(f"{name}: there after {run.arrived:.2f} s, cost {run.cost:.0f}, {run.switches} switches")
