"""The command that makes a policy of a tabulated controller."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsyn.cli.console import show, working
from capsyn.cli.options import (
    Json,
    assignments,
    check_states,
    flat,
    listed,
    number,
    number_list,
    option,
)
from capsyn.cli.printed import print_report
from capsyn.errors import ProblemError

if TYPE_CHECKING:
    from capsyn.modelling.alphabet import Alphabet
    from capsyn.sources.table import Table
    from capsyn.sources.tables.stratego import Strategy


@dataclass(frozen=True)
class ImportOptions:
    """Options of ``capsyn import``."""

    output: str | None = option(
        "The policy file [default: FILE.cap].", "--output", "-o", metavar="POLICY"
    )
    name: str | None = option("Name of the policy [default: the file's name].")
    states: str | None = option("Names of the states.", metavar="NAME[,NAME..]")
    periodic: str | None = option(
        "Periodic states: their grid covers one whole turn.", metavar="NAME[,NAME..]"
    )
    alphabet: str | None = option(
        "Control vectors of the symbols in place of the table's, with names for all of them "
        "or for none: fill=1,0;drain=0,1;off=0,0.",
        metavar="[NAME=]U[,U..][;..]",
    )
    default: str | None = option(
        "Default control, which belongs to no symbol [default: 0].", metavar="U[,U..]"
    )
    outside: str | None = option(
        "What a state outside the domain gets: error, nearest, or a symbol's name or index "
        "[default: error, or nearest for a strategy with continuous variables]."
    )
    outside_at_once: bool = option(
        "Take the symbol of a state outside the domain at once, without waiting for a least "
        "time between switches.",
        "--outside-at-once",
        default=False,
    )
    time_unit: str = option(
        "Unit of all times of the policy: ns, us, ms, s, min, h or d.", default="s"
    )
    missing: str = option(
        "What a point without a row in a .csv becomes: error, outside (a gap), or auto (a "
        "gap, but an error if no row has this value of an axis).",
        default="auto",
    )
    inputs: str | None = option(
        "Columns of a .csv that are inputs [default: the last column, and columns of its "
        "name with another number].",
        metavar="NAME[,NAME..]",
    )
    format: str | None = option(
        "Format of the file: csv, npz, scots, stratego, storm or prism [default: what the "
        "content looks like]."
    )
    exported_states: str | None = option(
        "File of states that PRISM wrote with -exportstates [default: FILE.sta].", metavar="FILE"
    )
    domain: str | None = option(
        "Bounds of a strategy's continuous variables [default: an eighth wider than its own].",
        metavar="NAME=LOW:HIGH[,..]",
    )


@flat
def import_table(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="A table: .csv, .npz, .scs of SCOTS; a strategy of UPPAAL Stratego, Storm or "
            "PRISM.",
        ),
    ],
    options: ImportOptions,
    as_json: Json = False,
) -> None:
    """Make a policy of a tabulated controller, equal to it at every point of its grid."""
    from capsyn.execution.files import check_writable
    from capsyn.policies.report import report

    path = f"{Path(file).stem}.cap" if options.output is None else options.output
    if Path(path).resolve() == Path(file).resolve():
        raise ProblemError(f"the output must be another file than the table; got '{path}'")
    check_writable(path)
    symbols = None if options.alphabet is None else _symbols(options.alphabet)
    name = Path(file).stem if options.name is None else options.name
    with working("reading the table"):
        table, default = _table(file, symbols, options), options.default
        controls = None if default is None else number_list("--default", default)
        rule: dict[str, Any] = {} if options.outside is None else {"outside": options.outside}
        policy = table.policy(
            name,
            default=controls,
            **rule,
            time_unit=options.time_unit,
            outside_at_once=options.outside_at_once,
        )
    policy.save(path)
    data = report(policy) | {"file": path}
    show(as_json, data, lambda: print_report(data), f"wrote {path}")


def _table(file: str, symbols: Alphabet | None, options: ImportOptions) -> Table | Strategy:
    """Return the table in a file, with the states that options name."""
    from capsyn.sources.grid_files import read_table
    from capsyn.sources.table import Table

    domain = options.domain
    table = read_table(
        file,
        symbols,
        options.missing,
        None if options.inputs is None else listed(options.inputs),
        options.format,
        states=options.exported_states,
        domain=None if domain is None else _ranges("--domain", domain),
    )
    known = table.box().names
    if options.states is not None:
        states = listed(options.states)
        if len(states) != len(known):
            raise ProblemError(f"--states must name {len(known)} states; got '{options.states}'")
        table = dataclasses.replace(table, names=states)
    if options.periodic is not None:
        if not isinstance(table, Table):
            raise ProblemError("--periodic is for tables; the file has a strategy")
        known = table.box().names
        turns = listed(options.periodic)
        check_states("--periodic", turns, known)
        table = dataclasses.replace(table, periodic=[axis in turns for axis in known])
    return table


def _symbols(text: str) -> Alphabet:
    """Return the alphabet of ``U,U;U,U``, or with names ``NAME=U,U;NAME=U,U``."""
    from capsyn.modelling.alphabet import Alphabet

    rows = [row.rpartition("=") for row in text.split(";")]
    named = [bool(equals) for _, equals, _ in rows]
    if any(named) and not all(named):
        raise ProblemError(f"--alphabet must have names for all symbols or none; got '{text}'")
    names = [name.strip() for name, _, _ in rows] if any(named) else None
    return Alphabet([number_list("--alphabet", values) for _, _, values in rows], names)


def _ranges(name: str, text: str) -> dict[str, tuple[float, float]]:
    """Return the bounds of ``NAME=LOW:HIGH,..``."""
    found = {}
    for key, value in assignments(name, listed(text)).items():
        low, colon, high = value.partition(":")
        if not colon:
            raise ProblemError(f"{name} must be NAME=LOW:HIGH; got '{key}={value}'")
        found[key] = number(f"{name} {key}", low), number(f"{name} {key}", high)
    return found
