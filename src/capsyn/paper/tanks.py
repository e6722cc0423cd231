"""The paper's two tanks (Section VI): figures 5 and 6, Monte Carlo, and ways to read the text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capsyn import problems
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.settings import SsacSettings
from capsyn.paper.cases import GAMMA, RATE, Row, successes
from capsyn.paper.figures import draw_costs, draw_end_states, draw_tanks, halves
from capsyn.plots.figure import new_figure
from capsyn.plots.policy import plot_policy
from capsyn.policies.policy import Policy
from capsyn.simulation.simulate import simulate
from capsyn.synthesis.synthesize import synthesize
from capsyn.verification.monte_carlo import default_costs, monte_carlo
from capsyn.verification.outcome import MonteCarlo

if TYPE_CHECKING:
    from matplotlib.figure import Figure

START = Box([0.1, 0.1], [0.9, 0.9])
SHOWN, TRACED = 500, 100
"""Trials in the pictures of end states, and of costs."""


@dataclass(frozen=True)
class Reading:
    """One way to read the paper's tanks: what is changed about the problem, and why it matters.

    The `main` ones stand among the results, the others in a table of their own.
    """

    settings: SsacSettings
    text: str
    why: str
    default: tuple[float, ...] = (0.0, 0.0, 0.0)
    horizon: float = 0.5
    main: bool = False


STEEPEST = SsacSettings(rule="steepest")
STEEPEST_CHECKED = SsacSettings(rule="steepest", tolerance=1e-5)
V2_OPEN = (0.0, 0.2, 0.0)
READINGS = {
    "a": (
        Reading(
            GAMMA,
            "alpha_d = -5 J at every solve, as the paper prints",
            "closing all valves freezes the levels, and comes nearer to the wanted sensitivity "
            "than any other symbol up to 0.12 from the goal: outside the tolerance, where a few "
            "trials end",
            main=True,
        ),
        Reading(
            SsacSettings(gamma=-10.0),
            "alpha_d = -10 J, the built-in",
            "the frozen region shrinks to 0.05, well inside the tolerance",
            main=True,
        ),
        Reading(
            SsacSettings(alpha_d=-5.0),
            "alpha_d = -5, a constant",
            "another reading of 'alpha_d = -5J'; the paper's success rules it out",
        ),
    ),
    "b": (
        Reading(
            STEEPEST,
            "steepest descent, the built-in",
            "the paper: 'alpha_d can be eliminated'",
            main=True,
        ),
        Reading(
            GAMMA,
            "alpha_d = -5 J",
            "the same frozen region as in case A, beside a tolerance half as wide",
        ),
        Reading(
            SsacSettings(gamma=-5.0, tolerance=1e-5),
            "alpha_d = -5 J, V2 open by default",
            "the default prediction drifts, which moves the point where doing nothing looks best "
            "by up to 0.08",
            V2_OPEN,
        ),
        Reading(
            STEEPEST_CHECKED, "steepest descent, V2 open by default", "drifts likewise", V2_OPEN
        ),
        Reading(
            STEEPEST_CHECKED,
            "steepest descent, V2 open by default, T = 0.25",
            "a shorter prediction drifts less",
            V2_OPEN,
            0.25,
        ),
    ),
}
"""Readings of the two tanks; the first of each is drawn."""


def try_tank(
    letter: str, reading: Reading, trials: int, threads: int | None
) -> tuple[Policy, MonteCarlo]:
    """Return the policy of a reading of a case, and its trials."""
    problem = problems.plain(f"double-tank-{letter}").replace(
        settings=reading.settings, default=reading.default, horizon=reading.horizon
    )
    policy = synthesize(problem, threads=threads)
    return policy, monte_carlo(policy, trials, rate=RATE, initial=START, threads=threads)


def success_row(letter: str, reading: Reading, result: MonteCarlo) -> Row:
    """Return how many trials of a reading reach the goal."""
    tolerance = {"a": 0.1, "b": 0.05}[letter]
    return Row(
        f"success of case {letter.upper()}, tolerance {tolerance}: {reading.text}",
        "1,000 of 1,000",
        successes(result),
        reading.why,
    )


def cost_row(letter: str, result: MonteCarlo) -> Row:
    """Return how many trials lower the cost J."""
    moved = result.times > 0
    fallen = result.final_cost[moved] < result.initial_cost[moved]
    return Row(
        f"trials of case {letter.upper()} that lower the cost J",
        "all" if letter == "b" else "shown falling",
        f"{int(fallen.sum()):,} of {int(moved.sum()):,}",
        "trials that begin outside the target; J of the default prediction, first and last state",
    )


def figure_5() -> Figure:
    """Return Fig. 5: the two tanks."""
    figure = new_figure(6, 4)
    draw_tanks(figure.add_subplot())
    return figure


def figure_6(policy: Policy, result: MonteCarlo, threads: int | None) -> Figure:
    """Return Fig. 6: policy, end states of trials, cost against time."""
    target, domain = policy.target, policy.space
    assert isinstance(target, Ball)
    figure = new_figure(11, 6)
    left, right = halves(figure, True, (3, 2))
    plot_policy(policy, ax=left.subplots())
    upper, lower = right.subplots(2, 1)
    labels = list(zip(domain.names, domain.units))
    first, last = result.initial[:SHOWN], result.final[:SHOWN]
    draw_end_states(first, last, target.center, target.radius, labels, upper)
    duration = float(result.times[:TRACED].max())
    paths = simulate(
        policy, result.initial[:TRACED], duration, RATE, stop_at_target=True, threads=threads
    )
    every = slice(None, None, 10)
    states = paths.states[:, every]
    costs = np.full(states.shape[:2], np.nan)
    known = np.isfinite(states).all(axis=-1)
    costs[known] = default_costs(policy, states[known])
    draw_costs(paths.times[every], costs, lower)
    return figure
