"""What the command line makes of an optimum: evidence of how far a policy is from it, a policy."""

from __future__ import annotations

import dataclasses
import time
from typing import TYPE_CHECKING, Any

from capsyn.cli.console import print_line
from capsyn.cli.loop import exogenous_inputs
from capsyn.cli.options import number, starts, whole_number_list
from capsyn.errors import ProblemError
from capsyn.modelling.discrete import horizon_time
from capsyn.verification.sentences import vector

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.policies.policy import Policy

HORIZONS = 10
"""Prediction horizons that loops take unless told."""
MOST_STATES = 3
"""Most states of a policy whose symbols are the optimum's."""


def compare_with_optimum(policy: Policy, options: Any, client: Any) -> dict[str, Any]:
    """Return how far a policy is from the optimum, as plain data, and draw it where that is asked.

    `options` are those of ``capsyn verify``.
    """
    from capsyn.execution.files import check_writable
    from capsyn.optima.optimum import optimum
    from capsyn.plots.figure import check_format
    from capsyn.plots.optimum import save_optimum_plot

    if options.output is not None:
        check_format(options.output)
        check_writable(options.output)
    duration = options.duration
    if duration is None:
        duration = HORIZONS * (horizon_time(policy) or 1.0)
    best = optimum(
        policy,
        duration,
        rate=options.rate,
        counts=whole_number_list("--counts", options.counts),
        starts=options.optimum,
        initial=starts(options.initial, policy.domain.names),
        seed=options.seed,
        exogenous=exogenous_inputs(options.exogenous),
        control_weight=options.control_weight or 0.0,
        memory=options.memory,
        backend=options.backend,
        threads=options.threads,
    )
    comparison = best.compare(
        policy,
        outside=options.outside,
        backend=options.backend,
        threads=options.threads,
        confidence=options.confidence,
    )
    if options.output is not None:
        save_optimum_plot(comparison, policy.domain, policy.name, options.output)
    picture = {} if options.output is None else {"picture": options.output}
    return best.to_json() | comparison.to_json() | {"time_unit": policy.time_unit} | picture


def print_optimum(data: dict[str, Any], headline: str, *_: Any) -> None:
    """Print how far a policy is from the optimum, and where most."""
    unit, worst = data["time_unit"], data["worst"]
    print_line("optimum", headline)
    if data["optimal_cost"] is not None:
        print_line(
            "cost",
            f"{data['cost']:.4g} on average, {data['optimal_cost']:.4g} at best: "
            f"{data['objective']}; over {data['duration']:g} {unit}",
        )
    start = ", ".join(f"{name} = {value:.4g}" for name, value in worst["start"].items())
    cost, least = (_number(worst[key]) for key in ("cost", "optimal_cost"))
    print_line("worst from", f"{start}: {cost} instead of {least}")
    if data["lost"]:
        print_line("ended early", f"{data['lost']:,} loops, which the average leaves out")
    counts, error = " x ".join(map(str, data["counts"])), data["grid_error"]
    box = f"{vector(data['lower'])} to {vector(data['upper'])}"
    off = "" if error is None else f", whose values are off by {error:.2%}"
    print_line("grid", f"{counts} over {box}, {data['memory'] / 1e6:.3g} MB{off}")
    if data["left"]:
        print_line("no bound", f"{data['left']:,} of the best loops leave the grid nevertheless")
    elif data["beaten"]:
        print_line("no bound", "the policy costs less: the grid is too coarse, see --counts")
    elif not data["bound"]:
        print_line("no bound", "the grid is too coarse, see --counts")
    if "picture" in data:
        print_line("picture", data["picture"])


def _number(value: float | None) -> str:
    return "no end" if value is None else f"{value:.4g}"


def optimal_policy(problem: Problem, source: str, options: dict[str, Any]) -> Policy:
    """Return the policy of a problem whose symbols are the optimum's, with the seconds it took.

    `source` is ``optimum``, or ``optimum:T`` for loops of time T; `options` are those of
    `capsyn.subdivide`, and the backend; what is None is the problem's own.
    """
    from capsyn.execution.processors import processors
    from capsyn.optima.optimum import optimum

    _, colon, text = source.partition(":")
    if problem.domain.n > MOST_STATES:
        raise ProblemError(
            f"--source optimum is for at most {MOST_STATES} states; got {problem.domain.n}"
        )
    duration = (
        number("--source optimum:T, its T,", text)
        if colon
        else HORIZONS * (horizon_time(problem) or 0.0)
    )
    given = {key: value for key, value in options.items() if value is not None}
    backend, threads = given.pop("backend"), processors(given.get("threads"))
    best = optimum(problem, duration, backend=backend, threads=threads)
    began = time.perf_counter()
    policy = best.policy(problem, **given | {"threads": threads})
    seconds = {"optimum": best.seconds, "subdivision": time.perf_counter() - began}
    return dataclasses.replace(policy, timings=seconds)
