"""Synthesis: from a problem to its policy."""

from __future__ import annotations

import dataclasses
import inspect
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import PriceRatios
from capsyn.cells.masks import empty, several
from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import TIE
from capsyn.controllers.ssac import BatchController, batch_controller
from capsyn.controllers.unsolved.diagnosis import Diagnosis
from capsyn.errors import ProblemError, warn
from capsyn.execution.cluster import check_client
from capsyn.execution.processors import processors
from capsyn.improvement.refits import Refits, problem_tail
from capsyn.limits.asked import KeepLimits, check_limits
from capsyn.limits.shield import shielded
from capsyn.modelling.alphabet import Outside
from capsyn.modelling.domain import Box
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching
from capsyn.modelling.tails.riccati import FIT
from capsyn.modelling.tails.tail import Tail
from capsyn.modelling.transcription import transcribe, transcribe_target
from capsyn.policies.policy import Policy
from capsyn.programs.model import Model
from capsyn.subdivision.lattice_points import Progress
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.plan import SubdivisionPlan
from capsyn.subdivision.subdivide import Labelling, carry_out
from capsyn.synthesis.labelling import answerer
from capsyn.validation import BACKENDS, describe, one_of

SAMPLES = 2048
"""Random states by which the controller is judged, see ``Policy.statistics['sample']``."""


