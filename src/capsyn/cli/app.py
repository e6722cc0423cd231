"""The command line: words in, tables out; no numerics."""

from __future__ import annotations

import dataclasses
import sys
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsyn.cli.better.improve import improve
from capsyn.cli.better.tune import tune
from capsyn.cli.compression import automaton, compress
from capsyn.cli.console import notes, print_table, progress_bars, show, working
from capsyn.cli.doctor import doctor
from capsyn.cli.evidence import switching, verify
from capsyn.cli.export import export
from capsyn.cli.import_table import import_table
from capsyn.cli.look import at, explore, query
from capsyn.cli.loop import simulate
from capsyn.cli.options import (
    Backend,
    Current,
    Dask,
    File,
    Json,
    LimitOptions,
    MinDwell,
    Outside,
    OutsideAtOnce,
    Seed,
    SwitchingOptions,
    Threads,
    assignments,
    executor,
    flat,
    number,
    option,
    whole_number_list,
)
from capsyn.cli.paper import bench, reproduce
from capsyn.cli.printed import print_report
from capsyn.cli.proofs.certify import certify, check
from capsyn.errors import CapsynError, CapsynWarning, ProblemError

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.modelling.settings import SsacSettings

app = typer.Typer(
    name="capsyn",
    help="Control alphabet policies: from a nonlinear model and a list of actuator settings to a "
    "controller small enough for any machine.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


def _version(wanted: bool) -> None:
    if wanted:
        from capsyn.version import __version__

        typer.echo(f"capsyn {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    pass


@app.command("list")
def list_problems(as_json: Json = False) -> None:
    """List the built-in problems."""
    from capsyn import problems

    built_in = [problems.get(name) for name in problems.names()]
    rows: list[dict[str, Any]] = [
        {
            "name": p.name,
            "states": p.domain.n,
            "exogenous": list(p.space.names[p.domain.n :]),
            "symbols": len(p.alphabet),
            "max_level": p.max_level,
            "leaves": p.leaves,
            "description": p.description,
        }
        for p in built_in
    ]
    shown = [row | {"exogenous": ", ".join(row["exogenous"])} for row in rows]
    show(as_json, rows, lambda: print_table(shown))


@dataclass(frozen=True)
class ProblemOptions:
    """What is made of a problem where its own horizon, default or grid is not wanted."""

    output: str | None = option("Default: NAME.cap", "--output", "-o", metavar="FILE")
    horizon: float | None = option("Prediction horizon [time unit].")
    tail: str | None = option(
        "Cost to go: riccati[:EFFORT], which also sets a horizon, fit (to closed loops), or none."
    )
    default: str | None = option("Control of the prediction.", metavar="U[,U..]")
    max_level: int | None = option("Most times that a cell is split along an axis.")
    partitions: str | None = option("Cells of the root grid per axis.", metavar="Q[,Q..]")
    refinement: str | None = option("Children of a split cell per axis.", metavar="R[,R..]")
    leaves: str | None = option("constant, or affine for far fewer solves.")
    tuned: str | None = option(
        "Settings that capsyn tune found, for what is free.", "--settings", metavar="FILE"
    )
    source: str = option(
        "Whose symbols: those of sSAC, or the best for closed loops of time T [default: 10 "
        "horizons], of at most three states.",
        default="ssac",
        metavar="ssac|optimum[:T]",
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

    rule: str | None = option("schedule or steepest.")
    gamma: float | None = option("Wanted sensitivity over cost.")
    alpha_d: float | None = option("Wanted sensitivity, absolute.")
    control_weight: float | None = option("Weight R of the effort.")
    on_no_descent: str | None = option("best or default.")
    steps: int | None = option("Integration steps over the horizon.")
    tolerance: float | None = option("Of the step-doubling check.")
    precision: str | None = option("double or single.")

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
        "vertices or center+faces, then +center, +edge_midpoints, +random:R.",
        default="vertices+center",
    )
    leaf_error: float = option("Of affine leaves, accepted share.", default=0.01)
    refine: str = option(
        "isotropic, or adaptive: split along the axes that matter.", default="isotropic"
    )
    seed: Seed = 0
    max_solves: int | None = option("Most solves; affine or adaptive cells spend them.")
    max_seconds: float | None = option("Stop after so long [s]; the result depends on the machine.")
    max_memory: str | None = option("Stop before so much, as 2GB.", metavar="BYTES")
    memory_limit: str | None = option(
        "Refuse what may take more at worst [default: what is available].", metavar="BYTES"
    )
    backend: Backend = "auto"
    threads: Threads = None


@app.command()
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
            metavar="DIR", help="Keep what is solved there; a run that was killed goes on from it."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Make the control alphabet policy of a problem."""
    from capsyn.cli.better.optimum import optimal_policy
    from capsyn.policies.report import report
    from capsyn.synthesis.synthesize import synthesize
    from capsyn.verification.switching_curve import chatter_hint

    chosen, path = _chosen_problem(problem, changes)
    chosen = chosen.replace(switching=switching.of(chosen))
    own, options = settings.of(chosen.settings), changes.grid() | vars(subdivision)
    rules: dict[str, Any] = {
        "outside": outside,
        "min_dwell": min_dwell,
        "outside_at_once": outside_at_once,
        "delay": switching.delay,
    }
    if changes.source != "ssac":
        unused = {"settings of sSAC": own, "--dask": dask, "--checkpoint": checkpoint}
        unused["--keep-limits"] = limits.of() or None
        policy = optimal_policy(chosen, changes.source, options, rules, unused)
        hint = None
    else:
        with (
            executor(dask) as client,
            progress_bars() as progress,
            notes("capsyn.execution.checkpoint"),
        ):
            more = options | rules | {"executor": client, "checkpoint": checkpoint}
            more["keep_limits"] = limits.of()
            policy = synthesize(chosen, settings=own, progress=progress, **more)
        hint = chatter_hint(policy, subdivision.threads)
    policy.save(path)
    data = report(policy) | {"file": path, "seconds": policy.timings}
    if hint is not None:
        data["hints"] = [*data["hints"], hint]
    end = f"wrote {path} in {sum(policy.timings.values()):.2f} s"
    show(as_json, data, lambda: print_report(data), end)


def _chosen_problem(text: str, changes: ProblemOptions) -> tuple[Problem, str]:
    """Return the problem that a text names, changed, and the path of its policy, checked."""
    from capsyn.cli.better.tune import problem_of
    from capsyn.execution.files import check_writable

    if changes.output is not None:
        check_writable(changes.output)
    problem = problem_of(text, changes.tuned)
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
        return problem, changes.output
    path = f"{problem.name}.cap"
    if "/" in path:
        raise ProblemError(f"the name '{problem.name}' makes no file name; give one with -o")
    check_writable(path)
    return problem, path


@app.command()
def info(
    file: File,
    quick: Annotated[
        bool, typer.Option("--quick", help="Leave out how complex the policy is.")
    ] = False,
    proof: Annotated[
        str | None,
        typer.Option(
            metavar="POLICY",
            help="Prove again what an exact or free tree guarantees of the policy in this file.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what a policy is, how complex, and what smells."""
    from capsyn.policies.policy import Policy
    from capsyn.policies.report import report

    policy = Policy.load(file)
    data = report(policy)
    if proof is not None:
        from capsyn.compression.proof import prove

        data["proof"] = {"policy": proof, "changed": prove(policy, Policy.load(proof))}
    if not quick:
        from capsyn.compression.complexity import complexity

        with working("how complex"):
            data["complexity"] = complexity(policy)
    show(as_json, data, lambda: print_report(data))


@app.command()
def plot(
    file: File,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FILE", help="A .png, .pdf or .svg file.")
    ],
    plane: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Two states or exogenous inputs.")
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Another's value; may be repeated."),
    ] = None,
    outlines: Annotated[bool, typer.Option(help="Outline the cells.")] = True,
    current: Current = None,
) -> None:
    """Draw the cells of a policy in the plane of two states."""
    from capsyn.execution.files import check_writable
    from capsyn.plots.figure import check_format
    from capsyn.plots.policy import save_policy_plot
    from capsyn.policies.policy import Policy

    check_format(output)
    check_writable(output)
    policy = Policy.load(file)
    names = policy.space.names
    axes = tuple(name.strip() for name in plane.split(",")) if plane else names[:2]
    values = {name: number(name, text) for name, text in assignments("--at", at or []).items()}
    save_policy_plot(policy, output, axes, values, outlines, current=current)
    typer.echo(f"wrote {output}")


