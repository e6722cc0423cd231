"""How many states per second a policy looks up, on one core."""

import json
import time

import numpy as np

from capsyn import problems, synthesize


def measure():
    """Return rows for batches of a million random states."""
    rows = []
    for name, level in (("cart-pendulum", 4), ("double-tank-a", 4), ("cart-pole", 3)):
        policy = synthesize(problems.plain(name), max_level=level)
        states = policy.domain.sample(1_000_000, 0)
        for backend, wanted in (("c", ">= 20"), ("numpy", ">= 1")):
            policy(states, backend=backend)
            seconds = []
            for _ in range(7):
                started = time.perf_counter()
                policy(states, backend=backend)
                seconds.append(time.perf_counter() - started)
            rows.append(
                {
                    "what": f"lookup: {name} level {level}, {backend}, 1 core",
                    "value": 1 / float(np.median(seconds)),
                    "unit": "million states/s",
                    "wanted": wanted,
                }
            )
    return rows


if __name__ == "__main__":
    print(json.dumps(measure()))
