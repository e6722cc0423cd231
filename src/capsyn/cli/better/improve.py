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
        "The policy [default: FILE-improved.cap].", "--output", "-o", metavar="FILE"
    )
    rounds: int = option("Most rounds; they end where the cost no longer falls.", default=1)
    horizons: str | None = option(
        "Horizons of the rollouts to try [time unit] [default: 0.4 to 2 of the policy's; beyond "
        "four states, of the policies with tails, 0.25 and 0.5].",
        metavar="T[,T..]",
    )
    rate: float | None = option("Samples per time unit [default: 1 over the policy's sample time].")
    duration: float | None = option(
        "Time of the closed loops that judge [time unit] [default: 10 horizons of the policy]."
    )
    initial: str | None = option(f"Where they start: {INITIAL}", metavar="SET")
    starts: int = option("Starts that judge a round.", default=400)
    confidence: float = option("Of the intervals that judge it.", default=0.95)
    scale: float | None = option(
        "What effort and prices count in closed loop [default: as much as for the controller]."
    )
    max_level: int | None = option(
        "Most times that a cell is split along an axis [default: the policy's]."
    )
    max_solves: int | None = option(
        "Most solves of a policy [default: 4 times the policy's; with tails, as many]."
    )
    seed: Seed = 0
    backend: Backend = "auto"
    threads: Threads = None


@flat
def improve(file: File, *, options: ImproveOptions, as_json: Json = False) -> None:
    """Make a better policy, judged in closed loop; the same one where none is.

    By rollouts up to four states, by fitted tails beyond.
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
