"""Proofs about the sampled loop of a policy from a set of starts: `certify`."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from capsyn.certification.certificate import Certificate, ProvedCells
from capsyn.certification.proof_file import ArrivalProof
from capsyn.certification.question import Asked, Question, halved, question
from capsyn.certification.refute import refute
from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.modelling.domain import Ball, Box
from capsyn.policies.policy import Policy
from capsyn.reach.arrive import Arrival, arrive, in_target, inside
from capsyn.reach.kernel import Cells, Follower
from capsyn.reach.stay import Staying, stay
from capsyn.validation import finite_number, whole_number

SECONDS, STAY_SECONDS = 60.0, 3.0
"""How long arrival and staying are tried unless told [s]."""
STAY_SHARE = 0.25
"""Share for staying of a time that is told."""
MOST = 100_000
"""Most cells that are taken instead of larger ones."""
FINEST = 4096
"""Most cells along an axis that are proposed for a target."""


def certify(
    policy: Policy,
    initial: Ball | Box | None = None,
    target: Any = None,
    avoid: Any = None,
    *,
    tolerance: float | None = None,
    rate: float | None = None,
    delay: float | None = None,
    noise: Any = None,
    parameters: Mapping[str, Any] | None = None,
    exogenous: Any = None,
    model: Any = None,
    min_dwell: float | None = None,
    counts: Any = None,
    seconds: float | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> Certificate:
    """Return what is proved about the sampled loop of a policy from a set of starts.

    The proof encloses every loop that begins at a sample in a state of `initial`, with the default
    control in force. The enclosure lasts until the loop arrives, and from the target on for ever.
    Rounding, sensor error and unknown parameters are included. See the guide "What is proved, and
    what is not".

    Parameters
    ----------
    policy : Policy
        A policy of cells, or a `DecisionTree`. The proof is about its own symbols. The policy's
        model is the plant.
    initial : Ball or Box, optional
        The set of starts [state units]. Default: the domain.
    target, tolerance : as in `capsyn.monte_carlo`
        The states at which loops must arrive. Default: the policy's own target.
    avoid : Ball, Box or callable ``x -> true or false``, optional
        States that no loop may ever reach, also between samples.
    rate : float, optional
        Samples per time unit. Default: 1 over the sample time of the policy's settings.
    delay : float, optional
        Time from a sample until its control acts [time unit], at most one sample. Default: the
        problem's own delay.
    noise : float or (n,), optional
        Largest error of a measured state [state units]. The error may differ from sample to sample.
    parameters : mapping of name to float or (low, high), optional
        The components of the model's `p`, in order. The components may take any values in these
        ranges, constant or not.
    exogenous : mapping of name to float or (low, high), or (k,), optional
        Exogenous inputs, constant along a loop. An input that is not given may be anywhere in its
        box.
    model, min_dwell : as in `capsyn.simulate`
    counts : int or n ints, optional
        Cells of the proof along each axis. Default: 72 of two axes, 24 of three, 12 of four.
    seconds : float, optional
        Time after which the proof stops [s]. What is proved by then stays proved, also after
        Ctrl-C. Default: 60.
    seed : int
        Seed of the simulated loops.
    threads : int, optional
        Number of threads. Default: one per processor.

    Raises
    ------
    ProblemError
        An argument that cannot be used. Or the policy has no model or no target. Or no cell fits
        into the target. Or the grid does not fit the memory.
    KernelBuildError
        There is no C compiler.
    """
    began = time.monotonic()
    told = None if seconds is None else finite_number("seconds", seconds, above=0.0)
    seed = whole_number("seed", seed, least=0)
    asked = question(
        policy,
        Asked(
            initial, target, tolerance, avoid, rate, delay, noise, parameters, exogenous, model,
            min_dwell, counts,
        ),
        threads,
        seed,
    )  # fmt: skip
    _check_target(asked)
    deadline = began + (SECONDS if told is None else (1 - STAY_SHARE) * told)
    asked, arrival = _arrival(asked, processors(threads), deadline, counts is None)
    staying, stopped = None, arrival.stopped
    try:
        late = time.monotonic() + STAY_SECONDS if told is None else began + told
        staying = stay(asked.loop, processors(threads), late)
        open_cells = np.flatnonzero((asked.starts > 0) & (arrival.share < 1))
        refuted = refute(asked, open_cells)
    except KeyboardInterrupt:
        stopped, refuted = True, refute(asked, np.empty(0, dtype=int))
    return _certificate(asked, arrival, staying, refuted, time.monotonic() - began, stopped)


def _arrival(
    asked: Question, threads: int, deadline: float, finer: bool
) -> tuple[Question, Arrival]:
    """Return what is proved to arrive; `finer` cells are taken where larger ones are in vain."""
    while True:
        patient = not finer or (2 ** int((asked.cells.counts > 1).sum()) * asked.cells.total > MOST)
        follower = Follower.build(asked.loop, asked.cells, threads, deadline)
        when = simulated_arrival(asked)
        arrival = arrive(follower, when, asked.starts, asked.box, deadline, patient)
        if arrival is not None:
            return asked, arrival
        asked = halved(asked)


def simulated_arrival(asked: Question) -> np.ndarray:
    """Return when a simulated loop arrives from the middle of each cell (K,) [time unit]."""
    lower, upper = asked.cells.boxes(np.arange(asked.cells.total))
    trials, _ = asked.simulated((lower + upper) / 2)
    return np.where(trials["arrived"] < 0, np.inf, trials["arrived"] / asked.experiment.rate)


def _check_target(asked: Question) -> None:
    """Raise unless some cell is in the target, and that is not all to be avoided."""
    counts = asked.cells.counts.copy()
    while True:
        cells = Cells(asked.cells.lower, asked.cells.upper, counts)
        surely = inside(asked.loop.target, *cells.boxes(np.arange(cells.total)))[0]
        if surely.any() or (counts * 2 > FINEST).any() or 4 * cells.total > 1 << 24:
            break
        counts = counts * 2
    if not surely.any():
        raise ProblemError(
            "`target` must be a set that a cell fits into; none does, of "
            f"{' x '.join(map(str, counts))} cells either"
        )
    if (counts != asked.cells.counts).any():
        raise ProblemError(
            "`target` must be a set that a cell fits into; none of "
            f"{' x '.join(map(str, asked.cells.counts))} does, some of `counts` "
            f"{', '.join(map(str, counts))} do"
        )
    if not in_target(asked.loop, asked.cells).any():
        raise ProblemError("`avoid` must leave some of the target; it covers all of it")


def _meets(
    lower: np.ndarray, upper: np.ndarray, swing: tuple[np.ndarray, np.ndarray], space: Box
) -> np.ndarray:
    """Return which boxes (B, n) meet one, on a periodic axis a period on or back, too."""
    meets = np.ones(len(lower), bool)
    for i, period in enumerate(space.periods):
        turns = np.arange(-2, 3) * period if period else np.zeros(1)
        low, high = swing[0][i] + turns[:, None], swing[1][i] + turns[:, None]
        meets &= ((upper[:, i] >= low) & (lower[:, i] <= high)).any(axis=0)
    return meets


def _certificate(
    asked: Question,
    arrival: Arrival,
    staying: Staying | None,
    refuted: tuple[np.ndarray, tuple[str, ...], np.ndarray],
    seconds: float,
    stopped: bool,
) -> Certificate:
    n, starts = asked.loop.space.n, asked.starts
    if isinstance(asked.initial, Ball):  # what of a part is in it is not known
        arrival = dataclasses.replace(arrival, share=np.where(arrival.share < 1, 0.0, 1.0))
    states, failures, home = refuted
    total = starts.sum()
    failed = np.zeros(asked.cells.total, bool)
    failed[home] = True
    failed &= arrival.share < 1
    arrives = float((arrival.share * starts).sum() / total)
    left = np.where(failed, 0.0, (1 - arrival.share) * starts)
    lower, upper = asked.cells.boxes(np.arange(asked.cells.total))
    nothing = np.full((n, 2), np.nan)
    stays = np.zeros(asked.cells.total, bool)
    if staying is not None:
        stays = _meets(lower, upper, staying.swing, asked.loop.space)
    return Certificate(
        conditions=asked.conditions,
        method="pieces" if n == 2 else "boxes",
        cells=ProvedCells(
            asked.loop.space,
            tuple(asked.cells.counts.tolist()),
            starts,
            arrival.share,
            arrival.within,
            stays,
            failed,
        ),
        arrival=arrives,
        staying=arrives if staying is not None else 0.0,
        avoiding=arrives if staying is not None else 0.0,
        within=float(arrival.latest) if arrives > 0 else math.nan,
        switch_rate=math.nan if staying is None else staying.switch_rate,
        ripple=nothing if staying is None else np.stack(staying.ripple, axis=1),
        refuted=states,
        failures=failures,
        open=float(left.sum() / total),
        seconds=seconds,
        stopped=stopped,
        proof=ArrivalProof(asked, arrival),
    )
