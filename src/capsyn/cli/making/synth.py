"""The command that makes the policy of a problem."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsyn.cli.console import notes, progress_bars, show
from capsyn.cli.making.source import kind_of, sourced_policy
from capsyn.cli.options import (
    Backend,
    Dask,
    Json,
    LimitOptions,
    MinDwell,
    Outside,
    OutsideAtOnce,
    Seed,
    SwitchingOptions,
    Threads,
    executor,
    flat,
    number,
    option,
    whole_number_list,
)
from capsyn.cli.printed import print_report
from capsyn.errors import ProblemError
from capsyn.execution.interrupts import advise

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.modelling.settings import SsacSettings
    from capsyn.policies.policy import Policy


NO_FILE_NAME = set('/\\:*?"<>|')
"""Characters that a file's name cannot have on every system; after a colon Windows hides a file."""


@dataclass(frozen=True)
class ProblemOptions:
    """What is made of a problem where its own horizon, default or grid is not wanted."""

    output: str | None = option(
        "The policy file [default: NAME.cap].", "--output", "-o", metavar="FILE"
    )
    horizon: float | None = option("Prediction horizon [time unit, or samples].")
    tail: str | None = option(
        "Terminal cost for the time after the horizon: riccati[:EFFORT], which also sets a "
        "horizon, fit (fitted to closed loops), or none."
    )
    default: str | None = option("Default control, which predictions use.", metavar="U[,U..]")
    max_level: int | None = option("How often a cell may be split along an axis.")
    partitions: str | None = option("Cells of the root grid along each axis.", metavar="Q[,Q..]")
    refinement: str | None = option("Children of a split cell along each axis.", metavar="R[,R..]")
    leaves: str | None = option("Leaves of the policy: constant, or affine for far fewer solves.")
    tuned: str | None = option(
        "File of settings that capsyn tune found, for the problem's free settings.",
        "--settings",
        metavar="FILE",
    )
    alphabet: str | None = option(
        "Another alphabet: the file of a study by capsyn alphabet, or symbols of Python.",
        metavar="FILE.json|FILE.py:NAME",
    )
    source: str = option(
        "The controller whose symbols the policy takes. ssac: sSAC. optimum: the best "
        "symbols for closed loops of time T [default: 10 horizons], for at most three "
        "states. fcs: predictive control with a finite control set, with DEPTH symbols held "
        "for BLOCK samples each. FILE.py:NAME: a function from states to symbols, or an "
        "agent with predict.",
        default="ssac",
        metavar="ssac|optimum[:T]|fcs:DEPTH[:BLOCK,..]|FILE.py:NAME",
    )

    def grid(self) -> dict[str, Any]:
        """Return the arguments of `capsyn.synthesize` for the grid; None: the problem's own."""
        return {
            "partitions": whole_number_list("--partitions", self.partitions),
            "refinement": whole_number_list("--refinement", self.refinement),
            "max_level": self.max_level,
            "leaves": self.leaves,
        }


@dataclass(frozen=True)
class SettingsOptions:
    """Fields of `capsyn.SsacSettings`; None leaves the problem's own."""

    rule: str | None = option("Rule that chooses a symbol: schedule or steepest.")
    gamma: float | None = option("Wanted sensitivity divided by the cost, 0 or less.")
    alpha_d: float | None = option("Wanted sensitivity as an absolute value, 0 or less.")
    control_weight: float | None = option("Weight R of the control effort u^T R u.")
    on_no_descent: str | None = option(
        "What a state gets if no symbol lowers the cost: best (the best symbol all the same) or "
        "default."
    )
    steps: int | None = option("Integration steps over the horizon [default: chosen].")
    tolerance: float | None = option("Tolerance of the check that chooses the steps.")
    precision: str | None = option("Floating-point precision of the solves: double or single.")
    sensitivity: str | None = option(
        'How a model in discrete time tells what a symbol is worth: exact or "first order".'
    )
    sample_time: float | None = option(
        "Sample time of closed loops [time unit] [default: the problem's, or about a "
        "hundredth of the horizon]."
    )

    def of(self, settings: SsacSettings) -> SsacSettings | None:
        """Return a problem's settings with these changes; None where there are none."""
        changes = {name: value for name, value in vars(self).items() if value is not None}
        if "alpha_d" in changes and "gamma" not in changes:
            changes["gamma"] = type(settings).gamma  # the problem's own gamma gives way
        if "gamma" in changes and "alpha_d" not in changes:
            changes["alpha_d"] = None
        return dataclasses.replace(settings, **changes) if changes else None


