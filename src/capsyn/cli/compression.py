"""Commands that make a policy small and show it as an automaton."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsyn.cli.console import print_table, show, working
from capsyn.cli.loop import LoopTexts, loop_options
from capsyn.cli.options import (
    INITIAL,
    File,
    Json,
    flat,
    number_or_range,
    option,
    option_name,
    starts,
)
from capsyn.cli.printed import print_automaton, print_compression
from capsyn.cli.problem_finder import given_source
from capsyn.errors import ProblemError

if TYPE_CHECKING:
    from capsyn.policies.policy import Policy

FOR_LOOPS = ("nodes", "bytes", "target", "trials", "initial", "arrive", "within", "hold")
"""Options beside those of any loop that are for trees which loops judge."""
SHARED = ("seed", "backend")
"""Options of loops that all trees take."""
NOT_ASKED = (*SHARED, "executor", "stop_at_target", "avoid", "stay_in", "costs")
"""Options of loops that `capsyn.compress` does not take among those of trials."""


@dataclass(frozen=True)
class CompressOptions(LoopTexts):
    """Options of ``capsyn compress``."""

    mode: str | None = option(
        "What the tree may do: exact, freedom or linear [default: exact; with --judge loop: "
        "linear].",
        before="duration",
    )
    output: str | None = option(
        "The file of the tree [default: FILE-MODE.cap]. With --curve, a .png, .pdf or .svg "
        "picture, and a .csv file beside the picture [default: FILE-curve.png].",
        "--output",
        "-o",
        metavar="FILE",
        before="duration",
    )
    agreement: float | None = option(
        "Least agreement with the controller, for modes freedom and linear [default for "
        "linear: 0.99].",
        before="duration",
    )
    level: int | None = option(
        "Merge the cells below this level first. Not for mode linear.", before="duration"
    )
    node_price: float | None = option(
        "For mode freedom: how many finest cells of disagreement are worth one node less "
        "[default: 0.5].",
        before="duration",
    )
    features: str | None = option(
        "Functions of x (and w) that splits may compare, by name: the dict `features` of "
        "the file, or the dict NAME.",
        metavar="FILE.py[:NAME]",
        before="duration",
    )
    source: str | None = option(
        "The controller that trees are fitted to and judged by, if the policy's file does "
        "not tell it: a function from states to symbols, or an agent with predict.",
        metavar="FILE.py:NAME",
        before="duration",
    )
    curve: bool = option(
        "Draw the size of trees against their agreement, by mode and level. With --judge "
        "loop, draw the size against the figures of loops, too.",
        "--curve",
        default=False,
        before="duration",
    )
    states: int = option(
        "Number of random states at which trees are judged.", default=100_000, before="duration"
    )
    judge: str = option(
        "What chooses and judges a tree: volume (its agreement), or loop (cost and success "
        "of its closed loops). The options below are for loop.",
        default="volume",
        before="duration",
    )
    nodes: int | None = option("Largest number of nodes of the tree.", before="duration")
    bytes: int | None = option(
        "Largest number of bytes: of the tree's arrays, or with --target of its C code.",
        before="duration",
    )
    target: str | None = option(
        "Processor for whose C code --bytes counts: cortex-m0, cortex-m4, avr or host.",
        metavar="PROCESSOR",
        before="duration",
    )
    trials: int | None = option(
        "Number of closed loops that choose a tree, and of other loops that judge it "
        "[default: 400].",
        before="duration",
    )
    duration: float | None = option(
        "Time limit of a loop [time unit] [default: 10 horizons of the policy]."
    )
    initial: str | None = option(
        f"Where loops start: {INITIAL}",
        metavar="SET",
        before="tolerance",
    )
    arrive: str | None = option(
        "Where the loops must arrive, written as --target of verify [default: the policy's "
        "target].",
        metavar="SET",
        before="tolerance",
    )
    within: float | None = option(
        "Time within which a loop must arrive [time unit].", before="model"
    )
    hold: float | None = option(
        "Time at the end for which a loop must stay in the target [time unit] [default: 0].",
        before="model",
    )

    def of_loops(self, policy: Policy) -> dict[str, Any]:
        """Return the arguments of `compress` that are for trees that loops judge; else none."""
        own = set(FOR_LOOPS) | {f.name for f in dataclasses.fields(LoopTexts)} - {*SHARED}
        given = [name for name in own if getattr(self, name) is not None]
        if self.judge != "loop":
            if given:
                raise ProblemError(f"{option_name(min(given))} is for --judge loop only")
            return {}
        if self.target is not None and self.bytes is None:
            raise ProblemError("--target needs --bytes")
        loop = loop_options(
            policy,
            dataclasses.replace(self, target=self.arrive, duration=self.duration or 1.0),
            one=number_or_range,
            each=number_or_range,
        )
        names = [f.name for f in dataclasses.fields(loop) if f.name not in NOT_ASKED]
        asked = {name: getattr(loop, name) for name in names} | {"duration": self.duration}
        asked |= {name: getattr(self, name) for name in ("trials", "within", "hold")}
        if self.initial is not None:
            asked["initial"] = starts(self.initial, policy.domain.names)
        return {name: value for name, value in asked.items() if value is not None}

    def budget(self) -> dict[str, Any]:
        """Return what the tree may take."""
        size = None
        if self.target is not None:
            from capsyn.exports.c.code_size import CodeSize

            size = CodeSize(self.target)
        return {"nodes": self.nodes, "bytes": self.bytes, "size": size}


@flat
def compress(file: File, *, options: CompressOptions, as_json: Json = False) -> None:
    """Make a small decision tree of a policy.

    Exit status 1: the tree was written, but does not reach the agreement asked for, does not fit,
    or loses more than a tenth against the policy in closed loop.
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

    path, mode = options.output, options.mode or ("linear" if options.judge == "loop" else "exact")
    if path is None:  # in the working directory, named after the policy's file
        path = f"{Path(file).stem}-{mode}.cap"
    check_writable(path)
    if Path(path).resolve() == Path(file).resolve():
        raise ProblemError(f"the output must be another file than the policy; got '{path}'")
    policy = Policy.load(file)
    features = None if options.features is None else find_features(options.features)
    given = options.of_loops(policy) | options.budget()
    with working(f"compressing, mode {mode}") as say:
        names = "agreement level node_price states seed backend judge".split()
        given |= {name: getattr(options, name) for name in names}
        controller = given_source(policy, options.source)
        tree = compress(
            policy, mode, **given, controller=controller, features=features, progress=say
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
        "--source": options.source,
        "--nodes": options.nodes,
        "--bytes": options.bytes,
    }
    wrong = [name for name, value in for_one.items() if value is not None]
    if wrong or options.mode not in (None, "exact"):
        raise ProblemError(f"--curve tries all modes and takes no {', '.join(wrong) or '--mode'}")
    policy = Policy.load(file)
    given = options.of_loops(policy)
    picture = f"{Path(file).stem}-curve.png" if options.output is None else options.output
    check_format(picture)
    table = str(Path(picture).with_suffix(".csv"))
    for path in (picture, table):
        check_writable(path)
    with working("trying modes and levels") as say:
        names = "states seed backend judge".split()
        judged: dict[str, Any] = {name: getattr(options, name) for name in names}
        points = size_curve(policy, **judged | given, progress=say)
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
        typer.Option(
            "--output", "-o", metavar="FILE", help="The drawing: a .dot, .svg, .png or .pdf file."
        ),
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
