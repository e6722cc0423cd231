"""A tail that is fitted to what closed loops cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.improvement.refits import DELTA, ROUNDS, Refits, plan_like, problem_tail
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.targets import check_initial
from capsyn.policies.policy import Policy, cell_tree
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.plan import SubdivisionPlan
from capsyn.synthesis.synthesize import synthesize
from capsyn.validation import BACKENDS, describe, finite_number, one_of, whole_number


def fitted_tail(
    source: Problem | Policy,
    rounds: int = ROUNDS,
    *,
    goal: Any = None,
    initial: Ball | Box | None = None,
    loops: int | None = None,
    rate: float | None = None,
    duration: float | None = None,
    delta: float = DELTA,
    max_solves: int | None = None,
    seed: int = 0,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Tail:
    """Return a terminal cost for the cost to go around a goal, fitted to closed loops.

    The function simulates closed loops of a policy and fits a quadratic V around the goal to the
    costs of the loops. A loop costs its running cost and, under the rule "steepest", its effort. A
    policy with V as its terminal cost is the next policy, and its loops give the next V. Early
    policies may be bad. The function returns the V whose policy has the cheapest loops, from starts
    that no fit saw. A warning says if the first loops of all cost less. No linearisation has to be
    stabilisable, and any number of states will do.

    The fit is by least squares on the errors relative to ``cost + delta median``, at states that
    the loops visit. Loops start at random states that are scaled towards the goal by 0.05 to 1,
    log-uniformly. A rate beside V stands for the cost of staying at the goal. The part of V that is
    not positive semidefinite is left out.

    Parameters
    ----------
    source : Problem or Policy
        What the fits begin with. A policy with a model and a horizon is taken as it is. A problem,
        without its `tail`, is solved with 1, 2, 4 and 8 times its horizon, and the fits begin with
        the policy whose loops cost least. The policies with tails have the problem's own horizon.
    rounds : int
        Number of fits, one after the other.
    goal : (n,), or callable ``w -> n components``, optional
        The goal [state units]; see `riccati_tail`.
    initial : Ball or Box, optional
        Where loops start before their starts are scaled. Default: the domain.
    loops : int, optional
        Number of loops of each fit. Default: 100 for each number that is fitted.
    rate : float, optional
        Samples of the loops per time unit. Default: 1 over the sample time of the settings.
    duration : float, optional
        Time of each loop [time unit]. The time should suffice to arrive, and be little more.
        Default: 30 horizons of a problem, 10 of a policy.
    delta : float
        The number ``delta`` of the least squares above, > 0.
    max_solves : int, optional
        Most solves of each policy; see `subdivide`.
    seed : int
        Seed of the random starts.
    backend : "auto", "c" or "numpy"
        How to solve and simulate: compiled if possible ("auto"), or as told.
    threads : int, optional
        Number of threads. Default: one per processor. The result does not depend on it.
    progress : callable, optional
        A function that is called with a text now and then.

    Raises
    ------
    ProblemError
        There is no running cost. Or no mixture of the symbols holds the system at the goal. Or the
        loops cost nothing, or all of them end early. Or an argument cannot be used.
    """
    rounds = whole_number("rounds", rounds, least=1)
    seed = whole_number("seed", seed, least=0)
    one_of("backend", backend, BACKENDS)
    options: dict[str, Any] = {
        "goal": goal,
        "initial": initial,
        "rounds": rounds,
        "loops": None if loops is None else whole_number("loops", loops, least=2),
        "rate": None if rate is None else finite_number("rate", rate, above=0.0),
        "duration": None if duration is None else finite_number("duration", duration, above=0.0),
        "delta": finite_number("delta", delta, above=0.0),
        "progress": progress,
    }
    threads = processors(threads)
    if isinstance(source, Problem):
        check_initial(initial, source.domain)
        plan = SubdivisionPlan.of(
            source.grid,
            Limits.of(max_solves, None, None, None),
            leaves=source.leaves,
            leaf_error=0.01,
            refine="isotropic",
            test_points="vertices+center",
            seed=0,
        )
        refits = Refits.of(source, plan, backend, threads, seed, **options)

        def make(each: Problem) -> Policy:
            return synthesize(each, max_solves=max_solves, backend=backend, threads=threads)

        return problem_tail(source, refits, make)
    if not isinstance(source, Policy):
        raise ProblemError(f"`source` must be a Problem or a Policy; got {describe(source)}")
    cells = cell_tree(source)
    check_initial(initial, source.domain)
    for name in ("model", "horizon", "settings"):
        if getattr(source, name) is None:
            raise ProblemError(f"`source` must carry its {name}, of a policy; it has none")
    if source.delay:
        raise ProblemError(
            f"`source` must have no input delay, of a policy; got {source.delay:g} "
            f"{source.time_unit}"
        )
    plan = plan_like(source, cells, None, max_solves, 1)
    refits = Refits.of(source, plan, backend, threads, seed, **options)
    return refits.best_tail([source], refits.starts.tail.horizon)
