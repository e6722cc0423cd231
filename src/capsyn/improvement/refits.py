"""Policies with tails that are fitted to the loops of the policies before them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capsyn.cells.affine_leaves import PriceRatios
from capsyn.cells.cell_tree import CellTree
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.ssac import batch_controller
from capsyn.controllers.unsolved.diagnosis import Diagnosis
from capsyn.errors import ProblemError, SynthesisError, warn
from capsyn.improvement.charged_loop import ChargedLoop
from capsyn.improvement.quadratic_fit import Starts, costs_to_go, fitted
from capsyn.modelling.discrete import horizon_time
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.exogenous import joined
from capsyn.modelling.grid import Grid
from capsyn.modelling.tails.equilibrium import System
from capsyn.modelling.tails.riccati import NO_RUNNING_COST, goal_of, rest_at
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.transcription import ModelSystem, terminal_program
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from capsyn.random_streams import derived_seed
from capsyn.simulation.experiment import sample_count
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.plan import SubdivisionPlan
from capsyn.subdivision.subdivide import Labelling, carry_out
from capsyn.validation import read_only

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem

DELTA = 0.2
"""Share of the median cost that is added to what the errors of a fit are relative to."""
LOOPS = 100
"""Loops for each number that is fitted."""
JUDGED = 300
"""Loops that judge a policy."""
FIRST = (1, 2, 4, 8)
"""Horizons of policies without a tail that fits may begin with, in horizons of the problem."""
TIME, TAIL_TIME = 10.0, 30.0
"""Time of closed loops, in horizons of a policy to begin with, and of a problem with a tail."""
ROUNDS = 4
"""Fits, one after the other."""
NOTHING_TO_FIT = (
    "`tail` finds nothing to fit: closed loops from the domain cost nothing, or are not finite"
)
FIT, JUDGE = 3, 4
"""Purposes of seeds: starts of loops that are fitted, and of those that judge."""


@dataclass(frozen=True, eq=False)
class Refits:
    """How tails are fitted, and policies made with them."""

    plan: SubdivisionPlan
    starts: Starts
    rounds: int  # fits, one after the other
    loops: int  # that a fit looks at
    rate: float  # of closed loops [1 / time unit]
    duration: float  # of each [time unit]
    delta: float
    seed: int
    backend: str
    threads: int
    progress: Callable[[str], None] | None
    scale: float | None = None  # of effort and prices; None: 1 under the steepest rule, else 0

    @staticmethod
    def of(
        source: Problem | Policy,
        plan: SubdivisionPlan,
        backend: str,
        threads: int,
        seed: int,
        *,
        goal: Any = None,
        initial: Ball | Box | None = None,
        rounds: int = ROUNDS,
        loops: int | None = None,
        rate: float | None = None,
        duration: float | None = None,
        delta: float = DELTA,
        scale: float | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> Refits:
        """Return those of a problem or a policy, which has horizon and settings.

        The default time of a loop is `TIME` horizons of a policy, `TAIL_TIME` of a problem.
        """
        horizon, time, settings = source.horizon, horizon_time(source), source.settings
        assert horizon is not None and time is not None and settings is not None
        system: System
        if isinstance(source, Policy):
            system, times = system_of(source), TIME
        else:
            system, times = source, TAIL_TIME
        return Refits(
            plan,
            starts_of(system, goal, horizon, initial),
            rounds,
            loops_for(source.domain.n) if loops is None else loops,
            1 / settings.period if rate is None else rate,
            times * time if duration is None else duration,
            delta,
            seed,
            backend,
            threads,
            progress,
            scale,
        )

    @property
    def samples(self) -> int:
        """Samples of a closed loop."""
        return max(2, sample_count(self.duration, self.rate))

    def loop(self, policy: Policy) -> ChargedLoop:
        """Return the closed loop of a policy, which charges what its decisions weigh."""
        settings, scale = policy.settings, self.scale
        if scale is None:
            scale = float(settings is not None and settings.rule == "steepest")
        policy = dataclasses.replace(policy, outside="nearest")  # what leaves tells something, too
        return ChargedLoop.of(policy, self.rate, self.backend, self.threads).charging(scale)

    def candidates(self, policy: Policy, horizon: float) -> Iterator[tuple[Tail, Policy]]:
        """Yield a tail fitted to the loops of a policy, the policy with it, and so on from there.

        The seed of their starts depends on the round alone. They end where nothing can be fitted.
        """
        for k in range(self.rounds):
            loop = self.loop(policy)
            try:
                states = self.starts.draw(self.loops, derived_seed(self.seed, FIT, k))
                told = costs_to_go(loop, states, self.samples)
            except BaseException:  # Ctrl-C, too: threads look at this
                loop.stopped.set()
                raise
            tail = fitted(self.starts, *told, self.delta)
            if tail is None:
                return
            tail = dataclasses.replace(tail, horizon=horizon)
            if self.progress is not None:
                self.progress(f"tail fitted, round {k + 1}")
            policy = self.with_tail(policy, tail, horizon)
            yield tail, policy

    def with_tail(self, policy: Policy, tail: Tail, horizon: float) -> Policy:
        """Return the policy of the same controller with another terminal cost and horizon."""
        told = policy.space.n - policy.domain.n
        terminal = terminal_program(tail, policy.domain.n, told)
        return remade(policy, self.plan, terminal, horizon, self.backend, self.threads)

    def judged(self, policy: Policy) -> np.ndarray:
        """Return what loops cost (B,) from starts that no fit saw, infinite where they are lost."""
        loop = self.loop(policy)
        states = self.starts.draw(JUDGED, derived_seed(self.seed, JUDGE))
        return loop.costs_from(states, self.samples)

    def best_tail(self, policies: Sequence[Policy], horizon: float) -> Tail:
        """Return the tail whose loops cost least, fitted from the best of some policies on.

        A warning says where those of the policies cost less.
        """
        _, first, before = self._best((None, policy) for policy in policies)
        tail, _, costs = self._best(self.candidates(first, horizon))
        assert tail is not None
        if cheaper(before, costs) and before.mean() < costs.mean():
            warn(
                "closed loops of the policy with the fitted tail cost more than those of the "
                f"policy that the fits began with, of horizon {first.horizon:g}: try a Riccati "
                "tail, or another horizon"
            )
        return tail

    def _best(
        self, each: Iterable[tuple[Tail | None, Policy]]
    ) -> tuple[Tail | None, Policy, np.ndarray]:
        """Return that whose loops cost least, and what they cost."""
        best: tuple[Tail | None, Policy, np.ndarray] | None = None
        for tail, policy in each:
            costs = self.judged(policy)
            if best is None or cheaper(costs, best[2]):
                best = tail, policy, costs
        if best is None:
            raise ProblemError(NOTHING_TO_FIT)
        return best


def cheaper(costs: np.ndarray, others: np.ndarray) -> bool:
    """Return whether costs (B,) are less than others, each start by how much relative to both.

    So one that diverges counts as one. Infinite costs are more than any.
    """
    with np.errstate(invalid="ignore"):
        change = (costs - others) / (np.abs(costs) + np.abs(others))
    lost, spared = np.isinf(costs), np.isinf(others)
    change = np.where(lost | spared, lost * 1.0 - spared, change)
    return bool(np.nansum(change) < 0)


def system_of(policy: Policy) -> System:
    """Return the system of a policy, from its model."""
    assert policy.model is not None
    return ModelSystem(
        policy.model, policy.domain, policy.exogenous, policy.alphabet, policy.target
    )


def starts_of(system: System, goal: Any, horizon: float, initial: Ball | Box | None) -> Starts:
    """Return the starts that tell the cost to go of a system around a goal; see `riccati_tail`."""
    if system.running_cost is None:
        raise ProblemError(NO_RUNNING_COST)
    domain, goal = system.domain, goal_of(system, goal)
    _, _, shares = rest_at(system, goal)
    control = read_only(shares @ system.alphabet.values)
    none = np.zeros((domain.n, domain.n))
    tail = Tail(none, goal, control, None, horizon, read_only(domain.periods))
    return Starts(domain, system.exogenous, joined(domain, system.exogenous), tail, initial)


def problem_tail(problem: Problem, refits: Refits, make: Callable[[Problem], Policy]) -> Tail:
    """Return the tail of a problem, fitted from the best policy that it has without one.

    `make` gives policies of problems. Without a tail the horizon may have to be longer: `FIRST`,
    as far as predictions of that time are finite.
    """
    plain = problem.replace(tail=None, delay=0.0)
    policies = [make(plain)]
    for k in FIRST[1:]:
        try:
            policies.append(make(plain.replace(horizon=k * problem.horizon)))
        except SynthesisError:
            break
    return refits.best_tail(policies, problem.horizon)


def loops_for(n: int) -> int:
    """Return how many loops a fit looks at in n dimensions."""
    return LOOPS * (n * (n + 1) // 2 + 1)


def plan_like(
    policy: Policy, cells: CellTree, max_level: int | None, max_solves: int | None, times: int
) -> SubdivisionPlan:
    """Return the plan of a policy like a given one, of some times as many solves unless given."""
    known, level = policy.statistics, cells.max_level
    if cells.affine is not None:  # then that of the cells' grid is that of their rows
        level = max(int(cells.times(some).max()) for some in cells.levels())
    level = level if max_level is None else max_level
    if max_solves is None and "solves" in known:
        max_solves = max(times * known["solves"], 1)
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


def remade(
    policy: Policy,
    plan: SubdivisionPlan,
    terminal: Program,
    horizon: float,
    backend: str,
    threads: int,
) -> Policy:
    """Return the policy of the controller of a policy with another terminal cost and horizon."""
    assert policy.model is not None
    model = dataclasses.replace(policy.model, terminal_cost=terminal)
    settings = policy.settings
    if policy.discrete and settings is not None:
        settings = dataclasses.replace(settings, steps=None)  # the samples of the horizon
    source = dataclasses.replace(
        policy, model=model, horizon=horizon, settings=settings, evidence={}
    )
    controller = batch_controller(Formulation.of(source, model), backend, plan.seed)
    prices = controller.formulation.prices
    labelling = Labelling(
        controller.scored if plan.affine else controller.masks,
        "masks+scores" if plan.affine else "masks",
        controller.preference,
        threads,
        in_force=controller.in_force,
        prices=None if prices is None else PriceRatios.of(prices),
        diagnosis=Diagnosis(controller.formulation),
    )
    made = carry_out(plan, labelling, policy.space, policy.alphabet)
    return dataclasses.replace(
        source,
        cells=made.cells,
        kept=None,
        transitions=made.transitions,
        statistics=made.statistics,
        timings=made.timings,
        settings=controller.settings,
    )