app.command(context_settings={"ignore_unknown_options": True})(query)  # -1 is no option
app.command()(at)
app.command("import")(import_table)
app.command()(improve)
app.command()(tune)
app.command()(compress)
app.command()(automaton)
app.command()(export)
app.command()(explore)
app.command()(simulate)
app.command()(verify)
app.command()(certify)
app.command()(check)
app.command()(switching)
app.command()(bench)
app.command()(reproduce)
app.command()(doctor)


def main() -> None:
    """Run the command line; an error is one line on stderr and exit status 2."""
    warnings.showwarning = _show_warning
    # ClickException, wherever this Typer keeps its click
    click_error: Any = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")
    try:
        status = typer.main.get_command(app).main(standalone_mode=False)
    except CapsynError as error:
        _fail(str(error))
    except typer.Abort:
        status = INTERRUPTED  # what other versions of Typer return
    except click_error as error:
        text = error.format_message()
        if text:
            _fail(text)
        status = 2  # the help has been printed
    except (OSError, MemoryError) as error:
        _fail(f"{type(error).__name__}: {error}")
    if status == INTERRUPTED:
        print("interrupted", file=sys.stderr)
    sys.exit(status if isinstance(status, int) else 0)


def _fail(message: str) -> None:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


def _show_warning(message: Any, category: type[Warning], *rest: Any, **more: Any) -> None:
    kind = "" if issubclass(category, CapsynWarning) else f"{category.__name__}: "
    print(f"warning: {' '.join(f'{kind}{message}'.split())}", file=sys.stderr)
