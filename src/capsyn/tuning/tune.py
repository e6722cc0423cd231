"""Search for the free settings of a problem that meet a goal best in closed loop."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from capsyn.errors import ProblemError
from capsyn.execution.files import write_text
from capsyn.modelling.problem import Problem
from capsyn.policies.policy import Policy
from capsyn.random_streams import derived_seed
from capsyn.synthesis.synthesize import check_arguments, synthesize
from capsyn.tuning.advice import advice
from capsyn.tuning.family import Family
from capsyn.tuning.figures import Charges, Figures, Tried, figures_of
from capsyn.tuning.free import Free
from capsyn.tuning.goal import Goal, front
from capsyn.tuning.same_study import digest, problem_facts, target_facts
from capsyn.validation import true_or_false, whole_number
from capsyn.verification.conditions import conditions
from capsyn.verification.monte_carlo import prepared
from capsyn.verification.switching_curve import knee
from capsyn.verification.trials import TrialOptions

JUDGING = 21
"""Purpose of the seeds of starts: of the search, of the choice among the best, of the judge."""
QUICK = 5
"""Share of the starts, one in so many, that the quick stage takes."""
FEWEST = 20
"""Fewest starts of the quick stage."""
CANDIDATES = 5
"""Best settings of the search among which fresh starts choose."""
RUN_BY = ("backend", "threads", "executor", "memory_limit", "progress")
"""Arguments of `capsyn.synthesize` on which no result depends."""
NOT_ASKED = ("stop_at_target", "executor", "track")
"""Arguments of closed loops that are not those of `tune`."""
AXES = ("success", "cost", "effort", "switches", "nodes")
"""What the front trades off."""


@dataclass(frozen=True, eq=False)
class Tuning:
    """What `tune` returns.

    Parameters
    ----------
    problem : Problem
        The problem with the best settings.
    policy : Policy
        The policy of this problem.
    settings : dict
        The best settings by name; ``function(**settings)`` makes the problem again.
    figures : Figures
        Figures of the policy's closed loops, from starts that the search did not see.
    goal : Goal
        The goal of the search.
    met : bool
        Whether the figures meet the goal.
    advice : str, optional
        If the figures do not meet the goal, what to free next.
    tried : tuple of Tried
        All settings that were tried.
    front : tuple of Tried
        The settings judged in full that no other settings beat in one figure without loss in the
        others. If some of them meet the goal, only these.
    free : dict of name to Free
        The ranges and choices of the free settings.
    """

    problem: Problem
    policy: Policy
    settings: dict[str, Any]
    figures: Figures
    goal: Goal
    met: bool
    advice: str | None
    tried: tuple[Tried, ...]
    front: tuple[Tried, ...]
    free: dict[str, Free]

    def to_json(self) -> dict[str, Any]:
        """Return the settings and everything that was found, as plain data."""
        return {
            "problem": self.problem.name,
            "settings": self.settings,
            "goal": self.goal.to_json(),
            "met": self.met,
            "advice": self.advice,
            "figures": self.figures.to_json(),
            "free": {name: free.to_json() for name, free in self.free.items()},
            "front": [one.to_json() for one in self.front],
            "tried": [one.to_json() for one in self.tried],
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result of `to_json` to the file `path` for ``capsyn synth --settings``."""
        write_text(path, json.dumps(self.to_json(), indent=1) + "\n")

    def __repr__(self) -> str:
        settings = ", ".join(f"{name}={value}" for name, value in self.settings.items())
        return f"Tuning({self.goal}: {'met' if self.met else 'not met'}, {settings})"


