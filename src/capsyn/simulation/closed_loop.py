"""The closed loop of a controller and a plant at a sample rate, for many trials at once.

At every sample ``t = k period`` of a trial, in this order:

1. Exogenous inputs take their values, which they hold until the next sample: they are the last
   components of the state here. A state that is not finite ends the trial. A state in the target
   marks the arrival, and may end the trial.
2. At the last sample the trial ends. Else the state plus measurement noise is what the controller
   sees. Outside the policy's domain, the policy's rule holds: the trial ends, or goes on with the
   nearest cell or the safe symbol, and the sample is counted.
3. A symbol that differs from the one in force is taken only when that has been held for its least
   time, rounded up to whole samples. Where inputs have least times of their own, those that are yet
   held keep their values and the others take theirs, if that changes any and there is such a symbol
   that may follow; else the symbol in force stays. That of a measured state that is not finite does
   not wait, nor does that of one outside where the policy says so; it is held anew. Between symbols
   of the same control is no switch, unless it has a price.
4. The plant gets the control after the input delay and holds it; before the first arrives, it
   gets the default control. Between samples the classical Runge-Kutta method is used, with a step
   boundary where the control changes.
"""

from __future__ import annotations

import collections
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from capsyn.controllers.command import NONE, NOT_FINITE, TARGET, TIME, Command, Decide, hold
from capsyn.errors import warn
from capsyn.modelling.switching import SwitchRules
from capsyn.programs.program import Program
from capsyn.simulation.kernel import trial_type
from capsyn.simulation.plant import Plant

SLACK = 1e-9
"""Samples by which a time that should be a whole number of them may be off, by rounding."""
NOISE_BYTES = 1 << 24
"""Size of the noise that a thread draws ahead."""


def warn_of_parts(rules: SwitchRules, period: float, time_unit: str) -> None:
    """Warn where a least time is no whole number of samples of a period [time unit]."""
    times = np.concatenate([rules.holds, rules.input_holds])
    samples = times / period
    off = np.abs(samples - np.rint(samples)) > 1e-6 * np.maximum(samples, 1)
    if off.any():
        k = int(np.argmax(off))
        warn(
            f"a least time of {times[k]:g} {time_unit} is {samples[k]:.4g} samples, and acts as "
            f"{math.ceil(samples[k])}"
        )


@dataclass(frozen=True)
class Holds:
    """What a change of symbols must wait for. Of controllers without symbols N is 0."""

    symbols: np.ndarray  # (N + 1,) ints: samples that each is held once entered, the default last
    inputs: np.ndarray  # (m,) ints: samples that each input is held once it has changed
    kinds: np.ndarray  # (N + 1,) ints, equal where a change is no switch
    forbidden: np.ndarray  # (N + 1, N + 1) bool: transitions, from each to each
    controls: np.ndarray  # (N + 1, m): of the symbols [input units]

    @staticmethod
    def of(rules: SwitchRules, period: float) -> Holds:
        """Return what changes wait for by rules, in samples of a period [time unit].

        Of an infinite period there are no least times.
        """

        def whole(times: np.ndarray) -> np.ndarray:
            return np.ceil(np.minimum(times / period - SLACK, 2.0**40)).astype(np.int64)

        holds, inputs = whole(rules.holds), whole(rules.input_holds)
        return Holds(holds, inputs, rules.kinds, rules.forbidden, rules.controls)

    @property
    def any(self) -> bool:
        """Whether anything waits."""
        return bool(self.symbols.any() or self.inputs.any())

    def permitted(
        self, now: np.ndarray, wanted: np.ndarray, held: np.ndarray, held_inputs: np.ndarray
    ) -> np.ndarray:
        """Return the labels (B,) that are taken while `now` (B,) are in force and others wanted.

        `held` (B,) and `held_inputs` (B, m) are the samples that symbols and inputs have been held.
        """
        stays = (held < self.symbols[now]) | self.forbidden[now, wanted]
        taken = np.where(stays, now, wanted)
        if not self.inputs.any():
            return taken
        own, other = self.controls[now], self.controls[taken]
        lock = held_inputs < self.inputs
        mixed = np.where(lock, own, other)
        for b in np.flatnonzero((mixed != other).any(axis=1)):
            same = (self.controls[:-1] == mixed[b]).all(axis=1) & ~self.forbidden[now[b], :-1]
            moves = same.any() and (mixed[b] != own[b]).any()
            taken[b] = np.argmax(same) if moves else now[b]
        return taken


@dataclass(frozen=True)
class Loop:
    """How the closed loop runs."""

    period: float  # sample time [time unit]
    samples: int  # samples to go; a trial has one state more
    substeps: int  # Runge-Kutta steps between samples
    holds: Holds  # what a change waits for
    outside_at_once: bool  # whether the symbol of a state outside does not wait for that
    inside: Program  # x -> whether it is in the target
    stop_at_target: bool  # whether arriving ends a trial
    idle: np.ndarray  # (m,) control before the first command arrives [input units]
    pushes: np.ndarray | None = (
        None  # (samples, n) added to the rates, held [state units / time unit]
    )
    told: np.ndarray | None = None  # (samples + 1, k) exogenous inputs, NaN where one stays
    paid: np.ndarray | None = None  # (N + 1, N + 1) cost of a sample, by label before and taken


