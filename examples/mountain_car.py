"""Play Gymnasium's MountainCar-v0 with a policy of sSAC that uses the car's energy.

The engine is too weak to drive up the hill at once. The cost therefore asks for the energy with
which the car reaches the flag from the bottom. The time unit is a step of the environment.
"""

import casadi as ca

import capsyn
from capsyn.integrations.gymnasium import evaluate

ENGINE, GRAVITY, FLAG = 0.001, 0.0025, 0.5


def energy(x):
    """Return the car's energy per mass."""
    return 0.5 * x[1] ** 2 + GRAVITY / 3 * ca.sin(3 * x[0])


problem = capsyn.Problem(
    name="mountain-car",
    dynamics=lambda x, u: [x[1], ENGINE * u[0] - GRAVITY * ca.cos(3 * x[0])],
    domain=capsyn.Box([-1.2, -0.07], [0.6, 0.07], names=["position", "velocity"]),
    alphabet=capsyn.Alphabet([-1, 0, 1], names=["left", "coast", "right"], inputs=["engine"]),
    default=0.0,
    horizon=10.0,
    terminal_cost=lambda x: 1e6 * (energy(x) - 0.0013) ** 2,
    settings=capsyn.SsacSettings(rule="steepest"),
    max_level=3,
    outside="nearest",
)

if __name__ == "__main__":
    policy = capsyn.synthesize(problem)
    tree = capsyn.compress(policy, "linear", agreement=0.97)
    for name, played in (("cells", policy), ("tree", tree)):
        found = evaluate(played, "MountainCar-v0", episodes=100, seed=1)
        low, high = found.interval
        print(f"{name}: {found.terminated.sum()} of 100 reach the flag, mean return", end=" ")
        print(f"{found.mean:.1f} ({low:.1f} to {high:.1f}), {played.cells.leaf_count} leaves")
