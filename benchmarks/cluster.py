"""What a cluster costs: two worker processes of one thread against two threads of one process.

It takes some minutes, and the extra ``distributed``. On a busy machine the wall times say little;
the processor times of all processes together are told beside them.
"""

import dataclasses
import json
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
from distributed import Client

from capsyn import monte_carlo, problems, synthesize

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))
ROUNDS = 3
STEPS = 1700
"""Integration steps that make the solves of cart-pole level 4 a job of some 30 s."""


def processor_seconds():
    """Return the processor time of this process and of those that it started [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    children = [p.cpu_times() for p in psutil.Process().children(recursive=True)]
    return usage.ru_utime + usage.ru_stime + sum(c.user + c.system for c in children)


def timed(function):
    """Return what a function gives, its wall time and its processor time [s]."""
    wall, processor = time.perf_counter(), processor_seconds()
    found = function()
    return found, time.perf_counter() - wall, processor_seconds() - processor


def compare(what, run, same):
    """Return rows for a job: ``run(executor)`` on the cluster over that in two threads."""
    from support.processes.dask import processes, start_scheduler, start_worker

    with tempfile.TemporaryDirectory() as directory, processes() as start:
        address, _ = start_scheduler(start, Path(directory))
        for name in ("one", "two"):
            start_worker(start, address, name)
        with Client(address) as client:
            client.wait_for_workers(2)
            run(client)  # kernels are built
            rounds = []
            for _ in range(ROUNDS):
                local, *own = timed(lambda: run(None))
                remote, *theirs = timed(lambda: run(client))
                assert same(local) == same(remote)
                rounds.append((own[0], theirs[0], theirs[0] / own[0], theirs[1] / own[1]))
                print(what, [round(x, 3) for x in rounds[-1]], file=sys.stderr)
    local, remote, wall, processor = sorted(rounds, key=lambda row: row[2])[ROUNDS // 2]
    return [
        {"what": f"{what}: 2 threads", "value": local, "unit": "s"},
        {"what": f"{what}: 2 workers", "value": remote, "unit": "s"},
        {
            "what": f"{what}: 2 workers over 2 threads",
            "value": wall,
            "unit": "ratio",
            "wanted": "<= 1.25" if local > 15 else None,
        },
        {
            "what": f"{what}: processor time of all processes, 2 workers over 2 threads",
            "value": processor,
            "unit": "ratio",
        },
    ]


def content(policy):
    """Return the bytes of a policy's file."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "policy.cap"
        policy.save(path)
        return path.read_bytes()


def bereft(run, seconds):
    """Return rows: a policy made while one of two workers is killed after some time [s]."""
    from support.processes.dask import processes, start_scheduler, start_worker

    with tempfile.TemporaryDirectory() as directory, processes() as start:
        address, _ = start_scheduler(start, Path(directory))
        workers = [start_worker(start, address, name) for name in ("one", "two")]
        with Client(address) as client:
            client.wait_for_workers(2)
            timer = threading.Timer(seconds, workers[0].kill)
            timer.start()
            found, wall, _ = timed(lambda: run(client))
            left = len(client.nthreads())
    print("one worker killed", round(wall, 3), "workers left", left, file=sys.stderr)
    assert left == 1
    what = f"one of 2 workers killed after {seconds:.0f} s"
    return [
        {"what": what, "value": wall, "unit": "s"},
        {
            "what": f"{what}: files that differ",
            "value": int(content(found) != content(run(None))),
            "unit": "",
            "wanted": "<= 0",
        },
    ]


def killed():
    """Return a row: of 20 random kills, how many runs ended with other bytes."""
    with tempfile.TemporaryDirectory() as directory:
        command = [
            sys.executable,
            str(HERE.parent / "tests" / "support" / "processes" / "killed_runs.py"),
            directory,
        ]
        told = json.loads(subprocess.check_output([*command, "20", "1"]))
        whole, other = (Path(directory, name).read_bytes() for name in ("whole.cap", "killed.cap"))
    print("killed", told, file=sys.stderr)
    return {
        "what": "killed by SIGKILL at 20 random moments and started again: files that differ",
        "value": int(whole != other),
        "unit": "",
        "wanted": "<= 0",
    }


def main():
    """Measure and print rows."""
    problem = problems.plain("cart-pole")
    fine = problem.replace(settings=dataclasses.replace(problem.settings, steps=STEPS))
    policy = synthesize(problems.plain("cart-pendulum"))

    def synthesis(chosen):
        return lambda client: synthesize(chosen, max_level=4, threads=2, executor=client)

    def trials(client):
        return monte_carlo(policy, 30_000, threads=2, executor=client)

    rows = [
        *compare(f"cart-pole level 4 in {STEPS} steps", synthesis(fine), content),
        *bereft(synthesis(fine), 8.0),
        *compare("cart-pole level 4 in 20 steps", synthesis(problem), content),
        *compare("30,000 trials", trials, lambda found: found.final.tobytes()),
        killed(),
    ]
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