@dataclass(frozen=True)
class Record:
    """Where a run writes every sample of B trials, if it does; see `new_record`."""

    states: np.ndarray  # (B, samples + 1, n), NaN after the end of a trial
    costs: np.ndarray  # (B, samples + 1), likewise
    symbols: np.ndarray  # (B, samples), `NONE` after the end
    controls: np.ndarray  # (B, samples, m), NaN after the end


def new_record(count: int, samples: int, n: int, m: int) -> Record:
    """Return a record of `count` trials, empty."""
    return Record(
        np.full((count, samples + 1, n), np.nan),
        np.full((count, samples + 1), np.nan),
        np.full((count, samples), NONE, dtype=np.int64),
        np.full((count, samples, m), np.nan),
    )


def new_trials(
    states: np.ndarray,
    m: int,
    delays: np.ndarray,
    parameters: np.ndarray,
    push: np.ndarray,
    period: float,
) -> np.ndarray:
    """Return trials (B,) before their first sample, as records of `trial_type`.

    They begin at states (B, n), to whose rates `push` (B, n) is added, with input delays (B,) and
    parameters (B, P) of the plant; there are m inputs, and a sample takes `period` [time unit].
    """
    whole = np.floor(delays / period + SLACK)
    rest = delays - whole * period
    rest[rest < SLACK * period] = 0.0
    queue = 2 ** math.ceil(math.log2(max(whole.max(initial=0) + 2, 2)))
    trials = np.zeros(len(states), trial_type(states.shape[1], m, parameters.shape[1], int(queue)))
    trials["state"], trials["push"], trials["parameters"] = states, push, parameters
    trials["delay"], trials["rest"] = whole, rest
    trials["symbol"], trials["end"], trials["arrived"], trials["away"] = NONE, -1, -1, -1
    return trials


@dataclass(frozen=True)
class Noise:
    """Gaussian measurement noise, from a stream of its own for each of B trials."""

    deviations: np.ndarray  # (B, n) standard deviations [state units]
    seeds: Sequence[Sequence[int]]  # (B,) of the streams

    def draw(self, start: int, stop: int) -> Callable[[int], np.ndarray]:
        """Return what draws the next samples (stop - start, samples, n) of some trials."""
        streams = [np.random.default_rng(seed) for seed in self.seeds[start:stop]]
        deviations = self.deviations[start:stop, None, :]
        n = deviations.shape[2]

        def next_samples(samples: int) -> np.ndarray:
            normal = np.empty((len(streams), samples, n))
            for values, stream in zip(normal, streams):
                stream.standard_normal(out=values)
            return normal * deviations

        return next_samples