@dataclass(frozen=True)
class SubdivisionOptions:
    """Arguments of `capsyn.synthesize` for the subdivision."""

    test_points: str = option(
        "Points of a cell that are solved: vertices or center+faces, then +center, "
        "+edge_midpoints, +random:R.",
        default="vertices+center",
    )
    leaf_error: float = option(
        "Largest estimated share of an affine leaf in which it may be wrong.", default=0.01
    )
    refine: str = option(
        "How cells are split: isotropic (along all axes) or adaptive (along the axes that matter).",
        default="isotropic",
    )
    seed: Seed = 0
    max_solves: int | None = option(
        "Most solves. Affine leaves and adaptive splits spend all of them."
    )
    max_seconds: float | None = option(
        "Stop after this time [s]. The result then depends on the machine."
    )
    max_memory: str | None = option(
        "Stop before this much memory is taken, as 2GB.", metavar="BYTES"
    )
    memory_limit: str | None = option(
        "Refuse a run that may take more memory at worst [default: the available memory].",
        metavar="BYTES",
    )
    backend: Backend = "auto"
    threads: Threads = None


@flat
def synth(
    problem: Annotated[
        str,
        typer.Argument(
            metavar="PROBLEM",
            help="A built-in name, path/to/file.py[:name] or package.module:name.",
        ),
    ],
    *,
    changes: ProblemOptions,
    settings: SettingsOptions,
    outside: Outside = None,
    min_dwell: MinDwell = None,
    outside_at_once: OutsideAtOnce = None,
    switching: SwitchingOptions,
    limits: LimitOptions,
    subdivision: SubdivisionOptions,
    dask: Dask = None,
    checkpoint: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            help="Folder that keeps all solves. A run that was killed goes on from there.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Make the control alphabet policy of a problem."""
    advise(
        "--checkpoint DIR would keep what is solved for the next run"
        if checkpoint is None
        else f"the same command goes on from what '{checkpoint}' keeps"
    )
    from capsyn.policies.report import report
    from capsyn.verification.switching_curve import chatter_hint

    chosen, path, told = _chosen_problem(problem, changes)
    chosen = chosen.replace(switching=switching.of(chosen))
    _check_sample_time(chosen, settings.sample_time)
    own, options = settings.of(chosen.settings), changes.grid() | vars(subdivision)
    rules: dict[str, Any] = {
        "outside": outside,
        "min_dwell": min_dwell,
        "outside_at_once": outside_at_once,
        "delay": switching.delay,
    }
    hint = None
    if kind_of(changes.source) == "ssac":
        more = {"checkpoint": checkpoint, "keep_limits": limits.of()}
        policy = _synthesized(chosen, own, options | rules | more, dask)
        hint = chatter_hint(policy, subdivision.threads)
    else:
        unused = {"--dask": dask, "--checkpoint": checkpoint, "--keep-limits": limits.of() or None}
        given = {name: value for name, value in vars(settings).items() if value is not None}
        policy = sourced_policy(chosen, changes.source, options, rules, given, unused)
    policy = dataclasses.replace(policy, statistics=policy.statistics | told)
    policy.save(path)
    data = report(policy) | {"file": path, "seconds": policy.timings}
    if hint is not None:
        data["hints"] = [*data["hints"], hint]
    end = f"wrote {path} in {sum(policy.timings.values()):.2f} s"
    show(as_json, data, lambda: print_report(data), end)


def _check_sample_time(problem: Problem, given: float | None) -> None:
    """Raise `ProblemError` where a sample time is given that is not that of a problem's map."""
    if problem.discrete and given not in (None, problem.sample_time):
        raise ProblemError(
            f"--sample-time must be left out, or be {problem.sample_time:g}, that of the problem's "
            f"map; got {given:g}"
        )


def _synthesized(
    problem: Problem, settings: SsacSettings | None, options: dict[str, Any], dask: str | None
) -> Policy:
    """Return the policy of a problem by sSAC."""
    from capsyn.synthesis.synthesize import synthesize

    with (
        executor(dask) as client,
        progress_bars() as progress,
        notes("capsyn.execution.checkpoint"),
    ):
        return synthesize(problem, settings=settings, progress=progress, executor=client, **options)


def _chosen_problem(text: str, changes: ProblemOptions) -> tuple[Problem, str, dict[str, Any]]:
    """Return the problem that a text names, changed, and the path of its policy, checked.

    Then comes what the policy's statistics say of how the problem was chosen.
    """
    from capsyn.cli.better.given_alphabet import with_given_alphabet
    from capsyn.cli.better.tune import problem_of
    from capsyn.execution.files import check_writable

    if changes.output is not None:
        check_writable(changes.output)
    problem, told = problem_of(text, changes.tuned), dict[str, Any]()
    if changes.alphabet is not None:
        problem, told = with_given_alphabet(problem, changes.alphabet)
    if changes.tail in ("none", "fit"):
        problem = problem.replace(tail=None if changes.tail == "none" else changes.tail)
    elif changes.tail is not None:
        problem = problem.replace(tail=changes.tail, horizon=changes.horizon)
    if changes.horizon is not None:
        problem = problem.replace(horizon=changes.horizon)
    if changes.default is not None:
        values = [number("--default", u) for u in changes.default.split(",")]
        problem = problem.replace(default=values)
    if changes.output is not None:
        return problem, changes.output, told
    path = f"{problem.name}.cap"
    if set(path) & NO_FILE_NAME:
        raise ProblemError(f"the name '{problem.name}' makes no file name; give one with -o")
    check_writable(path)
    return problem, path, told
