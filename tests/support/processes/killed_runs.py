"""Start a synthesis with a checkpoint, kill it at random moments, and print what came of it.

Runs as a process of its own: ``python killed_runs.py DIRECTORY KILLS SEED``.
"""

import dataclasses
import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

import capsyn
from capsyn import problems
from capsyn.execution import checkpoint


def written(directory):
    """Return how many blocks the checkpoint has."""
    return len(list((directory / "kept").glob("block-*")))


def main():
    directory, kills, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    checkpoint.INTERVAL = 0.01
    problem = problems.plain("cart-pendulum")
    problem = problem.replace(settings=dataclasses.replace(problem.settings, steps=100))
    rng = np.random.default_rng(seed)

    def run(name, **options):
        policy = capsyn.synthesize(problem, max_level=7, backend="numpy", threads=2, **options)
        policy.save(directory / name)

    started = time.monotonic()
    run("whole.cap")
    whole = time.monotonic() - started
    blocks, finished = [], 0
    for _ in range(kills):
        child = os.fork()
        if not child:
            run("killed.cap", checkpoint=directory / "kept")
            os._exit(0)
        time.sleep(rng.uniform(0, whole / 12))
        wanted = rng.integers(0, 3) + (blocks[-1] if blocks else 0)  # on a busy machine, too
        while written(directory) < wanted and not os.waitpid(child, os.WNOHANG)[0]:
            time.sleep(rng.uniform(0, 0.01))
        try:
            os.kill(child, signal.SIGKILL)
            finished += os.WIFEXITED(os.waitpid(child, 0)[1])
        except (ProcessLookupError, ChildProcessError):
            finished += 1
        blocks.append(written(directory))
    run("killed.cap", checkpoint=directory / "kept")
    print(json.dumps({"seconds": whole, "finished": finished, "blocks": blocks}))


if __name__ == "__main__":
    main()
