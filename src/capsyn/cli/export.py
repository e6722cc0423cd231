"""The command that writes a policy in other languages."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

import typer

from capsyn.cli.console import show, working
from capsyn.cli.options import (
    File,
    Json,
    OutsideAtOnce,
    assignments,
    flat,
    listed,
    one_or_list,
    option,
)

TARGETS = "c, structured-text, verilog, fmu, python, javascript, dot, json"


@dataclass(frozen=True)
class ExportOptions:
    """Options of ``capsyn export``."""

    to: str = option(
        f"One of {TARGETS}; several, or all, into a folder each.",
        default=dataclasses.MISSING,
        metavar="TARGET[,..]",
    )
    output: str = option(
        "Folder for the files, which is made if need be.",
        "--output",
        "-o",
        default=dataclasses.MISSING,
        metavar="DIR",
    )
    safe: str | None = option(
        "Symbol for states that have no other symbol: its name, its index, or default "
        "[default: the policy's own safe symbol, else default].",
        metavar="SYMBOL",
    )
    dwell: float | None = option(
        "Least time between switches [time unit of the policy] [default: the policy's]."
    )
    hold_off: float | None = option(
        "Time after the start for which the safe symbol is in force [time unit] [default: 0]."
    )
    outside_at_once: OutsideAtOnce = None
    scale: str | None = option(
        "A state is reading * scale + offset. One number for all states, or one for each "
        "[default: 1].",
        metavar="S[,S..]",
    )
    offset: str | None = option(
        "Offset of the readings, see --scale [default: 0].", metavar="O[,O..]"
    )
    style: str | None = option(
        "c: table (smallest), nested, grid (fastest), cells; structured-text: nested, table, cells "
        "[default: cells for affine leaves, else the first]."
    )
    arithmetic: str | None = option("c: how states are compared: lattice, double or float.")
    cycles: bool = option(
        "c: measure the longest time of a decision on the emulators that are installed.",
        "--cycles",
        default=False,
    )
    name: str | None = option("Name of the files and functions [default: the policy's name].")
    option: list[str] | None = option(
        "Another option of the target, such as sources_only=yes of fmu; may be repeated.",
        metavar="NAME=VALUE",
    )


@flat
def export(file: File, options: ExportOptions, as_json: Json = False) -> None:
    """Write a policy or a tree in another language, with golden vectors and what it costs."""
    from capsyn.exports.export import CERTIFICATE, MEASURED, all_targets, check_options, export
    from capsyn.policies.policy import Policy

    to = options.to
    targets = TARGETS.split(", ") if to == "all" else listed(to)
    own = _own_options(options)
    check_options(targets, own)
    plan = _plan_options(options)
    policy = Policy.load(file)
    if to == "all":
        targets = list(all_targets(policy))
    one = len(targets) == 1
    with working(f"exporting to {to}"):
        written = export(policy, targets[0] if one else targets, options.output, **own | plan)
    certificates, measured = (
        [json.loads(path.read_bytes()) for path in written if path.name == name]
        for name in (CERTIFICATE, MEASURED)
    )
    telling = [each for each in certificates if each["policy"] != policy.name]  # from where kept
    certificates = [each for each in certificates if each["policy"] == policy.name]
    data = {
        "files": [str(path) for path in written],
        "certificate": certificates[0] if one else dict(zip(targets, certificates)),
    } | ({"measured": measured[0]} if measured else {})

    def told() -> None:
        print_export(list(map(str, written)), certificates, measured)
        for line in dict.fromkeys(map(_costs, telling)):
            typer.echo(f"from where limits are kept: {line}")

    show(as_json, data, told)


def _own_options(options: ExportOptions) -> dict[str, Any]:
    """Return what only some targets take."""
    texts = assignments("--option", options.option or [])
    values: dict[str, Any] = {key.replace("-", "_"): _value(text) for key, text in texts.items()}
    named = {"style": options.style, "arithmetic": options.arithmetic, "name": options.name}
    values |= {"cycles": True} if options.cycles else {}
    return values | {key: value for key, value in named.items() if value is not None}


def _plan_options(options: ExportOptions) -> dict[str, Any]:
    """Return what all targets take."""
    values = {
        "safe": options.safe,
        "dwell": options.dwell,
        "hold_off": options.hold_off,
        "outside_at_once": options.outside_at_once,
        "scale": None if options.scale is None else one_or_list("--scale", options.scale),
        "offset": None if options.offset is None else one_or_list("--offset", options.offset),
    }
    return {key: value for key, value in values.items() if value is not None}


def _value(text: str) -> Any:
    """Return a whole number, a number, a truth value, a list of numbers, or the text itself."""
    words = {"true": True, "yes": True, "false": False, "no": False}
    if text.lower() in words:
        return words[text.lower()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return [_value(part) for part in text.split(",")] if "," in text else text


def _costs(figures: dict[str, Any]) -> str:
    """Return what a decision costs, in a line."""
    table, more = figures.get("transitions"), ""
    if table:
        more = f"; {table['rows']:,} rows of transitions of {table['bytes']:,} bytes"
    if "cells" in figures:
        rows, levels = figures["rows_evaluated"], figures["levels"]
        return (
            f"{figures['cells']:,} cells with {figures['rows']:,} rows; {levels['most']} levels "
            f"and {rows['most']} rows at most, {levels['mean']:.1f} and {rows['mean']:.1f} on "
            f"average; "
            f"cells of {figures['cells_bytes']:,} bytes{more}"
        )
    compared = figures["comparisons"]
    mean = "" if compared["mean"] is None else f", {compared['mean']:.1f} on average"
    return (
        f"{figures['nodes']:,} nodes, {compared['most']} comparisons at most{mean}; tree of "
        f"{figures['tree_bytes']:,} bytes{more}"
    )


def print_export(
    files: list[str], certificates: list[dict[str, Any]], measured: list[dict[str, Any]]
) -> None:
    """Print what a decision costs, and which files were written."""
    for line in dict.fromkeys(map(_costs, certificates)):
        typer.echo(line)
    typer.echo(certificates[0]["guarantee"])
    for figures in certificates:
        changed, lines = figures["changed_by_rounding"], list(figures["notes"])
        if changed is None:
            lines.append("quantisation changes no symbol: the lattice is the policy's own")
        else:
            lines.append(f"rounding changes the symbol of {changed:.2%} of random states")
        if figures["renamed"]:
            pairs = (f"{old!r} is {new}" for old, new in figures["renamed"].items())
            lines.append(f"renamed: {', '.join(pairs)}")
        for line in lines:
            typer.echo(f"{figures['target']}: {line}")
    by_processor = dict(measured[0]) if measured else {}
    worst = by_processor.pop("worst", {})
    for processor, sizes in by_processor.items():
        words = [f"{k.replace('_', ' ')} {v:,}" for k, v in sizes.items() if k != "compiler"]
        typer.echo(f"c, {processor}, {sizes['compiler']}, bytes: {', '.join(words)}")
    for processor, found in worst.items():
        for what, start in (("symbol", "steps"), ("decide", "readings"), ("next", "readings")):
            if what in found:
                typer.echo(f"c, {processor}, {_longest(found[what], found['unit'], start)}")
    for name in files:
        typer.echo(f"wrote {name}")


def _longest(found: dict[str, Any], unit: str, start: str) -> str:
    """Return a line on the decision that takes longest."""
    place = ", ".join(f"{x:.6g}" for x in found["at"])
    known = "at most" if found["exact"] else f"the longest of {found['of']:,} seen"
    return f"from {start} to a symbol {found['most']:,} {unit}, {known}, at ({place})"
