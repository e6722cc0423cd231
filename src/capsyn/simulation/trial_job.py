"""Trials of a policy in closed loop as plain data, for the workers of a cluster."""

from __future__ import annotations

import dataclasses
import functools
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from capsyn.execution.cluster import Job, Workers
from capsyn.modelling.alphabet import Outside
from capsyn.native.compiled import compiled
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from capsyn.simulation.closed_loop import Loop, Noise
from capsyn.simulation.kernel import SIMULATION_LANES
from capsyn.simulation.plant import Plant
from capsyn.simulation.policy_loop import run_policy, simulation_kernel

PROBE_TRIALS = 64
PROBE_SAMPLES = 256
"""The first trials, and their first samples, tell whether two machines compute the same."""
PROGRAMS = ("dynamics", "running_cost", "terminal_cost")
"""Those of a plant that are sent."""
BATCHES = 4
"""Batches for each thread of the workers, so that none waits long for the last one."""
BATCH_BYTES = 1 << 21
"""Size of the trials that are sent at once."""

Batch = tuple[np.ndarray, np.ndarray | None, list[tuple[int, ...]] | None]
"""Trials as records, and the deviations and seeds of their noise."""


def run_on_workers(
    client: Any,
    policy: Policy,
    outside: Outside,
    plant: Plant,
    loop: Loop,
    trials: np.ndarray,
    noise: Noise | None,
    backend: str,
) -> None:
    """Run trials under a policy, in place, on the workers of a Dask client."""
    used = "c" if compiled(lambda: simulation_kernel(plant, loop, trials), backend) else "numpy"
    first = _batch(trials, noise, 0, min(PROBE_TRIALS, len(trials)))
    workers = Workers(
        client, functools.partial(_job, policy, outside, plant, loop, first), backend, used
    )
    share = -(-len(trials) // (BATCHES * workers.threads))
    most = max(1, BATCH_BYTES // (trials.itemsize * SIMULATION_LANES))
    size = SIMULATION_LANES * min(most, -(-share // SIMULATION_LANES))
    starts = range(0, len(trials), size)

    def batches() -> Iterator[Batch]:
        for start in starts:
            yield _batch(trials, noise, start, min(start + size, len(trials)))

    for start, done in zip(starts, workers.map(batches()), strict=True):
        trials[start : start + size] = done


def _batch(trials: np.ndarray, noise: Noise | None, start: int, stop: int) -> Batch:
    if noise is None:
        return trials[start:stop].copy(), None, None
    seeds = [tuple(seed) for seed in noise.seeds[start:stop]]
    return trials[start:stop].copy(), noise.deviations[start:stop], seeds


def _job(
    policy: Policy, outside: Outside, plant: Plant, loop: Loop, first: Batch, backend: str
) -> Job:
    with tempfile.TemporaryDirectory(prefix="capsyn-") as directory:
        path = Path(directory) / "policy.cap"
        policy.save(path)
        file = zlib.compress(path.read_bytes(), 1)
    programs = {name: getattr(plant, name).to_json() for name in PROGRAMS}
    return Job(
        build,
        {
            "policy": file,
            "outside": outside,
            "plant": programs | {"parameters": plant.parameters, "sample_time": plant.sample_time},
            "loop": vars(loop) | {"inside": loop.inside.to_json()},
            "probe": first,
            "backend": backend,
        },
    )


def build(
    plain: dict[str, Any],
) -> tuple[Callable[[Batch], np.ndarray], Callable[[], tuple[np.ndarray, ...]]]:
    """Return what runs trials and what probes, of plain data; kernels are built here."""
    with tempfile.TemporaryDirectory(prefix="capsyn-") as directory:
        path = Path(directory) / "policy.cap"
        path.write_bytes(zlib.decompress(plain["policy"]))
        policy = Policy.load(path)
    dynamics, running_cost, terminal_cost = (
        Program.from_json(plain["plant"][name]) for name in PROGRAMS
    )
    plant = Plant(
        dynamics,
        running_cost,
        terminal_cost,
        domain=policy.domain,
        exogenous=policy.exogenous,
        alphabet=policy.alphabet,
        default=policy.default,
        target=None,
        parameters=tuple(plain["plant"]["parameters"]),
        sample_time=plain["plant"]["sample_time"],
    )
    loop = Loop(**{**plain["loop"], "inside": Program.from_json(plain["loop"]["inside"])})

    def run(loop: Loop, batch: Batch) -> np.ndarray:
        trials, deviations, seeds = batch
        trials = trials.copy()
        noise = None if deviations is None or seeds is None else Noise(deviations, seeds)
        arguments = (policy, plain["outside"], plant, loop, trials, noise, None)
        run_policy(*arguments, plain["backend"], 1)
        return trials

    few = min(loop.samples, PROBE_SAMPLES)
    pushes = None if loop.pushes is None else loop.pushes[:few]
    short = dataclasses.replace(loop, samples=few, pushes=pushes)
    return functools.partial(run, loop), lambda: (run(short, plain["probe"]),)
