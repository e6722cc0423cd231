"""A block that is pushed to rest, with free settings; its text is a user's file, too."""

from pathlib import Path

from capsyn import Ball, Box, Free, Problem, SsacSettings

TEXT = Path(__file__).read_text()
LOOPS = {"duration": 8, "rate": 10}


def block(horizon=Free(0.1, 3), effort=Free(0.01, 10)):
    return Problem(
        name="block",
        dynamics=lambda x, u: [x[1], u[0]],
        domain=Box([-1, -1], [1, 1], names=["place", "speed"]),
        alphabet=[-1, 0, 1],
        default=0,
        horizon=horizon,
        running_cost=lambda x: x[0] ** 2 + 0.3 * x[1] ** 2,
        target=Ball([0, 0], 0.2),
        outside="nearest",
        settings=SsacSettings(rule="steepest", control_weight=effort, steps=10, sample_time=0.1),
        partitions=5,
        max_level=1,
    )


problem = block