def tune(
    problem: Any,
    free: Mapping[str, Free] | None = None,
    *,
    success: float | None = None,
    least: str | None = None,
    trials: int = 60,
    starts: int = 200,
    fresh: int = 1000,
    cost: Callable[..., Any] | None = None,
    effort: Callable[..., Any] | None = None,
    quick: bool = True,
    synthesis: Mapping[str, Any] | None = None,
    storage: str | os.PathLike[str] | None = None,
    seed: int = 0,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
    **loops: Any,
) -> Tuning:
    """Return the settings of a problem that meet a goal best in closed loop.

    Each trial makes the policy for other settings, and runs its closed loops from random starts.
    All trials have the same starts. The first trial takes the middle of the ranges, and some more
    are spread over the ranges. The other trials follow what was found (a tree-structured Parzen
    estimator, by Optuna). A quick stage, with one level less and a fifth of the starts, decides
    which settings are judged in full. The best few settings are then judged on other starts. The
    best settings that meet the goal there are judged on yet other starts, which gives `figures`. If
    possible, these settings meet the goal by a standard deviation of the successes.

    Parameters
    ----------
    problem : Problem, or function that returns one
        The problem, or a function whose free arguments have a `Free` as their default.
    free : mapping of name to Free, optional
        Further free settings by name. Free settings are arguments of the function, or for any
        problem ``horizon``, ``control_weight``, ``gamma``, ``rule``, ``price`` of a switch and
        ``tail``. The numbers of ``tail`` are the effort of a Riccati tail, which brings its own
        horizon.
    success : float, optional
        Least share of loops that must succeed, as `capsyn.monte_carlo` defines success. A share of
        successes needs a target.
    least : "cost", "effort", "switches", "nodes" or "knee", optional
        The figure that is to be least among the settings that succeed. Default: "cost" if `success`
        is given. "nodes" are the nodes of the exact tree. "knee" has the fewest switches at 3 %
        more than the least cost.
    trials : int
        Number of settings to try, including those that the storage already has.
    starts, fresh : int
        Number of starts of a trial, and of the final judgement.
    cost : callable ``x -> scalar``, or ``(x, w)``, optional
        The cost that loops gather, the same for all settings [cost / time unit]. Default: the
        problem's own cost, with all free settings in the middle of their ranges.
    effort : callable ``u -> scalar``, optional
        Effort of a control (m,) [effort / time unit]. Default: ``u^T u``.
    quick : bool
        Whether there is a quick stage. The goal "knee" has none.
    synthesis : mapping, optional
        Arguments of `capsyn.synthesize`, such as ``{"max_solves": 60_000}`` or an ``executor``
        whose workers solve.
    storage : path or URL, optional
        Where the trials are kept: a SQLite file, a journal (``.journal``) for machines that share a
        file system, or the URL of a database. A study that was killed goes on when it is started
        again. Processes with the same storage share the work.
    seed : int
        Seed of all random numbers.
    backend, threads
        The arguments of the same names of `capsyn.synthesize`.
    progress : callable, optional
        A function that is called with a text about what comes next.
    **loops
        How loops run: arguments of `capsyn.monte_carlo`, such as ``duration``, ``rate``,
        ``initial``, ``target``, ``within`` and ``hold``.

    Raises
    ------
    ProblemError
        There is no goal, or nothing is free. Or the storage belongs to another study. Or an
        argument cannot be used.
    """
    goal = Goal(success, least)
    family = Family.of(problem, free)
    if not family.free:
        raise ProblemError(
            "nothing is free: give an argument of the function the default capsyn.Free(low, high),"
            " or `free`"
        )
    whole_number("trials", trials, least=1)
    whole_number("fresh", fresh, least=1)
    whole_number("seed", seed, least=0)
    true_or_false("quick", quick)
    plan = TrialOptions.of(
        without=NOT_ASKED, trials=starts, backend=backend, threads=threads, **loops
    )
    options = {"backend": backend, "threads": threads} | dict(synthesis or {})
    check_arguments("synthesis", options)
    judge = _Judge.of(family, goal, plan, options, (cost, effort), seed)
    from capsyn.tuning.study import Study

    study = Study(judge.base.name, family.free, goal, judge.asked(seed, quick), storage, seed)
    study.search(trials, judge.stages if quick and goal.least != "knee" else judge.full, progress)
    tried = study.tried()
    if progress is not None:
        progress("judging the best on fresh starts")
    return judge.result(tried, fresh)


