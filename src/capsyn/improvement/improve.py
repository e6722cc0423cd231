"""From a policy to a better one: rollouts, Algorithm 1 over their labels, and a judge."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.improvement.charged_loop import ChargedLoop, efforts_of
from capsyn.improvement.judged import Comparison
from capsyn.improvement.rollouts import Rollouts
from capsyn.improvement.rounds import CHOICE, Round, Rounds
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.grid import Grid
from capsyn.modelling.targets import check_initial
from capsyn.policies.policy import Policy, cell_tree
from capsyn.random_streams import derived_seed
from capsyn.statistics import check_confidence
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.plan import SubdivisionPlan
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
LADDER = (0.4, 0.7, 1.0, 1.4, 2.0)
"""Horizons that are tried, in horizons of the policy."""
JUDGED = 10.0
"""Time of a closed loop that judges, in horizons of the policy."""
SOLVES = 4
"""Times the solves of the policy that a round may take, where none are given."""
SCALED = 128
"""Random states at which what symbols differ by is seen."""


@dataclass(frozen=True, eq=False)
class Improvement:
    """What `improve` returns.

    Parameters
    ----------
    policy : Policy
        The best policy: that of the last round that was kept, or the given one. Its
        ``statistics["improve"]`` tells the rounds that made it.
    rounds : tuple of Round
        What each round did.
    result : Comparison
        What starts that no choice saw cost under the given policy, and under this one.
    starts : int
        Starts that judged each.
    rate, duration : float
        Of the closed loops that judged [1 / time unit, time unit].
    scale : float
        What effort and prices were charged times.
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
        """Whether the policy is another one than the given."""
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
    """Return a better policy by rollouts, as long as its closed loop surely costs less.

    A symbol's cost at a state is that of holding it for one sample and then following the present
    policy for a horizon. The new policy takes the least, by Algorithm 1 on the policy's own grid.
    A ladder of horizons is tried as long as the closed-loop cost of some starts falls, and the
    best policy is judged on fresh starts: it is kept if these surely cost less, and then the next
    round begins with it.

    What a closed loop costs is the running cost (of a policy that has none, the terminal cost, as
    one); the effort of its settings beyond that of the cheapest symbol; and for each switch its
    price times a sample. Effort and prices were weighed against costs over the policy's horizon,
    with its terminal cost. They are charged times the `scale` that makes them weigh as much against
    what symbols differ by in closed loop.

    Parameters
    ----------
    policy : Policy
        A policy with its model, of at most 4 states. Of cells, no decision tree.
    rounds : int
        Most rounds.
    horizons : number or sequence, optional
        Horizons of the rollouts, ascending [time unit], of two samples or more. Default: 0.4 to 2
        times that of the policy.
    rate : float, optional
        Samples per time unit of the loops: a symbol is held for exactly one sample. Default: 1 over
        the sample time of the policy's settings. The new policy has this one in its settings.
    duration : float, optional
        Time of the closed loops that judge [time unit]. Default: 10 horizons of the policy.
    initial : Ball or Box, optional
        Where they start. Default: the domain. Exogenous inputs are drawn from their box, and stay.
    starts : int
        How many choose a horizon, and how many others judge a round.
    confidence : float
        Of the intervals by which a round is judged.
    scale : float, optional
        Of effort and prices. Default: see above; 1 where the policy does not carry its controller.
    max_level, max_solves : int, optional
        See `subdivide`. Default: those of the policy, and 4 times as many solves as it took.
    seed : int
        Of the starts.
    backend : "auto", "c" or "numpy"
        How loops are simulated.
    threads : int, optional
        Default: one per processor. The result does not depend on it.
    progress : callable, optional
        Called with a text now and then.

    Returns
    -------
    Improvement
        With the best policy: the given one where no round surely lowered the cost.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or a policy without a model, with a delay, with gaps or
        with more than 4 states.
    """
    cells = _improvable(policy)
    one_of("backend", backend, BACKENDS)
    rounds = whole_number("rounds", rounds, least=1)
    starts = whole_number("starts", starts, least=2)
    seed = whole_number("seed", seed, least=0)
    check_confidence(confidence)
    check_initial(initial, policy.domain)
    rate = _rate(policy, rate)
    own, tried = _horizons(policy, horizons, rate)
    duration = finite_number("duration", JUDGED * own if duration is None else duration, above=0.0)
    threads = processors(threads)
    plan = _plan(policy, cells, max_level, max_solves)
    samples = max(2, round(duration * rate))
    if scale is not None:
        scale = finite_number("scale", scale, least=0.0)
    loop = ChargedLoop.of(policy, rate, backend, threads)
    try:
        scale = _scale(loop, samples) if scale is None else scale
        work = Rounds(loop.charging(scale), plan, tried, samples, initial, starts, confidence,
                     seed, {"horizon": own, "scale": scale}, progress)  # fmt: skip
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
    if policy.domain.n > MOST_STATES:
        raise ProblemError(
            f"`policy` must have at most {MOST_STATES} states to be improved by rollouts; got "
            f"{policy.domain.n}: there, a tail is the way (a terminal cost that stands for the "
            "cost to go)"
        )
    if policy.delay:
        raise ProblemError(
            "`policy` must have no input delay to be improved by rollouts; got "
            f"{policy.delay:g} {policy.time_unit}"
        )
    if policy.gaps:
        raise ProblemError("`policy` must have a symbol everywhere to be improved; it has gaps")
    return cells


