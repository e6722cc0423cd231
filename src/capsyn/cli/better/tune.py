"""The command that finds the free settings of a problem, and files of settings."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsyn.cli.better.searches import SearchTexts
from capsyn.cli.console import print_line, print_table, show, working
from capsyn.cli.options import Json, assignments, flat, listed, number, option
from capsyn.errors import ProblemError, warn
from capsyn.modelling.time_unit import NAMES
from capsyn.validation import describe

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.tuning.free import Free
    from capsyn.tuning.tune import Tuning

SHOWN = 20
"""Most settings of the front that are printed."""


@dataclass(frozen=True)
class TuneOptions(SearchTexts):
    """Options of ``capsyn tune``."""

    output: str | None = option(
        "The file of the settings [default: NAME-tuned.json].",
        "--output",
        "-o",
        metavar="FILE",
        before="duration",
    )
    free: list[str] | None = option(
        "A free setting beside the free arguments of the function. For any problem: "
        "horizon, control_weight, gamma, rule, price (a range of numbers or shares) and "
        "tail (a range of its effort). May be repeated.",
        metavar="NAME=LOW:HIGH|NAME=A,B[,..]",
        before="duration",
    )
    success: float | None = option("Least share of loops that must succeed.", before="duration")
    least: str | None = option(
        "The figure to make least: cost, effort, switches, nodes, or knee (few switches at "
        "little more than the least cost) [default with --success: cost].",
        before="duration",
    )
    trials: int = option("Number of settings to try.", default=60, before="duration")
    starts: int = option("Number of closed loops of a trial.", default=200, before="duration")
    fresh: int = option(
        "Number of closed loops that judge the best settings.", default=1000, before="duration"
    )
    storage: str | None = option(
        "Where the trials are kept: a SQLite file, a .journal, or the URL of a database. A "
        "search that was killed goes on from there. Several processes may share the search.",
        metavar="FILE|URL",
        before="duration",
    )
    cost: str | None = option(
        "Cost of loops, a function of x (and w) [default: the problem's cost, with all free "
        "settings in the middle of their ranges].",
        metavar="FILE.py:NAME",
        before="duration",
    )
    effort: str | None = option(
        "Effort of a control, a function of u [default: u^T u].",
        metavar="FILE.py:NAME",
        before="duration",
    )
    quick: bool = option(
        "Whether a quick stage decides which settings are judged in full.",
        default=True,
        before="duration",
    )


@flat
def tune(
    problem: Annotated[
        str,
        typer.Argument(
            metavar="PROBLEM",
            help="The problem, written as for synth. A file may also have a function with "
            "arguments that are capsyn.Free.",
        ),
    ],
    *,
    options: TuneOptions,
    as_json: Json = False,
) -> None:
    """Find the free settings of a problem that meet a goal in closed loop.

    The exit status is 1 if no settings meet the goal.
    """
    from capsyn.cli.problem_finder import find_function, find_tunable
    from capsyn.execution.files import check_writable
    from capsyn.tuning.family import Family
    from capsyn.tuning.tune import tune

    if options.output is not None:
        check_writable(options.output)
    source = find_tunable(problem)
    free = _free(options.free)
    family = Family.of(source, free)
    base = family(family.middle)
    path = options.output or f"{base.name}-tuned.json"
    check_writable(path)
    names = "success least trials starts fresh quick storage seed backend threads".split()
    given: dict[str, Any] = {name: getattr(options, name) for name in names}
    for name in ("cost", "effort"):
        text = getattr(options, name)
        given[name] = None if text is None else find_function(text)
    loops = options.loops(base)
    with working("looking at the problem") as say:
        result = tune(source, free, synthesis=options.solves, progress=say, **given, **loops)
    result.save(path)
    data = result.to_json() | {"file": path}
    again = f"capsyn synth {problem} --settings {path}{options.synth}"
    show(as_json, data, lambda: _print(result), f"wrote {path}; {again} makes the policy")
    if not result.met:
        typer.echo(f"no settings meet the goal {result.goal}; {_missed(result)}", err=True)
        raise typer.Exit(1)


def _missed(result: Tuning) -> str:
    """Return what the best settings come to where they miss the goal, and what to free next."""
    figures, least = result.figures, result.goal.least
    if result.goal.success is None or (figures.success or 0.0) >= result.goal.success:
        return f"the best has no figure of {least}; {result.advice}"
    return f"the best has success {figures.success:.2%}; {result.advice}"


def _free(texts: list[str] | None) -> dict[str, Free]:
    """Return what is free by name: of ``LOW:HIGH`` a range, of ``A,B`` choices."""
    from capsyn.tuning.free import Free

    found = {}
    for name, text in assignments("--free", texts or []).items():
        low, colon, high = text.partition(":")
        if colon:
            found[name] = Free(_bound(low), _bound(high))
        else:
            found[name] = Free(choices=[_choice(part) for part in listed(text)])
    return found


def _bound(text: str) -> Any:
    return text if text.endswith("%") else number("--free", text)


def _choice(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _print(result: Tuning) -> None:
    """Print the trade-offs, what was found, and what fresh starts say of it."""
    figures, unit = result.figures, result.problem.time_unit
    best = [one for one in result.tried if one.full and one.settings == result.settings][:1]
    traded = [one for one in result.front if one not in best]
    shown = best + sorted(traded, key=lambda one: result.goal.objectives(one.figures))
    shown = sorted(shown[:SHOWN], key=lambda one: result.goal.objectives(one.figures))
    rows = []
    for one in shown:
        own = one.figures
        row: dict[str, Any] = {"trial": one.number}
        row |= {} if own.success is None else {"success": f"{own.success:.1%}"}
        row |= {"mean cost": own.cost, "mean effort": own.effort}
        row |= {f"switches / {unit}": own.switches, "cells": own.cells}
        row |= {} if own.nodes is None else {"nodes": own.nodes}
        rows.append(row | one.settings | {"best": "*" if one.settings == result.settings else ""})
    print_table(rows)
    full = sum(one.full for one in result.tried)
    failed = sum(one.error is not None for one in result.tried)
    unusable = f", {failed} could not be used" if failed else ""
    print_line("goal", str(result.goal))
    print_line("tried", f"{len(result.tried)} settings, {full} in full{unusable}")
    print_line("best", ", ".join(f"{name} = {value}" for name, value in result.settings.items()))
    told = []
    if figures.success is not None:
        told.append(
            f"success {figures.success:.2%} ({figures.low:.2%} to {figures.high:.2%} with 95 % "
            "confidence)"
        )
    told += [f"{n} {getattr(figures, n):.4g}" for n in ("cost", "effort", "nodes")
             if getattr(figures, n) is not None]  # fmt: skip
    told.append(f"{figures.switches:.3g} switches a {NAMES[unit]}")
    told += [f"{figures.lost:,} lost on their way"] if figures.lost else []
    print_line("judged", f"{', '.join(told)}; {figures.starts:,} starts that no trial saw")


def problem_of(text: str, file: str | None) -> Problem:
    """Return the problem that a text names, with the settings in a file where one is given.

    Raises
    ------
    ProblemError
        There is none, or the file holds no settings of it.
    """
    from capsyn.cli.problem_finder import find_problem, find_tunable
    from capsyn.tuning.family import with_settings

    if file is None:
        return find_problem(text)
    source = find_tunable(text)
    try:
        data = json.loads(Path(file).read_text(encoding="utf-8"))
        settings = data["settings"]
        if not isinstance(settings, dict):
            raise TypeError
    except OSError as error:
        raise ProblemError(f"cannot read the settings '{file}': {error.strerror}") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ProblemError(f"'{file}' must be settings as capsyn tune writes them") from None
    owner = describe(data.get("problem"))
    try:
        problem = with_settings(source, settings)
    except ProblemError as error:
        raise ProblemError(f"the settings in '{file}', of problem {owner}: {error}") from None
    if data.get("problem") != problem.name:
        warn(f"the settings in '{file}' were found for problem {owner}, not '{problem.name}'")
    return problem
