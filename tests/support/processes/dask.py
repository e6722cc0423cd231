"""A Dask scheduler and workers as processes of their own."""

import contextlib
import json
import os
import subprocess
import sys
import time

OWN = {
    "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s",
    "DASK_DISTRIBUTED__COMM__RETRY__COUNT": "0",
    "OMP_NUM_THREADS": "1",
}


@contextlib.contextmanager
def processes():
    """Yield a function that starts a command with an environment; all are killed in the end."""
    started = []

    def start(*command, **environment):
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", *command],
                env={**os.environ, **OWN, **environment},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        )
        return started[-1]

    try:
        yield start
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.wait()


def start_scheduler(start, directory):
    """Start a scheduler on a free port of loopback; return its address and process."""
    file = directory / "scheduler.json"
    process = start(
        "distributed.cli.dask_scheduler",
        *f"--host 127.0.0.1 --port 0 --no-dashboard --no-show --scheduler-file {file}".split(),
    )
    for _ in range(300):
        with contextlib.suppress(OSError, ValueError):
            return json.loads(file.read_text())["address"], process
        time.sleep(0.1)
    raise TimeoutError("the scheduler does not start")


def start_worker(start, address, name, **environment):
    """Start a worker of one thread; return its process."""
    options = f"--nthreads 1 --no-nanny --no-dashboard --name {name} --memory-limit 0"
    return start("distributed.cli.dask_worker", address, *options.split(), **environment)
