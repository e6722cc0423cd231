"""The command that makes a policy of a tabulated controller."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capsyn.cli.console import show, working
from capsyn.cli.options import Json, check_states, number_list
from capsyn.cli.printed import print_report
from capsyn.errors import ProblemError

if TYPE_CHECKING:
    from capsyn.modelling.alphabet import Alphabet


def import_table(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="A table: .scs of SCOTS, .csv or .npz.")
    ],
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="POLICY", help="Default: FILE.cap")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Of the policy [default: the file's].")] = None,
    states: Annotated[
        str | None, typer.Option(metavar="NAME[,NAME..]", help="Names of the states.")
    ] = None,
    periodic: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME..]", help="States whose grid is a whole turn."),
    ] = None,
    alphabet: Annotated[
        str | None,
        typer.Option(
            metavar="[NAME=]U[,U..][;..]",
            help="Control vectors of the symbols in place of those of the table, with names for "
            "all of them or none: fill=1,0;drain=0,1;off=0,0.",
        ),
    ] = None,
    default: Annotated[
        str | None,
        typer.Option(metavar="U[,U..]", help="Default control, that of no symbol [0]."),
    ] = None,
    outside: Annotated[
        str, typer.Option(help="error, nearest, or a symbol's name or index.")
    ] = "error",
    missing: Annotated[
        str, typer.Option(help="Points without a row in a .csv: error or outside.")
    ] = "error",
    as_json: Json = False,
) -> None:
    """Make a policy of a tabulated controller, equal to it at every point of its grid."""
    from capsyn.execution.files import check_writable
    from capsyn.policies.report import report
    from capsyn.sources.grid_files import read_table

    path = f"{Path(file).stem}.cap" if output is None else output
    if Path(path).resolve() == Path(file).resolve():
        raise ProblemError(f"the output must be another file than the table; got '{path}'")
    check_writable(path)
    symbols = None
    if alphabet is not None:
        symbols = _symbols(alphabet)
    with working("reading the table"):
        table = read_table(file, symbols, missing)
        if states is not None:
            named = states.split(",")
            if len(named) != len(table.counts):
                raise ProblemError(f"--states must name {len(table.counts)} states; got '{states}'")
            table = dataclasses.replace(table, names=named)
        if periodic is not None:
            known = table.box().names
            turns = periodic.split(",")
            check_states("--periodic", turns, known)
            table = dataclasses.replace(table, periodic=[axis in turns for axis in known])
        policy = table.policy(
            Path(file).stem if name is None else name,
            default=None if default is None else number_list("--default", default),
            outside=outside,
        )
    policy.save(path)
    data = report(policy) | {"file": path}

    def told() -> None:
        print_report(data)
        typer.echo(f"wrote {path}")

    show(as_json, data, told)


def _symbols(text: str) -> Alphabet:
    """Return the alphabet of ``U,U;U,U``, or with names ``NAME=U,U;NAME=U,U``."""
    from capsyn.modelling.alphabet import Alphabet

    rows = [row.rpartition("=") for row in text.split(";")]
    named = [bool(equals) for _, equals, _ in rows]
    if any(named) and not all(named):
        raise ProblemError(f"--alphabet must have names for all symbols or none; got '{text}'")
    names = [name.strip() for name, _, _ in rows] if any(named) else None
    return Alphabet([number_list("--alphabet", values) for _, _, values in rows], names)
