"""Compare the paper's two-symbol policy of the pendulum with the analytical bang-bang law."""

import numpy as np

import capsyn
from capsyn import problems
from capsyn.problems.cart_pendulum import GRAVITY, LENGTH, MASS

policy = capsyn.synthesize(problems.plain("cart-pendulum"))
states = policy.domain.sample(200_000, seed=1)
theta, omega = states.T
energy = 0.5 * MASS * LENGTH**2 * omega**2 + MASS * GRAVITY * LENGTH * (np.cos(theta) - 1)
law = -5 * np.sign(energy * omega * np.cos(theta))
share = np.mean(policy.control(states)[:, 0] == law)

print(f"{policy.statistics['solves']} solves, {policy.cells.leaf_count} cells")
print(f"equal to the law at {share:.2%} of random states")
