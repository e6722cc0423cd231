"""Commands that make a policy small and show it as an automaton."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from capsyn.cli.console import print_table, show, working
from capsyn.cli.options import Backend, File, Json, Seed, flat, option
from capsyn.cli.printed import print_automaton, print_compression
from capsyn.errors import ProblemError


@dataclass(frozen=True)
class CompressOptions:
    """Options of ``capsyn compress``."""

    mode: str = option("exact, freedom or linear.", default="exact")
    output: str | None = option(
        "The tree [default: FILE-MODE.cap]; with --curve a .png, .pdf or .svg picture, with a .csv "
        "beside it [default: FILE-curve.png].",
        "--output",
        "-o",
        metavar="FILE",
    )
    agreement: float | None = option(
        "Least agreement, for freedom and linear [default for linear: 0.99]."
    )
    level: int | None = option("Merge cells below this level first; not for linear.")
    node_price: float | None = option(
        "For freedom: finest cells of disagreement that a node less is worth [default: 0.5]."
    )
    features: str | None = option(
        "Functions of x (and w) that splits may compare: a dict `features` in the file, by name.",
        metavar="FILE.py[:NAME]",
    )
    curve: bool = option("Size against agreement, by mode and level.", "--curve", default=False)
    states: int = option("Random states that trees are judged at.", default=100_000)
    seed: Seed = 0
    backend: Backend = "auto"


@flat
def compress(file: File, options: CompressOptions, as_json: Json = False) -> None:
    """Make a small decision tree of a policy.

    Exit status 1: the tree was written, but does not reach the agreement asked for.
    """
    if options.curve:
        _curve(file, options, as_json)
    else:
        _tree(file, options, as_json)


def _tree(file: str, options: CompressOptions, as_json: bool) -> None:
    from capsyn.cli.problem_finder import find_features
    from capsyn.compression.compress import compress
    from capsyn.execution.files import check_writable
    from capsyn.policies.policy import Policy
    from capsyn.policies.report import report

    path = options.output
    if path is None:  # in the working directory, named after the policy's file
        path = f"{Path(file).stem}-{options.mode}.cap"
    check_writable(path)
    if Path(path).resolve() == Path(file).resolve():
        raise ProblemError(f"the output must be another file than the policy; got '{path}'")
    policy = Policy.load(file)
    features = None if options.features is None else find_features(options.features)
    with working(f"compressing, mode {options.mode}"):
        names = "mode agreement level node_price states seed backend".split()
        tree = compress(
            policy, **{name: getattr(options, name) for name in names}, features=features
        )
    tree.save(path)
    data = report(tree) | {"file": path}
    show(as_json, data, lambda: print_compression(data, report(policy)), f"wrote {path}")
    if not tree.guarantee.reached:
        raise typer.Exit(1)


def _curve(file: str, options: CompressOptions, as_json: bool) -> None:
    from capsyn.compression.curve import size_curve
    from capsyn.execution.files import check_writable, save_points
    from capsyn.plots.curve import save_curve_plot
    from capsyn.plots.figure import check_format
    from capsyn.policies.policy import Policy

    for_one = {
        "--agreement": options.agreement,
        "--level": options.level,
        "--node-price": options.node_price,
        "--features": options.features,
    }
    wrong = [name for name, value in for_one.items() if value is not None]
    if wrong or options.mode != "exact":
        raise ProblemError(f"--curve tries all modes and takes no {', '.join(wrong) or '--mode'}")
    policy = Policy.load(file)
    picture = f"{Path(file).stem}-curve.png" if options.output is None else options.output
    check_format(picture)
    table = str(Path(picture).with_suffix(".csv"))
    for path in (picture, table):
        check_writable(path)
    with working("trying modes and levels") as say:
        judged: dict[str, Any] = {
            "states": options.states,
            "seed": options.seed,
            "backend": options.backend,
        }
        points = size_curve(policy, **judged, progress=say)
    save_points(points, table)
    save_curve_plot(points, policy.name, picture)
    rows = [point.to_json() for point in points]
    data = {"points": rows, "table": table, "picture": picture}
    end = f"wrote {table} and {picture}"
    show(as_json, data, lambda: print_table([_shown(row) for row in rows]), end)


def _shown(row: dict[str, Any]) -> dict[str, Any]:
    shares = {name: f"{row[name]:.3%}" for name in ("agreement", "low", "high")}
    level = "" if row["level"] is None else str(row["level"])
    smallest = "*" if row["smallest"] else ""
    return row | shares | {"level": level, "smallest": smallest}


def automaton(
    file: File,
    output: Annotated[
        str | None,
        typer.Option("--output", "-o", metavar="FILE", help="A .dot, .svg, .png or .pdf file."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Show a policy as a finite state machine, and the switches that its loop can take."""
    from capsyn.automata.automaton import Automaton
    from capsyn.execution.files import check_writable
    from capsyn.plots.automaton import check_drawing, save_automaton
    from capsyn.policies.policy import Policy

    if output is not None:
        check_drawing(output)
        check_writable(output)
    with working("looking at faces"):
        machine = Automaton.of(Policy.load(file))
    if output is not None:
        save_automaton(machine, output)
    data = machine.to_json()
    end = None if output is None else f"wrote {output}"
    show(as_json, data, lambda: print_automaton(data), end)
