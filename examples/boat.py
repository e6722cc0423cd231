"""Make a policy for a boat that drifts in one dimension and has two on/off thrusters.

The water brakes the boat. The goal is to stop at position 0.
"""

import casadi as ca

import capsyn

problem = capsyn.Problem(
    name="boat",
    dynamics=lambda x, u: [x[1], u[0] - u[1] - 0.5 * x[1] * ca.fabs(x[1])],
    domain=capsyn.Box([-10, -3], [10, 3], names=["position", "speed"], units=["m", "m/s"]),
    alphabet=capsyn.Alphabet(
        [[0, 0], [1, 0], [0, 1]], names=["coast", "ahead", "astern"], inputs=["stern", "bow"]
    ),
    default=[0, 0],
    horizon=4.0,
    running_cost=lambda x: x[0] ** 2 + 4 * x[1] ** 2,
    settings=capsyn.SsacSettings(rule="steepest", control_weight=5.0),
    outside="nearest",
)


if __name__ == "__main__":
    policy = capsyn.synthesize(problem)
    for start in ([8.0, 0.0], [-5.0, 2.0], [9.0, -3.0]):
        run = capsyn.simulate(policy, start, duration=40.0, rate=100.0)
        position, speed = run.states[-1]
        print(f"from {start}: {position:+.2f} m, {speed:+.2f} m/s after 40 s")
