"""The paper's cases, with its counts beside ours."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from capsyn import problems
from capsyn.modelling.problem import Problem
from capsyn.modelling.settings import SsacSettings
from capsyn.policies.policy import Policy
from capsyn.synthesis.synthesize import synthesize
from capsyn.verification.outcome import MonteCarlo


@dataclass(frozen=True)
class Case:
    """One policy of the paper: the built-in problem, the level, and the solves it reports."""

    problem: str
    max_level: int
    paper_solves: int
    settings: SsacSettings | None = None
    note: str = ""


RATE = 1000.0
"""Samples per second of the paper's trials."""
GAMMA = SsacSettings(gamma=-5.0)
CASES = (
    Case("cart-pendulum", 4, 3428),
    Case("cart-pendulum-4", 4, 8981),
    Case("double-tank-a", 4, 7621, GAMMA, "gamma = -5"),
    Case("double-tank-a", 5, 17125, GAMMA, "gamma = -5"),
    Case("double-tank-b", 4, 3965, GAMMA, "gamma = -5"),
    Case("double-tank-b", 5, 9474, GAMMA, "gamma = -5"),
)
"""The six cases, read as the paper prints them: alpha_d = -5 J."""


@dataclass(frozen=True)
class Row:
    """A number of the paper beside ours, and what to know about it."""

    what: str
    paper: str
    ours: str
    note: str = ""


def problem_of(case: Case) -> Problem:
    """Return the problem of a case."""
    problem = problems.plain(case.problem)
    return problem.replace(max_level=case.max_level, settings=case.settings or problem.settings)


def synthesize_case(case: Case, **options: Any) -> tuple[Policy, float]:
    """Return the policy of a case and the seconds that it took."""
    started = time.perf_counter()
    policy = synthesize(problem_of(case), **options)
    return policy, time.perf_counter() - started


def count_solves(**options: Any) -> list[dict[str, Any]]:
    """Return, for each of the paper's cases, its number of solves beside ours."""
    rows = []
    for case in CASES:
        policy, seconds = synthesize_case(case, **options)
        statistics = policy.statistics
        rows.append(
            {
                "problem": case.problem,
                "note": case.note,
                "max_level": case.max_level,
                "paper_solves": case.paper_solves,
                "solves": statistics["solves"],
                **statistics["solves_by_role"],
                "worst_case": statistics["worst_case_solves"],
                "cells": statistics["cells"],
                "seconds": seconds,
                "solve_seconds": policy.timings["label"],
            }
        )
    return rows


def successes(result: MonteCarlo) -> str:
    """Return how many trials succeeded, with the interval, in words."""
    return (
        f"{int(result.success.sum()):,} of {len(result.success):,} "
        f"({result.low:.2%} to {result.high:.2%})"
    )
