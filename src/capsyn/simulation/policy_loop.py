"""The closed loop of a policy, compiled where there is a compiler."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from capsyn.controllers.command import LEFT_DOMAIN, NONE, NOT_FINITE, TIME, Command, Decide, hold
from capsyn.modelling.alphabet import Outside
from capsyn.native.compiled import compiled
from capsyn.policies.lookup import TreeArguments
from capsyn.policies.policy import Policy
from capsyn.simulation.closed_loop import NOISE_BYTES, Loop, Noise, Record, run
from capsyn.simulation.kernel import SIMULATION_LANES, LoopArguments, SimulationKernel
from capsyn.simulation.plant import Plant


def run_policy(
    policy: Policy,
    outside: Outside,
    plant: Plant,
    loop: Loop,
    trials: np.ndarray,
    noise: Noise | None,
    record: Record | None,
    backend: str,
    threads: int,
) -> None:
    """Run trials under a policy, in place, compiled where there is a compiler."""
    kernel = None
    if policy.cells.compiled:
        kernel = compiled(lambda: simulation_kernel(plant, loop, trials), backend, "simulating")
    if kernel is None:
        run(policy_decide(policy, outside), plant, loop, trials, noise, record)
    else:
        run_compiled(kernel, policy, outside, loop, trials, noise, record, threads)


def simulation_kernel(plant: Plant, loop: Loop, trials: np.ndarray) -> SimulationKernel:
    """Return the kernel that runs trials of this kind; `KernelBuildError` if it fails."""
    queue = trials.dtype["queue"].shape[0]
    discrete = plant.sample_time is not None
    return SimulationKernel.build(*plant.in_loops, loop.inside, queue, discrete)


def policy_decide(policy: Policy, outside: Outside) -> Decide:
    """Return the decision of a policy under an out-of-domain rule."""

    def decide(time: float, measured: np.ndarray, in_force: np.ndarray) -> Command:
        finite = np.isfinite(measured).all(axis=1)
        now = np.where(in_force < 0, len(policy.alphabet), in_force).astype(np.int32)
        leaves = policy.leaves(measured, outside == "nearest", "numpy", now)
        lost = leaves < 0
        out = lost | ~policy.space.contains(measured)
        symbols = np.where(lost, outside if isinstance(outside, int) else -1, leaves)
        symbols[symbols == len(policy.alphabet)] = -1
        ended = np.full(len(measured), TIME)
        if isinstance(outside, str):
            ended[lost] = LEFT_DOMAIN
            ended[~finite] = NOT_FINITE
        return dataclasses.replace(
            hold(policy.controls[symbols], symbols), ended=ended, outside=out
        )

    return decide


def run_compiled(
    kernel: SimulationKernel,
    policy: Policy,
    outside: Outside,
    loop: Loop,
    trials: np.ndarray,
    noise: Noise | None,
    record: Record | None,
    threads: int,
    choices: Callable[[int], Any] | None = None,
) -> None:
    """Run trials by a kernel, in place.

    `choices` gives what a chooser needs for the trials from a number on, see `SimulationKernel`.
    """
    n, symbols = policy.space.n, len(policy.alphabet)
    table = policy.controls
    tree = TreeArguments.of(policy.space, policy.cells)
    rule = -1 if isinstance(outside, str) else outside % (symbols + 1)
    error = outside == "error"
    holds = loop.holds
    arrays = {
        "controls": table,
        "holds": np.ascontiguousarray(holds.symbols, dtype=np.int64),
        "kinds": np.ascontiguousarray(holds.kinds, dtype=np.int64),
        "forbidden": np.ascontiguousarray(holds.forbidden, dtype=np.uint8),
    }
    if holds.inputs.any():
        arrays["inputs"] = np.ascontiguousarray(holds.inputs, dtype=np.int64)
    if loop.told is not None:
        arrays["told"] = np.ascontiguousarray(loop.told)
    if loop.paid is not None:
        arrays["paid"] = np.ascontiguousarray(loop.paid)
    if len(policy.transitions) > symbols + 1:
        arrays["transitions"] = np.ascontiguousarray(policy.transitions)
    arguments = LoopArguments(
        loop.period, loop.substeps, loop.samples, error, rule, loop.stop_at_target, symbols,
        loop.outside_at_once, gap=symbols if policy.gaps else -1, cells=tree,
        exogenous=policy.space.n - policy.domain.n,
        **{name: array.ctypes.data for name, array in arrays.items()},
    )  # fmt: skip

    def part(bounds: tuple[int, int]) -> None:
        start, stop = bounds
        draw = noise.draw(start, stop) if noise else None
        chunk = max(1, NOISE_BYTES // (8 * (stop - start) * n)) if noise else loop.samples
        chosen = None if choices is None else choices(start)
        for first in range(0, loop.samples, chunk):
            samples = min(chunk, loop.samples - first)
            pushes = None if loop.pushes is None else loop.pushes[first : first + samples]
            kept = (record.states, record.symbols, record.costs) if record else (None,) * 3
            views = [None if a is None else a[start:stop] for a in kept]
            own = trials[start:stop]
            kernel(own, first, samples, arguments, draw and draw(samples), pushes, views, chosen)

    trials["symbol"][trials["symbol"] == -1] = symbols
    blocks = -(-len(trials) // SIMULATION_LANES)
    size = max(1, -(-blocks // threads)) * SIMULATION_LANES
    parts = [(k, min(k + size, len(trials))) for k in range(0, len(trials), size)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(part, parts))
    trials["symbol"][trials["symbol"] == symbols] = -1
    if record:
        record.symbols[record.symbols == symbols] = -1
        known = record.symbols != NONE
        record.controls[known] = table[record.symbols[known]]
