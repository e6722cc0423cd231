"""Golden sequences: readings one after the other, with the symbols that must then be in force."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capsyn.exports.golden import Found, table
from capsyn.exports.plan import Plan
from capsyn.random_streams import stream
from capsyn.simulation.closed_loop import SLACK, Holds

SEQUENCE = 8
"""Purpose of the random readings."""
RUNS, STEPS = 16, 250
"""Sequences, each from a new start, and their steps."""
IN_A_HOLD = 4
"""Steps in the shortest of all least times."""
JUMPS, WIDE = 0.1, 0.05
"""Share of the steps at which the state is drawn anew, and of the domain's widths that it moves at
others, at most."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """Runs of readings (S, K, n), one every `period` [time unit], from a start each.

    `wanted` (S, K) are the labels that decisions give with those in force, `labels` (S, K) those in
    force after them, `statuses` (S, K) the decisions' statuses.
    """

    period: float
    readings: np.ndarray
    wanted: np.ndarray
    labels: np.ndarray
    statuses: np.ndarray

    def to_csv(self, plan: Plan) -> bytes:
        """Return the runs as CSV, one after the other: run, step, readings, symbol, status."""
        runs, steps, n = self.readings.shape
        first = {
            "run": np.repeat(np.arange(runs), steps),
            "step": np.tile(np.arange(steps), runs),
        }
        last = {"symbol": self.labels.ravel(), "status": self.statuses.ravel()}
        lines = table(plan, self.readings.reshape(-1, n), first, last).decode().split("\n")
        told = f"# A step every {self.period!r} {plan.policy.time_unit}; each run from a new start"
        return "\n".join([*lines[: len(plan.header)], told, *lines[len(plan.header) :]]).encode()


def golden_sequence(plan: Plan, runs: int = RUNS, steps: int = STEPS, seed: int = 0) -> Sequence:
    """Return runs that go through the domain, jump, leave it, and lose readings now and then."""
    policy, n = plan.policy, plan.n
    rng = stream(seed, SEQUENCE)
    widths, lower = policy.space.widths, policy.space.lower
    moves = WIDE * (2 * rng.random((steps, runs, n)) - 1)
    anew = 1.2 * rng.random((steps, runs, n)) - 0.1
    jumps = rng.random((steps, runs)) < JUMPS
    jumps[0] = True
    place, places = anew[0], np.empty((steps, runs, n))
    for k in range(steps):
        place = places[k] = np.where(
            jumps[k, :, None], anew[k], np.clip(place + moves[k], -0.1, 1.1)
        )
    with np.errstate(over="ignore"):
        readings = (lower + places * widths - plan.offset) / plan.scale
    lost = rng.random((steps, runs)) < 0.01
    readings[lost, rng.integers(n, size=int(lost.sum()))] = np.nan
    return run(plan, np.moveaxis(readings, 0, 1), step_period(plan))


def step_period(plan: Plan) -> float:
    """Return the time from step to step [time unit]."""
    rules = plan.policy.rules
    times = [t for t in (*rules.holds, *rules.input_holds, plan.hold_off) if t > 0]
    if not times:
        settings = plan.policy.settings
        return 1.0 if settings is None else settings.period
    return float(min(times)) / IN_A_HOLD


def holds_of(plan: Plan, period: float) -> Holds:
    """Return what changes of labels wait for, in steps of a period [time unit]."""
    return Holds.of(plan.policy.rules, period)


def run(plan: Plan, readings: np.ndarray, period: float) -> Sequence:
    """Return what an export must give for runs of readings (S, K, n), a period apart.

    The rule is that of capsyn's closed loop. During the hold-off the safe symbol is in force, which
    counts as entered at the start.
    """
    holds = holds_of(plan, period)
    runs, steps, n = readings.shape
    found = Found.of(plan, np.swapaxes(readings, 0, 1).reshape(-1, n))
    off = math.ceil(plan.hold_off / period - SLACK)
    wanted, labels, statuses = np.empty((3, runs, steps), dtype=np.int64)
    now = np.full(runs, plan.default)
    started = np.zeros(runs, dtype=bool)
    held, held_inputs = np.zeros(runs, dtype=np.int64), np.zeros((runs, holds.controls.shape[1]))
    for k in range(steps):
        decided, statuses[:, k] = found.at(slice(k * runs, (k + 1) * runs)).decide(plan, now)
        asked = np.where(k < off, plan.safe, decided)
        at_once = np.isin(statuses[:, k], plan.at_once)
        permitted = holds.permitted(now, asked, held, held_inputs)
        same = holds.kinds[asked] == holds.kinds[now]
        taken = np.where(at_once | same | ~started, asked, permitted)
        changed = (holds.kinds[taken] != holds.kinds[now]) | ~started
        moved = (holds.controls[taken] != holds.controls[now]) | ~started[:, None]
        held = np.where(changed, 1, held + 1)
        held_inputs = np.where(moved, 1, held_inputs + 1)
        wanted[:, k], labels[:, k] = asked, taken
        now, started = taken, np.ones(runs, dtype=bool)
    return Sequence(period, readings, wanted, labels, statuses)
