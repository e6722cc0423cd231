"""The command that improves a policy by rollouts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from capsyn.cli.console import print_table, show, working
from capsyn.cli.options import (
    INITIAL,
    Backend,
    File,
    Json,
    Seed,
    Threads,
    flat,
    number_list,
    option,
    starts,
)

if TYPE_CHECKING:
    from capsyn.improvement.improve import Improvement


@dataclass(frozen=True)
class ImproveOptions:
    """Options of ``capsyn improve``."""

    output: str | None = option(
        "The file of the better policy [default: FILE-improved.cap].",
        "--output",
        "-o",
        metavar="FILE",
    )
    rounds: int = option(
        "Largest number of rounds. Rounds end when the cost no longer falls.", default=1
    )
    horizons: str | None = option(
        "Horizons of the rollouts to try [time unit] [default: 0.4 to 2 times the policy's. "
        "Beyond four states, horizons of the policies with tails: 0.25 and 0.5 times].",
        metavar="T[,T..]",
    )
    rate: float | None = option("Samples per time unit [default: 1 over the policy's sample time].")
    duration: float | None = option(
        "Time of the closed loops that judge [time unit] [default: 10 horizons of the policy]."
    )
    initial: str | None = option(f"Where they start: {INITIAL}", metavar="SET")
    starts: int = option("Number of starts that judge a round.", default=400)
    confidence: float = option("Confidence of the intervals that judge a round.", default=0.95)
    scale: float | None = option(
        "Factor of effort and prices in closed loop [default: as much as for the controller]."
    )
    max_level: int | None = option(
        "How often a cell may be split along an axis [default: the policy's]."
    )
    max_solves: int | None = option(
        "Most solves of a policy [default: 4 times the policy's, or as many with tails]."
    )
    seed: Seed = 0
    backend: Backend = "auto"
    threads: Threads = None


@flat
def improve(file: File, *, options: ImproveOptions, as_json: Json = False) -> None:
    """Make a better policy, judged in closed loop, or keep the policy if none is better.

    Policies of up to four states are improved by rollouts, and others by fitted tails.
    """
    from capsyn.execution.files import check_writable
    from capsyn.improvement.improve import improve
    from capsyn.policies.policy import Policy

    path = options.output or f"{Path(file).stem}-improved.cap"
    check_writable(path)
    policy = Policy.load(file)
    horizons = options.horizons
    given: dict[str, Any] = vars(options) | {
        "horizons": None if horizons is None else number_list("--horizons", horizons),
        "initial": starts(options.initial, policy.domain.names),
    }
    del given["output"]
    with working("following the policy") as say:
        result = improve(policy, **given, progress=say)
    result.policy.save(path)
    data = result.to_json() | {"file": path}
    show(as_json, data, lambda: _print(result, policy.time_unit), _end(result, path))


def _print(result: Improvement, unit: str) -> None:
    rows = []
    for one in result.rounds:
        outcome = one.result
        horizon = f"{one.horizon:.3g} {unit}" + (" and terminal cost" if one.terminal else "")
        horizon += ", fitted tail" if one.fitted else ""
        rows.append(
            {
                "round": one.round,
                "horizon": horizon,
                "cost before": outcome.before,
                "after": outcome.after,
                "change": f"{outcome.low:+.3g} to {outcome.high:+.3g}",
                "worst before": outcome.worst_before,
                "worst": outcome.worst,
                "lost before": outcome.lost_before,
                "lost": outcome.lost,
                "cells": one.cells,
                "solves": one.solves,
                "kept": one.kept,
            }
        )
    print_table(rows)
    charged = "" if result.scale == 1 else f", effort and prices times {result.scale:.3g}"
    typer.echo(
        f"mean cost of {result.starts} starts over {result.duration:g} {unit} at "
        f"{result.rate:g} / {unit}, fresh in each round{charged}; lost: left the domain, or not "
        "finite"
    )


def _end(result: Improvement, path: str) -> str:
    outcome = result.result
    if not result.improved:
        return f"no round surely lowered the cost: wrote the policy as it was given to {path}"
    told = f"cost {outcome.before:.4g} to {outcome.after:.4g}"
    if outcome.lost_before:
        told += f", lost starts {outcome.lost_before} to {outcome.lost}"
    return f"{told}; wrote {path}"