def _rate(policy: Policy, rate: float | None) -> float:
    if rate is not None:
        return finite_number("rate", rate, above=0.0)
    if policy.settings is None:
        raise ProblemError("`rate` must be given for a policy without settings")
    return 1 / policy.settings.sample_time


def _horizons(policy: Policy, horizons: Any, rate: float) -> tuple[float, tuple[float, ...]]:
    """Return the horizon of a policy and those to try [time unit], ascending."""
    own = policy.horizon or policy.statistics.get("improve", {}).get("horizon")
    if horizons is None:
        if own is None:
            raise ProblemError("`horizons` must be given for a policy without a horizon")
        horizons = [share * own for share in LADDER if share * own * rate >= 2] or [2 / rate]
    values = finite_array("horizons", np.atleast_1d(np.asarray(horizons)), 1)
    samples = values * rate
    if not len(values) or (samples < 1.5).any() or (np.diff(values) <= 0).any():
        raise ProblemError(
            f"`horizons` must ascend, from two samples ({2 / rate:g} {policy.time_unit}) on; got "
            f"{describe(horizons)}"
        )
    return own or float(values[0]), tuple(values.tolist())


def _plan(
    policy: Policy, cells: CellTree, max_level: int | None, max_solves: int | None
) -> SubdivisionPlan:
    """Return the plan of a policy like a given one."""
    known, level = policy.statistics, cells.max_level
    if cells.affine is not None:  # then that of the cells' grid is that of their rows
        level = max(int(cells.times(some).max()) for some in cells.levels())
    level = level if max_level is None else max_level
    if max_solves is None and "solves" in known:
        max_solves = max(SOLVES * known["solves"], 1)
    plan = SubdivisionPlan.of(
        Grid.of(cells.partitions, cells.refinement, level, cells.n),
        Limits.of(max_solves, None, None, None),
        leaves="constant" if cells.affine is None else "affine",
        leaf_error=known.get("leaf_error", 0.01),
        refine="isotropic" if cells.splits is None else "adaptive",
        test_points=known.get("test_points", "vertices+center"),
        seed=known.get("seed", 0),
    )
    plan.check(policy.space, len(policy.alphabet), len(policy.alphabet) + 1)
    return plan


def _scale(loop: ChargedLoop, samples: int) -> float:
    """Return what effort and prices count in closed loops, beside the cost of their trials.

    They count as much, against what symbols differ by, as they do for the controller that the
    policy came from: of its horizon and terminal cost closed loops know nothing.
    """
    policy = loop.policy
    prices = policy.rules.prices
    if not np.ptp(efforts_of(policy)[:-1]) and not prices[np.isfinite(prices)].any():
        return 1.0
    known = policy.statistics.get("improve", {}).get("scale")
    controller = policy_controller(policy, loop.backend) if known is None else None
    if controller is None:
        return 1.0 if known is None else float(known)
    states = policy.space.sample(SCALED, derived_seed(0, CHOICE))
    own = controller.spread(controller.solve(states))
    rollouts = Rollouts.of(dataclasses.replace(loop, end=None), samples)
    costs = rollouts.costs(states)[:, -1]
    spreads = np.ptp(costs[np.isfinite(costs).all(axis=1)], axis=1) / loop.loop.period
    scale = float(np.median(spreads)) / own if spreads.size and own > 0 else 1.0
    return scale if np.isfinite(scale) and scale > 0 else 1.0