def run(
    decide: Decide,
    plant: Plant,
    loop: Loop,
    trials: np.ndarray,
    noise: Noise | None,
    record: Record | None,
) -> None:
    """Run trials under any controller, in place, by NumPy on all of them at once."""
    count, last = len(trials), loop.samples
    length = trials.dtype["queue"].shape[0]
    idle = hold(np.tile(loop.idle, (count, 1)))
    queue = collections.deque([(idle.controls, idle.ends)] * length, maxlen=length)  # newest last
    chunk = max(1, NOISE_BYTES // (8 * max(count, 1) * plant.n))
    draw = noise.draw(0, count) if noise else None
    drawn = np.zeros((count, 0, plant.n))
    for k in range(last + 1):
        live = np.flatnonzero(trials["end"] < 0)
        if not len(live):
            return
        if loop.told is not None:
            changes = np.flatnonzero(~np.isnan(loop.told[k]))
            first = plant.n - loop.told.shape[1]
            trials["state"][live[:, None], first + changes] = loop.told[k, changes]
        if draw and k < last and k % chunk == 0:
            drawn = draw(min(chunk, last - k))
        ended = _look(loop, trials, live, k)
        before = np.maximum(trials["symbol"], -1)
        see = ended == TIME
        if k < last and see.any():
            measured = trials["state"][live[see]]
            if draw:
                measured = measured + drawn[live[see], k % chunk]
            command = decide(k * loop.period, measured, trials["symbol"][live[see]])
            at_once = ~np.isfinite(measured).all(axis=1) | (command.outside & loop.outside_at_once)
            queue.append(_take(loop, trials, live[see], command, at_once, *queue[-1]))
            ended[see] = command.ended
        done = (ended != TIME) | (k == last)
        trials["ended"][live] = ended
        trials["end"][live[done]] = k
        if record:
            record.states[live, k] = trials["state"][live]
            record.costs[live, k] = trials["cost"][live]
        live = live[~done]
        if not len(live):
            continue
        if loop.paid is not None:
            taken = np.maximum(trials["symbol"][live], -1)
            trials["cost"][live] += loop.paid[before[live], taken]
        if record:
            record.symbols[live, k] = trials["symbol"][live]
            record.controls[live, k] = queue[-1][0][live, 0]
        delays = trials["delay"][live]
        for delay in np.unique(delays):
            rows = live[delays == delay]
            _move(plant, loop, trials, rows, k, queue[-2 - delay], queue[-1 - delay])


def _look(loop: Loop, trials: np.ndarray, live: np.ndarray, k: int) -> np.ndarray:
    """Do what needs the state alone at sample k; return why each live trial ends, or `TIME`."""
    states = trials["state"][live]
    ended = np.where(np.isfinite(states).all(axis=1), TIME, NOT_FINITE)
    condition = loop.inside.evaluate(states.T)[0][0]
    inside = (condition != 0) & np.isfinite(condition) & (ended == TIME)
    trials["arrived"][live[inside & (trials["arrived"][live] < 0)]] = k
    trials["away"][live[~inside]] = k
    if loop.stop_at_target:
        ended[inside] = TARGET
    return ended


def _take(
    loop: Loop,
    trials: np.ndarray,
    see: np.ndarray,
    command: Command,
    at_once: np.ndarray,
    controls: np.ndarray,
    ends: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what the queue gets: the command of the trials `see`, dwell time allowing.

    It does not wait for that `at_once`.
    """
    trials["outside"][see] += command.outside
    good, holds = command.ended == TIME, loop.holds
    live, wanted, until = see[good], command.controls[good], command.ends[good]
    symbols, now = command.symbols[good], trials["symbol"][live]
    if holds.any:  # no second control within a sample: the first is held
        wanted, until = wanted[:, :1], np.full((len(live), 1), np.inf)
    held, own = trials["held"][live], trials["control"][live]
    first = held == 0
    changes = (wanted[:, 0] != own).any(axis=1)
    known = ~first & (now >= -1) & (symbols >= -1) & (len(holds.symbols) > 1)
    changes[known] |= holds.kinds[symbols[known]] != holds.kinds[now[known]]
    wait = changes & ~first & ~at_once[good]
    if (asked := wait & known).any():
        labels = len(holds.symbols) - 1
        before, after = (np.where(s < 0, labels, s)[asked] for s in (now, symbols))
        locks = trials["held_inputs"][live[asked]]
        taken = holds.permitted(before, after, held[asked], locks)
        symbols[asked] = np.where(taken == labels, -1, taken)
        wanted[asked, 0] = np.where(
            (taken == after)[:, None], wanted[asked, 0], holds.controls[taken]
        )
        changes[asked] = holds.kinds[taken] != holds.kinds[before]
    stay = wait & ~known & (held < holds.symbols[-1])
    changes &= ~stay
    symbols = np.where(stay, now, symbols)
    wanted = np.where(stay[:, None, None], own[:, None], wanted)
    trials["held"][live] = np.where(changes | first, 1, held + 1)
    trials["symbol"][live] = symbols
    moved = (wanted[:, 0] != own) | first[:, None]
    trials["held_inputs"][live] = np.where(moved, 1, trials["held_inputs"][live] + 1)
    current, time = trials["control"][live], np.zeros(len(live))
    for piece in range(wanted.shape[1]):
        acts = np.minimum(until[:, piece], loop.period) > time
        moves = (wanted[:, piece] != current).any(axis=1) if piece else changes & ~first
        trials["switches"][live] += acts & moves
        current = np.where(acts[:, None], wanted[:, piece], current)
        time = np.maximum(time, until[:, piece])
    trials["control"][live] = current
    count, pieces = len(trials), wanted.shape[1]
    if controls.shape[1] != pieces:  # the idle control before the first command
        controls, ends = np.repeat(controls, pieces, axis=1), np.full((count, pieces), np.inf)
    controls, ends = controls.copy(), ends.copy()
    controls[live], ends[live] = wanted, until
    return controls, ends


def _move(
    plant: Plant,
    loop: Loop,
    trials: np.ndarray,
    live: np.ndarray,
    k: int,
    before: tuple[np.ndarray, np.ndarray],
    now: tuple[np.ndarray, np.ndarray],
) -> None:
    """Integrate trials of one delay over a sample: the rest of a command, then the next one."""
    rest = trials["rest"][live]
    x, cost = trials["state"][live].T, trials["cost"][live]
    p = trials["parameters"][live].T
    push = trials["push"][live].T + (0.0 if loop.pushes is None else loop.pushes[k][:, None])
    for (controls, ends), start, stop in (
        (before, loop.period - rest, np.full(len(live), loop.period)),
        (now, np.zeros(len(live)), loop.period - rest),
    ):
        for piece in range(ends.shape[1]):
            time = np.minimum(ends[live, piece], stop) - start
            start = np.maximum(start, ends[live, piece])
            if (time > 0).any():
                u = controls[live, piece].T
                trials["effort"][live] += (u * u).sum(axis=0) * np.maximum(time, 0.0)
                trials["fuel"][live] += np.abs(u).sum(axis=0) * np.maximum(time, 0.0)
                x, cost = plant.advance(x, cost, u, p, push, np.maximum(time, 0.0), loop.substeps)
    trials["state"][live], trials["cost"][live] = x.T, cost
