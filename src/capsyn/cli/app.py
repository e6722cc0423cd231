"""The command line: words in, tables out; no numerics."""

from __future__ import annotations

import re
import sys
import warnings
from typing import Annotated, Any

import typer

from capsyn.cli.better.alphabet import alphabet
from capsyn.cli.better.improve import improve
from capsyn.cli.better.switching import switching
from capsyn.cli.better.tune import tune
from capsyn.cli.compression import automaton, compress
from capsyn.cli.console import print_table, show, show_all, working
from capsyn.cli.doctor import doctor
from capsyn.cli.evidence import verify
from capsyn.cli.export import export
from capsyn.cli.import_table import import_table
from capsyn.cli.look import at, explore, query
from capsyn.cli.making.simulate import simulate
from capsyn.cli.making.synth import synth
from capsyn.cli.options import Current, File, Json, assignments, listed, number
from capsyn.cli.paper import bench, reproduce
from capsyn.cli.printed import print_report
from capsyn.cli.proofs.certify import certify, check
from capsyn.errors import CapsynError, CapsynWarning
from capsyn.execution.interrupts import INTERRUPTED, ending_soon, tell

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


def _version(wanted: bool) -> None:
    if wanted:
        from capsyn.version import __version__

        typer.echo(f"capsyn {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Print the version and exit."
        ),
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


app.command()(synth)


@app.command()
def info(
    file: File,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="Leave out the figures of the policy's complexity, which take time."
        ),
    ] = False,
    proof: Annotated[
        str | None,
        typer.Option(
            metavar="POLICY",
            help="Prove again what an exact or free tree guarantees about the policy in this file.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Describe a policy: what it is, how complex it is, and what looks wrong."""
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
        str,
        typer.Option(
            "--output", "-o", metavar="FILE", help="The picture: a .png, .pdf or .svg file."
        ),
    ],
    plane: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y",
            help="The two states or exogenous inputs on the axes [default: the first two].",
        ),
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="Value of another state or input [default: the middle]. May be repeated.",
        ),
    ] = None,
    outlines: Annotated[bool, typer.Option(help="Draw the outlines of the cells.")] = True,
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
    axes = tuple(listed(plane)) if plane else names[:2]
    values = {name: number(name, text) for name, text in assignments("--at", at or []).items()}
    save_policy_plot(policy, output, axes, values, outlines, current=current)
    typer.echo(f"wrote {output}")


app.command(context_settings={"ignore_unknown_options": True})(query)  # -1 is no option
app.command()(at)
app.command("import")(import_table)
app.command()(improve)
app.command()(tune)
app.command()(alphabet)
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
    for stream in (sys.stdout, sys.stderr):
        show_all(stream)
    with ending_soon():
        _main()


def _main() -> None:
    # ClickException, wherever this Typer keeps its click
    click_error: Any = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")
    try:
        status = typer.main.get_command(app).main(standalone_mode=False)
    except CapsynError as error:
        _fail(_in_options(str(error)))
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
        tell()
    sys.exit(status if isinstance(status, int) else 0)


ALIASES = {
    "costs": "cost",
    "forbidden": "forbid",
    "parameters": "parameter",
    "price": "switch_price",
    "prices": "price",
    "spacing": "grid",
    "states": "agreement",
    "trials": "monte_carlo",
}
"""Options that mean arguments of Python of other names, where a command has no option of theirs."""


def _in_options(message: str) -> str:
    """Return a message with the options of the arguments that it names in Python's words.

    An option that is called like its argument needs no words.
    """
    group: Any = typer.main.get_command(app)
    command = group.commands.get(sys.argv[1] if len(sys.argv) > 1 else "")
    known = {} if command is None else {p.name: max(p.opts, key=len) for p in command.params}
    told = []
    for name in dict.fromkeys(re.findall(r"`(\w+)`", message)):
        option = known.get(name) or known.get(ALIASES.get(name, ""), "")
        if option.startswith("--") and option != f"--{name}":
            told.append(f"`{name}` is {option}")
    return message + (f" ({', '.join(told)})" if told else "")


def _fail(message: str) -> None:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


def _show_warning(message: Any, category: type[Warning], *rest: Any, **more: Any) -> None:
    kind = "" if issubclass(category, CapsynWarning) else f"{category.__name__}: "
    text = _in_options(f"{kind}{message}")
    print(f"warning: {' '.join(text.split())}", file=sys.stderr)