def synthesize(
    problem: Problem,
    *,
    partitions: Any = None,
    refinement: Any = None,
    max_level: int | None = None,
    settings: SsacSettings | None = None,
    outside: Outside | None = None,
    min_dwell: float | None = None,
    outside_at_once: bool | None = None,
    switching: Switching | None = None,
    delay: float | None = None,
    leaves: str | None = None,
    keep_limits: bool | KeepLimits = False,
    leaf_error: float = 0.01,
    refine: str = "isotropic",
    test_points: str = "vertices+center",
    seed: int = 0,
    max_solves: int | None = None,
    max_seconds: float | None = None,
    max_memory: int | str | None = None,
    memory_limit: int | str | None = None,
    backend: str = "auto",
    threads: int | None = None,
    executor: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Policy:
    """Return the control alphabet policy of a problem, by sSAC and Algorithm 1.

    Parameters
    ----------
    problem : Problem
        The problem with its settings. For a tail "fit", `fitted_tail` first finds the tail, and all
        its policies have these options.
    partitions, refinement, max_level, leaves : optional
        Override the problem's own grid and leaves.
    settings, outside, min_dwell, outside_at_once : optional
        Override the problem's own settings and rules.
    switching, delay : optional
        Override the problem's own switching and delay; the policy then depends on the symbol in
        force. Affine leaves cannot have a delay.
    keep_limits : bool or KeepLimits
        Whether the policy keeps the problem's limits by construction, for ever, at its sample time.
        Enclosures prove the largest set of cells from which limits can be kept. In this set, the
        policy takes the best symbol that stays in the set. Elsewhere it takes the symbol whose
        worst limit in the next period is least. ``policy.keeps_limits(states)`` tells which states
        are in the set. A `KeepLimits` says how fine the cells are, and which parameters are
        unknown.
    leaf_error : float
        Largest estimated share of an affine leaf in which its rows may be wrong; see `subdivide`.
    refine : "isotropic" or "adaptive"
        "isotropic" splits cells along all axes. "adaptive" splits a cell only along the axes along
        which its labels, or the errors of its rows, vary. Adaptive splits take fewer solves from
        three dimensions on; see `subdivide`.
    test_points : str
        The points of a cell that are solved: ``"vertices+center"``, or ``"center+faces"`` without
        the 2^n vertices. Add ``+edge_midpoints``, ``+faces`` or ``+random:R`` as wanted.
    seed : int
        Seed of all random numbers.
    max_solves : int, optional
        Most solves. Constant leaves that are split along all axes stop before a level that would
        exceed the number, with a valid coarser policy. Other leaves spend the solves where the
        estimated error is largest.
    max_seconds : float, optional
        Stop after this time [s], with a valid policy that is coarser where the run did not come.
        Only this option makes results depend on the machine; see `subdivide`.
    max_memory : int or str, optional
        Stop in the same way before this much memory is taken [bytes, or text as ``"2GB"``].
    memory_limit : int or str, optional
        Refuse a run that may take more memory at worst, before any work [bytes, or text]. Default:
        the memory that is available. The result does not depend on it.
    backend : "auto", "c" or "numpy"
        How to solve: compiled if there is a compiler ("auto"), or as told.
    threads : int, optional
        Number of threads that solve. Default: one per processor. The policy does not depend on it.
    executor : dask.distributed.Client, optional
        A cluster whose workers solve, with the same results. Workers that would give other results
        are refused.
    checkpoint : path, optional
        A directory that keeps what is solved. A run that was killed goes on from there when it is
        started again, and makes the same policy. A run of another problem or with other settings is
        refused. Threads, executor, budgets and `memory_limit` may change.
    progress : callable, optional
        A function that is called with a `Progress` now and then.

    Returns
    -------
    Policy
        The policy, whose file also carries the model. The same problem and settings give the same
        policy, whatever the threads. Backends round differently in the last bits, far below the
        width of a tie.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    SynthesisError
        More than 1 % of the solves have no finite result.
    KernelBuildError
        ``backend="c"`` without a working compiler.
    """
    problem = _overridden(
        problem,
        partitions=partitions,
        refinement=refinement,
        max_level=max_level,
        settings=settings,
        outside=outside,
        min_dwell=min_dwell,
        outside_at_once=outside_at_once,
        switching=switching,
        delay=delay,
        leaves=leaves,
    )
    threads = processors(threads)
    plan = SubdivisionPlan.of(
        problem.grid,
        Limits.of(max_solves, max_seconds, max_memory, memory_limit),
        leaves=problem.leaves,
        leaf_error=leaf_error,
        refine=refine,
        test_points=test_points,
        seed=seed,
    )
    one_of("backend", backend, BACKENDS)
    if executor is not None:
        check_client(executor)
    symbols, remembers = len(problem.alphabet), problem.switching is not None or problem.delay > 0
    plan.check(problem.space, symbols, symbols + 1 if remembers else 1)
    if plan.affine and problem.delay:
        raise ProblemError("`leaves` must be constant for a problem with a delay; got affine")
    run = _Run(threads, backend, executor, checkpoint, progress)
    return _synthesized(problem, plan, run, check_limits(problem, keep_limits))


def _fitted(problem: Problem, plan: SubdivisionPlan, threads: int, backend: str) -> Tail:
    """Return the tail that closed loops of the problem's own policies tell; see `fitted_tail`."""
    run = _Run(threads, backend, None, None, None)
    refits = Refits.of(problem, plan, backend, threads, plan.seed)
    return problem_tail(problem, refits, lambda each: _synthesized(each, plan, run))


@dataclass(frozen=True)
class _Run:
    """How a synthesis is run; the result does not depend on it. See `synthesize`."""

    threads: int
    backend: str
    executor: Any
    checkpoint: str | os.PathLike[str] | None
    progress: Callable[[Progress], None] | None


def _synthesized(
    problem: Problem, plan: SubdivisionPlan, run: _Run, asked: KeepLimits | None = None
) -> Policy:
    """Return the policy of a problem on a plan, both checked, that keeps limits where `asked`."""
    if problem.tail == FIT:
        problem = problem.replace(tail=_fitted(problem, plan, run.threads, run.backend))
    started = time.perf_counter()
    switching, controller = priced(problem, transcribe(problem), run.backend, plan.seed)
    prepared = time.perf_counter() - started
    method, returns = ("scored", "masks+scores") if plan.affine else ("masks", "masks")
    how = (run.threads, run.backend, run.executor, run.checkpoint, _asked(problem, switching, plan))
    with answerer(controller, method, *how) as answers:
        controller = answers.controller
        prices = controller.formulation.prices
        labelling = Labelling(
            answers.label, returns, controller.preference, answers.threads, run.progress,
            controller.in_force, None if prices is None else PriceRatios.of(prices),
            Diagnosis(controller.formulation),
        )  # fmt: skip
        policy = carry_out(plan, labelling, problem.space, problem.alphabet)
    timings = {"prepare": prepared, **policy.timings}
    more = {"timings": timings, "switching": switching}
    policy = _described(policy, problem, controller, plan.seed, **more)
    if asked is None:
        return policy
    started = time.perf_counter()
    policy = shielded(policy, controller, asked, run.backend)
    timings = policy.timings | {"limits": time.perf_counter() - started}
    return dataclasses.replace(policy, timings=timings)


def _overridden(problem: Problem, **changes: Any) -> Problem:
    """Return a problem with those fields replaced that are not None."""
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a capsyn.Problem; got {describe(problem)}")
    return problem.replace(**{k: v for k, v in changes.items() if v is not None})


def _asked(problem: Problem, switching: Switching | None, plan: SubdivisionPlan) -> dict[str, Any]:
    """Return what a synthesis depends on beside its controller, as plain data."""
    return {
        "name": problem.name,
        "alphabet": problem.alphabet.to_json(),
        **plan.grid.to_json(),
        "outside": problem.outside,
        "min_dwell": problem.min_dwell,
        **({} if switching is None else {"switching": switching.to_json()}),
        **({"delay": problem.delay} if problem.delay else {}),
        **plan.asked(),
    }


def _described(
    policy: Policy, problem: Problem, controller: BatchController, seed: int, **more: Any
) -> Policy:
    """Return the policy of a problem with all that it carries beside its cells, and `more`."""
    statistics = policy.statistics
    if statistics["not_finite_points"]:
        warn(
            f"{statistics['not_finite_points']} of {statistics['solves']} solves gave no finite "
            "result and take the default control, for instance at state "
            f"{statistics['not_finite_example']}: "
            + Diagnosis(controller.formulation).why(statistics["not_finite_example"])
        )
    sample = sample_statistics(controller, problem.space, seed)
    return dataclasses.replace(
        policy,
        name=problem.name,
        outside=problem.outside,
        default=problem.default_control,
        min_dwell=problem.min_dwell,
        time_unit=problem.time_unit,
        outside_at_once=problem.outside_at_once,
        delay=problem.delay,
        domain=problem.domain,
        exogenous=problem.exogenous,
        target=transcribe_target(problem),
        horizon=problem.horizon,
        settings=controller.settings,
        model=controller.formulation.model,
        statistics=statistics | {"sample": sample},
        **more,
    )


def check_arguments(name: str, options: Mapping[str, Any]) -> None:
    """Raise `ProblemError` unless options, the argument `name`, are some of `synthesize`."""
    known = inspect.signature(synthesize).parameters.keys() - {"problem"}
    for option in options:
        if option not in known:
            raise ProblemError(
                f"`{name}` must be arguments of capsyn.synthesize; got {describe(option)}"
            )


def problem_controller(
    problem: Problem, model: Model, backend: str = "auto", seed: int = 0
) -> BatchController:
    """Return sSAC for a problem and its transcribed model; see `batch_controller`."""
    return batch_controller(Formulation.of(problem, model), backend, seed)


def priced(
    problem: Problem, model: Model, backend: str = "auto", seed: int = 0
) -> tuple[Switching | None, BatchController]:
    """Return the switching of a problem with its price in numbers, and its controller.

    A share is of the median over random states of the worst score less the best; see `Switching`.
    """
    switching, controller = problem.switching, problem_controller(problem, model, backend, seed)
    if switching is None or not switching.has_share:
        return switching, controller
    solution = controller.solve(problem.space.sample(SAMPLES, seed + 1))
    switching = switching.with_spread(controller.spread(solution))
    settings = controller.settings  # with steps
    formulation = Formulation.of(problem, model, switching)
    formulation = dataclasses.replace(formulation, settings=settings)
    return switching, dataclasses.replace(controller, formulation=formulation)


def sample_statistics(controller: BatchController, domain: Box, seed: int) -> dict[str, Any]:
    """Return what sSAC does at random states, as estimates of shares of the volume.

    ``no_descent``: the chosen symbol does not lower the cost to first order; ``indifferent``:
    several symbols tie; ``held_back``: nor does it though another symbol would;
    ``not_finite``: no result; ``negative_cost``: the cost is negative.
    ``wanted_over_reachable``: median of ``|alpha_d|`` over the steepest descent on offer;
    ``effort_over_choice``: median of the spread of the efforts over the spread of the rest of the
    score; ``reach``: median share of the cost that the best symbol would take off if it acted
    over the whole horizon, to first order.
    """
    states = domain.sample(SAMPLES, seed + 1)
    solution = controller.solve(states)
    masks = controller.possible(solution)
    finite = ~empty(masks)
    gradients, cost = solution.gradients[finite], solution.cost[finite]
    scores = controller.scores(solution)[finite]
    chosen = np.argmin(scores, axis=1)[:, None]
    slope = np.take_along_axis(gradients, chosen, axis=1)
    margin = TIE * np.take_along_axis(solution.scales[finite], chosen, axis=1)
    best = -gradients.min(axis=1)
    indifferent = several(masks)

    def median(values: np.ndarray) -> float | None:
        values = values[np.isfinite(values)]
        return float(f"{np.median(values):.4g}") if values.size else None

    settings = controller.settings
    wanted = np.abs(settings.wanted_sensitivity(cost))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = {
            "wanted_over_reachable": None
            if settings.rule == "steepest"
            else median(wanted / np.maximum(best, 0.0)),
            "effort_over_choice": median(
                np.ptp(controller.efforts) / np.ptp(scores - controller.efforts, axis=1)
            ),
            "reach": median(best * controller.horizon / np.abs(cost))
            if controller.formulation.model.sample_time is None
            else None,  # a symbol that acts all along is not so many times one that acts once
        }
    return {
        "states": SAMPLES,
        "no_descent": float((slope > margin).sum() / SAMPLES),
        "indifferent": float(indifferent.sum() / SAMPLES),
        "held_back": float(((slope > margin)[:, 0] & (best > margin[:, 0])).sum() / SAMPLES),
        "not_finite": float((~finite).sum() / SAMPLES),
        "negative_cost": float((cost < 0).sum() / SAMPLES),
        **ratios,
    }