@dataclass(frozen=True, eq=False)
class _Judge:
    """Judges settings of a family by closed loops."""

    family: Family
    goal: Goal
    plan: TrialOptions
    options: dict[str, Any]  # of `synthesize`
    charges: Charges
    base: Problem  # in the middle of the ranges
    conditions: dict[str, Any]  # of its loops
    efforts: list[float]  # of its symbols
    seed: int

    @staticmethod
    def of(
        family: Family,
        goal: Goal,
        plan: TrialOptions,
        options: dict[str, Any],
        charged: tuple[Any, Any],
        seed: int,
    ) -> _Judge:
        """Return the judge of a family; what cannot be used is found here, before any search."""
        base = family(family.middle)
        charges = Charges.of(base, *charged, goal.least == "nodes")
        policy = synthesize(base, **options | {"partitions": 1, "max_level": 0})
        test = prepared(policy, plan)
        if test.experiment.target is None and goal.success is not None:
            raise ProblemError("`target` must be given: neither policy nor problem has one")
        told = conditions(policy, test.options, test.experiment)
        efforts = charges.efforts(policy.controls).tolist()
        return _Judge(family, goal, plan, options, charges, base, told, efforts, seed)

    def asked(self, seed: int, quick: bool) -> dict[str, str]:
        """Return what a study that goes on must have in common with this one."""
        base, plan = self.base, self.plan
        own = {k: v for k, v in self.options.items() if k not in RUN_BY}
        target = target_facts(base, plan.loop.target)
        judged = [self.conditions, target, own, self.efforts]
        judged += [self.charges.cost.to_json(), plan.trials, quick]
        ranges = {name: str(free) for name, free in self.family.free.items()}
        return {
            "goal": str(self.goal),
            "ranges": "; ".join(f"{name} {text}" for name, text in ranges.items()),
            "problem": digest(problem_facts(base)),
            "loops": digest(judged),
            "seed": str(seed),
        }

    def policy(self, problem: Problem, **changes: Any) -> Policy:
        """Return the policy of a problem."""
        return synthesize(problem, **self.options | changes)

    def judged(self, policy: Policy, part: int, starts: int) -> Figures:
        """Return what loops of a policy do; each part has starts of its own."""
        loop = dataclasses.replace(self.plan.loop, seed=derived_seed(self.seed, JUDGING, part))
        plan = dataclasses.replace(self.plan, loop=loop, trials=starts)
        return figures_of(policy, plan, self.charges)

    def full(self, settings: dict[str, Any]) -> list[Callable[[], Figures]]:
        """Return what judges settings in full, as one stage."""
        return [lambda: self.judged(self.policy(self.family(settings)), 0, self.plan.trials)]

    def stages(self, settings: dict[str, Any]) -> list[Callable[[], Figures]]:
        """Return what judges settings: quickly, then in full."""
        problem = self.family(settings)
        level = self.options.get("max_level", problem.max_level)
        few = min(self.plan.trials, max(FEWEST, self.plan.trials // QUICK))
        coarse = functools.cache(lambda: self.policy(problem, max_level=max(level - 1, 0)))

        def whole() -> Figures:
            policy = self.policy(problem) if level else coarse()
            return self.judged(policy, 0, self.plan.trials)

        return [lambda: self.judged(coarse(), 0, few), whole]

    def result(self, tried: list[Tried], fresh: int) -> Tuning:
        """Return what came of all trials: the best of them on starts that none saw."""
        full = [one for one in tried if one.full]
        if not full:
            errors = [one.error for one in tried if one.error]
            raise ProblemError(f"no settings could be used; of the last: {errors[-1]}")
        met = [one for one in full if self.goal.met(one.figures)]
        each = {str(one.settings): one for one in reversed(met or full)}  # each settings once
        best = sorted(each.values(), key=lambda one: self.goal.objectives(one.figures))
        if self.goal.least == "knee" and met:
            chosen = knee([one.figures for one in met])
            best = [one for one in met if one.figures is chosen]
        found = []
        for one in best[:CANDIDATES]:
            problem = self.family(one.settings)
            policy = self.policy(problem)
            found.append((one, problem, policy, self.judged(policy, 1, fresh)))
        one, problem, policy, _ = min(
            found, key=lambda each: (not self.goal.spares(each[3]), self.goal.objectives(each[3]))
        )
        figures = self.judged(policy, 2, fresh)
        reached = self.goal.met(figures)
        told = None if reached else advice(self.family, one.settings, self.goal)
        traded = front(met or full, AXES)
        return Tuning(problem, policy, one.settings, figures, self.goal, reached, told,
                      tuple(tried), traded, self.family.free)  # fmt: skip
