"""Play Gymnasium's Pendulum-v1 with a policy that is made from predictive control.

The controller tries all sequences of six torques at every test point, with the environment's own
cost. Later torques of a sequence are held longer. The policy gives the first torque of the best
sequence, and plays the environment.
"""

import casadi as ca
import numpy as np

import capsyn
from capsyn.integrations.gymnasium import evaluate
from capsyn.sources.callables import problem_policy
from capsyn.sources.finite_control_set import finite_control_set

problem = capsyn.Problem(
    name="pendulum-v1",
    dynamics=lambda x, u: [x[1], 15 * ca.sin(x[0]) + 3 * u[0]],  # g = 10, l = m = 1
    domain=capsyn.Box(
        [-np.pi, -8],
        [np.pi, 8],
        names=["angle", "rate"],
        units=["rad", "rad/s"],
        periodic=[True, False],
    ),
    alphabet=capsyn.Alphabet([-2, 0, 2], inputs=["torque"], units=["N m"]),
    default=0.0,
    horizon=1.8,
    running_cost=lambda x: 20 * (ca.atan2(ca.sin(x[0]), ca.cos(x[0])) ** 2 + 0.1 * x[1] ** 2),
    settings=capsyn.SsacSettings(control_weight=20 * 0.001),
    max_level=3,
    outside="nearest",
)


def state(observation):
    """Return the state (angle, rate) of an observation (cosine, sine, rate)."""
    return [np.arctan2(observation[1], observation[0]), observation[2]]


if __name__ == "__main__":
    control = finite_control_set(problem, 6, sample_time=0.05, blocks=[1, 3, 5, 7, 9, 11])
    policy = problem_policy(control, problem)
    print(f"{policy.statistics['solves']} solves, {policy.cells.leaf_count} cells")
    found = evaluate(policy, "Pendulum-v1", episodes=100, seed=1, observation=state)
    low, high = found.interval
    print(f"policy: mean return {found.mean:.0f} ({low:.0f} to {high:.0f})")
