"""From a policy to a better one: rollouts, Algorithm 1 over their labels, and a final test."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.improvement.charged_loop import ChargedLoop
from capsyn.improvement.judged import Comparison
from capsyn.improvement.refits import Refits, plan_like
from capsyn.improvement.rollouts import charged_scale
from capsyn.improvement.rounds import Round, Rounds
from capsyn.modelling.discrete import horizon_time
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.targets import check_initial
from capsyn.policies.policy import Policy, cell_tree
from capsyn.simulation.closed_loop import warn_of_parts
from capsyn.simulation.experiment import sample_count
from capsyn.statistics import check_confidence
from capsyn.validation import (
    BACKENDS,
    describe,
    finite_array,
    finite_number,
    one_of,
    whole_number,
)

MOST_STATES = 4
"""Most states of a policy that rollouts improve: beyond, their labels are too rough."""
LADDER, TAIL_LADDER = (0.4, 0.7, 1.0, 1.4, 2.0), (0.25, 0.5)
"""Horizons that are tried, in horizons of the policy, of rollouts and with fitted tails."""
JUDGED = 10.0
"""Time of a closed loop that judges, in horizons of the policy."""
SOLVES = 4
"""Times the solves of the policy that a round may take, where none are given."""


@dataclass(frozen=True, eq=False)
class Improvement:
    """What `improve` returns.

    Parameters
    ----------
    policy : Policy
        The best policy: the policy of the last round that was kept, or the given one.
        ``policy.statistics["improve"]`` lists the rounds that made the policy.
    rounds : tuple of Round
        What each round did.
    result : Comparison
        Costs of starts that no choice saw, under the given policy and under the best one.
    starts : int
        Number of starts that judged each round.
    rate, duration : float
        Rate and time of the closed loops that judged [1 / time unit, time unit].
    scale : float
        Factor by which effort and prices were charged.
    """

    policy: Policy
    rounds: tuple[Round, ...]
    result: Comparison
    starts: int
    rate: float
    duration: float
    scale: float

    @property
    def improved(self) -> bool:
        """Whether the best policy is another one than the given one."""
        return any(one.kept for one in self.rounds)

    def to_json(self) -> dict[str, Any]:
        """Return the rounds as plain data."""
        return {
            "improved": self.improved,
            "starts": self.starts,
            "rate": self.rate,
            "duration": self.duration,
            "scale": self.scale,
            **dataclasses.asdict(self.result),
            "rounds": [one.to_json() for one in self.rounds],
        }

    def __repr__(self) -> str:
        kept, result = sum(one.kept for one in self.rounds), self.result
        told = f"cost {result.before:.4g} to {result.after:.4g}" if kept else "as given"
        return f"Improvement({told}, {kept} of {len(self.rounds)} rounds kept)"


def improve(
    policy: Policy,
    rounds: int = 1,
    *,
    horizons: Any = None,
    rate: float | None = None,
    duration: float | None = None,
    initial: Ball | Box | None = None,
    starts: int = 400,
    confidence: float = 0.95,
    scale: float | None = None,
    max_level: int | None = None,
    max_solves: int | None = None,
    seed: int = 0,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Improvement:
    """Return a better policy by rollouts, if its closed loops surely cost less.

    A rollout holds a symbol for one sample and then follows the present policy for a horizon. The
    cost of the rollout is the symbol's cost at the state. The new policy takes the symbol of least
    cost, by Algorithm 1 on the policy's own grid. Beyond 4 states, labels of rollouts are too
    rough, and the new policy is that of a fitted tail instead; see `fitted_tail`. A round tries a
    ladder of horizons, and chooses the best policy by some starts. Other starts then judge this
    policy. The round is kept if these starts surely cost less, and the next round begins with its
    policy.

    A closed loop costs its running cost, or its terminal cost as a rate if there is no running
    cost. A loop also costs its effort beyond the effort of the cheapest symbol, and for each switch
    the price times a sample. The settings weigh effort and prices against costs over the policy's
    horizon, with its terminal cost. Effort and prices are therefore charged times `scale`, so that
    they weigh as much against the differences between symbols in closed loop.

    Parameters
    ----------
    policy : Policy
        A policy of cells with its model. The policy must not be a decision tree.
    rounds : int
        Largest number of rounds.
    horizons : number or sequence, optional
        Horizons of the rollouts, ascending [time unit], of two samples or more. Default: 0.4 to 2
        times the policy's horizon. With tails, these are horizons of the policies, by default 0.25
        and 0.5 times.
    rate : float, optional
        Samples of the loops per time unit. A rollout holds a symbol for exactly one sample.
        Default: 1 over the sample time of the policy's settings. The settings of the new policy
        have this sample time.
    duration : float, optional
        Time of the closed loops that judge [time unit]. Default: 10 horizons of the policy.
    initial : Ball or Box, optional
        Where the loops start. Default: the domain. Exogenous inputs are drawn from their box, and
        are constant along a loop.
    starts : int
        Number of starts that choose a horizon, and number of other starts that judge a round.
    confidence : float
        Confidence of the intervals by which a round is judged.
    scale : float, optional
        Factor of effort and prices. Default: the factor above, or 1 with tails and if the policy
        does not carry its controller.
    max_level, max_solves : int, optional
        Options of `subdivide`. Default: the policy's own level, and 4 times as many solves as the
        policy took, or as many with tails.
    seed : int
        Seed of the starts.
    backend : "auto", "c" or "numpy"
        How loops are simulated.
    threads : int, optional
        Number of threads. Default: one per processor. The result does not depend on it.
    progress : callable, optional
        A function that is called with a text now and then.

    Returns
    -------
    Improvement
        The best policy and what each round did. If no round surely lowered the cost, the best
        policy is the given one.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or a policy without a model, with a delay, with gaps or,
        beyond 4 states, without what `fitted_tail` needs.
    """
    cells = _improvable(policy)
    one_of("backend", backend, BACKENDS)
    rounds = whole_number("rounds", rounds, least=1)
    starts = whole_number("starts", starts, least=2)
    seed = whole_number("seed", seed, least=0)
    check_confidence(confidence)
    check_initial(initial, policy.domain)
    rate = _rate(policy, rate)
    warn_of_parts(policy.rules, 1 / rate, policy.time_unit)
    own, tried = _horizons(policy, horizons, rate)
    duration = finite_number("duration", JUDGED * own if duration is None else duration, above=0.0)
    threads = processors(threads)
    fits = policy.domain.n > MOST_STATES
    plan = plan_like(policy, cells, max_level, max_solves, 1 if fits else SOLVES)
    samples = max(2, sample_count(duration, rate))
    if scale is not None:
        scale = finite_number("scale", scale, least=0.0)
    loop = ChargedLoop.of(policy, rate, backend, threads)
    try:
        if scale is None:
            scale = 1.0 if fits else charged_scale(loop, samples)
        refits = None
        if fits:
            refits = Refits.of(policy, plan, backend, threads, seed, initial=initial, rate=rate,
                               duration=duration, scale=scale, progress=progress)  # fmt: skip
        work = Rounds(loop.charging(scale), plan, tried, samples, initial, starts, confidence,
                     seed, refits, {"horizon": own, "scale": scale}, progress)  # fmt: skip
        best, done, result = work.run(rounds)
    except BaseException:  # Ctrl-C, too: threads look at this
        loop.stopped.set()
        raise
    return Improvement(best, done, result, starts, rate, duration, scale)


def _improvable(policy: Policy) -> CellTree:
    """Return the cells of a policy that rollouts can improve; `ProblemError` for another."""
    cells = cell_tree(policy)
    if policy.model is None:
        raise ProblemError("`policy` must carry its model, to be improved; it has none")
    if policy.domain.n > MOST_STATES and (policy.horizon is None or policy.settings is None):
        raise ProblemError(
            f"`policy` must carry its controller to be improved by tails, beyond {MOST_STATES} "
            "states; it has none"
        )
    if policy.delay:
        raise ProblemError(
            "`policy` must have no input delay to be improved by rollouts; got "
            f"{policy.delay:g} {policy.time_unit}"
        )
    if policy.kept is not None:
        raise ProblemError(
            "`policy` must be one that was not made to keep limits: what is improved would not"
        )
    if policy.gaps:
        raise ProblemError("`policy` must have a symbol everywhere to be improved; it has gaps")
    return cells


def _rate(policy: Policy, rate: float | None) -> float:
    if rate is not None:
        return finite_number("rate", rate, above=0.0)
    if policy.settings is None:
        raise ProblemError("`rate` must be given for a policy without settings")
    return 1 / policy.settings.period


def _horizons(policy: Policy, horizons: Any, rate: float) -> tuple[float, tuple[float, ...]]:
    """Return the horizon of a policy and those to try [time unit], ascending."""
    # of one with a tail that was improved before, which is short: that of the policy it came from
    own = policy.statistics.get("improve", {}).get("horizon") or horizon_time(policy)
    if horizons is None:
        if own is None:
            raise ProblemError("`horizons` must be given for a policy without a horizon")
        ladder = LADDER if policy.domain.n <= MOST_STATES else TAIL_LADDER
        horizons = [share * own for share in ladder if share * own * rate >= 2] or [2 / rate]
    values = finite_array("horizons", np.atleast_1d(np.asarray(horizons)), 1)
    samples = values * rate
    if not len(values) or (samples < 1.5).any() or (np.diff(values) <= 0).any():
        raise ProblemError(
            f"`horizons` must ascend, from two samples ({2 / rate:g} {policy.time_unit}) on; got "
            f"{describe(horizons)}"
        )
    return own or float(values[0]), tuple(values.tolist())
