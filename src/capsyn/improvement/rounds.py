"""Rounds of improvement: each begins with the policy that the one before it made."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import PriceRatios
from capsyn.errors import ProblemError
from capsyn.improvement.charged_loop import ChargedLoop
from capsyn.improvement.judged import Comparison
from capsyn.improvement.refits import NOTHING_TO_FIT, Refits, cheaper
from capsyn.improvement.rollouts import Rollouts
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.targets import placed
from capsyn.policies.policy import Policy
from capsyn.random_streams import derived_seed
from capsyn.subdivision.lattice_points import Progress
from capsyn.subdivision.plan import SubdivisionPlan
from capsyn.subdivision.subdivide import Labelling, carry_out

CHOICE, JUDGE, FITS = 1, 2, 3
"""Purposes of seeds: starts that choose a horizon, that judge a round, and that tails fit."""


@dataclass(frozen=True)
class Round:
    """What one round of `improve` did.

    Parameters
    ----------
    round : int
        Number of the round, from 1.
    horizon : float
        Horizon of the rollouts [time unit].
    terminal : bool
        Whether the rollouts end with the policy's terminal cost.
    fitted : bool
        Whether the round used fitted tails in place of rollouts. `horizon` is then the policy's
        horizon.
    result : Comparison
        Comparison of the policy before the round with the policy of the round, by starts that no
        choice saw.
    cells, solves : int
        Cells and solves of the policy that the round made.
    seconds : float
        Time that the round took [s].
    """

    round: int
    horizon: float
    terminal: bool
    fitted: bool
    result: Comparison
    cells: int
    solves: int
    seconds: float

    @property
    def kept(self) -> bool:
        """Whether the policy that the round made is surely better."""
        return self.result.better

    def to_json(self) -> dict[str, Any]:
        """Return the round as plain data, in one level."""
        plain = dataclasses.asdict(self)
        return plain | plain.pop("result") | {"kept": self.kept}


@dataclass(frozen=True)
class Tried:
    """A policy of rollouts over some horizon, and what some starts cost with it."""

    horizon: float
    terminal: bool
    policy: Policy
    costs: np.ndarray


@dataclass(frozen=True, eq=False)
class Rounds:
    """What rounds have in common."""

    loop: ChargedLoop  # of the given policy
    plan: SubdivisionPlan
    horizons: Sequence[float]  # of the ladder [time unit]
    samples: int  # of a closed loop that judges
    initial: Ball | Box | None
    starts: int
    confidence: float
    seed: int
    refits: Refits | None  # fitted tails, in the place of rollouts
    known: dict[str, float]  # what the next improvement of the policy needs
    progress: Callable[[str], None] | None

    def run(self, rounds: int) -> tuple[Policy, tuple[Round, ...], Comparison]:
        """Return the best policy of so many rounds, what they did, and all of them together.

        All together are judged by starts of their own, where there is more than one that is kept.
        """
        policy, done = self.loop.policy, list[Round]()
        for number in range(1, rounds + 1):
            began = time.perf_counter()
            best = self._best(policy, number)
            result = self.compared(policy, best.policy, number)
            done.append(
                Round(
                    number,
                    best.horizon,
                    best.terminal,
                    self.refits is not None,
                    result,
                    best.policy.cells.leaf_count,
                    best.policy.statistics["solves"],
                    time.perf_counter() - began,
                )
            )
            if not result.better:
                break
            policy = self._with_history(policy, best.policy, done[-1])
        kept = [one for one in done if one.kept]
        if len(kept) == 1:
            return policy, tuple(done), kept[0].result
        return policy, tuple(done), self.compared(self.loop.policy, policy, rounds + 1)

    def _best(self, policy: Policy, number: int) -> Tried:
        """Return the best policy of the ladder, and of rollouts to the terminal cost.

        That with a fitted tail is chosen as `Refits` do.
        """
        best, less = None, _less if self.refits is None else cheaper
        for tried in self._candidates(policy, number):
            if best is None or less(tried.costs, best.costs):
                best = tried
        if best is None:
            raise ProblemError(NOTHING_TO_FIT)
        return best

    def _candidates(self, policy: Policy, number: int) -> Iterator[Tried]:
        """Yield policies of rollouts, or of tails that are fitted, over the horizons."""
        if self.refits is not None:
            refits = dataclasses.replace(self.refits, seed=derived_seed(self.seed, number, FITS))
            for horizon in self.horizons:
                samples = float(max(1, round(horizon / self.loop.loop.period)))
                own = samples if policy.discrete else horizon
                for _, made in refits.candidates(policy, own):
                    yield Tried(horizon, False, made, refits.judged(made))
            return
        states = self._states(number, CHOICE)
        ways = [(horizon, False) for horizon in self.horizons]
        if self.loop.end is not None:
            ways.append((self.horizons[len(self.horizons) // 2], True))
        for horizon, terminal in ways:
            yield self._tried(policy, number, horizon, terminal, states)

    def _tried(
        self, policy: Policy, number: int, horizon: float, terminal: bool, states: np.ndarray
    ) -> Tried:
        """Return the policy of rollouts of another one, over a horizon."""
        loop = dataclasses.replace(
            self.loop, policy=policy, end=self.loop.end if terminal else None
        )
        rollouts = Rollouts.of(loop, max(2, round(horizon / loop.loop.period)))
        plan = self.plan
        text = f"round {number}, horizon {horizon:g} {policy.time_unit}"

        def progress(now: Progress) -> None:
            if self.progress is not None:
                self.progress(f"{text}: level {now.level}, {now.total:,} solves")

        labelling = Labelling(
            rollouts.scored if plan.affine else lambda states: rollouts.scored(states)[0],
            "masks+scores" if plan.affine else "masks",
            threads=loop.threads,
            progress=progress,
            in_force=rollouts.in_force,
            prices=PriceRatios.of(loop.prices) if rollouts.in_force > 1 else None,
        )
        made = carry_out(plan, labelling, policy.space, policy.alphabet, policy.outside)
        settings, period = policy.settings or SsacSettings(), loop.plant.sample_time
        new = dataclasses.replace(
            policy,
            cells=made.cells,
            transitions=made.transitions,
            statistics=made.statistics,
            timings=made.timings,
            evidence={},
            horizon=None,
            settings=dataclasses.replace(settings, sample_time=period or loop.loop.period),
        )
        return Tried(horizon, terminal, new, self._costs(new, states))

    def compared(self, before: Policy, after: Policy, number: int) -> Comparison:
        """Return what the starts that judge a round say of two policies."""
        states = self._states(number, JUDGE)
        return Comparison.of(
            self._costs(before, states), self._costs(after, states), self.confidence
        )

    def _costs(self, policy: Policy, states: np.ndarray) -> np.ndarray:
        """Return what the starts (B, n) cost in closed loop, (B,)."""
        loop = dataclasses.replace(self.loop, policy=policy)
        return loop.costs_from(states, self.samples)

    def _states(self, number: int, purpose: int) -> np.ndarray:
        """Return starts (B, n) of their own for a round and a purpose."""
        policy = self.loop.policy
        states = policy.space.sample(self.starts, derived_seed(self.seed, number, purpose))
        own = derived_seed(self.seed, number, purpose, 1)
        return placed(states, self.initial, policy.domain, own)

    def _with_history(self, before: Policy, policy: Policy, done: Round) -> Policy:
        """Return a policy whose statistics tell the rounds that made it."""
        rounds = before.statistics.get("improve", {}).get("rounds", [])
        told = {k: v for k, v in done.to_json().items() if k not in ("kept", "seconds")}
        rounds = [*rounds, told | {"round": len(rounds) + 1}]
        statistics = policy.statistics | {"improve": self.known | {"rounds": rounds}}
        return dataclasses.replace(policy, statistics=statistics)


def _less(costs: np.ndarray, others: np.ndarray) -> bool:
    """Return whether costs (B,) lose fewer starts than others, or as many and are less."""
    both = np.isfinite(costs) & np.isfinite(others)
    lost, others_lost = np.isinf(costs).sum(), np.isinf(others).sum()
    if lost != others_lost or not both.any():
        return bool(lost < others_lost)
    return math.fsum(costs[both]) < math.fsum(others[both])
