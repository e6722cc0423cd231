"""Which columns of a table are states and which are inputs, by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from capsyn.errors import ProblemError
from capsyn.sources.tables.lines import Lines
from capsyn.sources.text import fail
from capsyn.validation import describe, one_line

UNNAMED = re.compile(r"|unnamed: ?\d+", re.IGNORECASE)
"""The name of a column that numbers rows."""
COUNTED = re.compile(r"(.*?)[\s_]*[\[(]?(\d+)[\])]?")
"""A name that ends in a number, as those of several inputs do."""
UNIT = re.compile(r"(.*?)(?:\s*\[([^\]]*)\]|\s+\(([^)]*)\))")
"""A name with a unit in brackets."""
MOST_CHARACTERS = 100
"""Most characters of a name."""


@dataclass(frozen=True)
class Columns:
    """The columns of a table.

    Parameters
    ----------
    width : int
        Fields of a row.
    states, inputs : lists of int
        Their places.
    names, units : dicts
        Of columns, by their places.
    named : bool
        Whether the file has names of columns.
    index : int, optional
        The place of the column that numbers rows.
    end : bool
        Whether rows end in a separator: their last field is empty.
    """

    width: int
    states: list[int]
    inputs: list[int]
    names: dict[int, str]
    units: dict[int, str]
    named: bool
    index: int | None = None
    end: bool = False


def columns_of(lines: Lines, inputs: Sequence[str] | None = None) -> Columns:
    """Return the columns of a table: `inputs`, or the last of them, and the states before.

    Where the last name ends in a number, inputs are the columns before it, too, whose names are
    the same but for the number; where names begin with ``input``, these are the inputs. A column
    without a name at the beginning numbers rows.

    Raises
    ------
    ProblemError
        Unknown inputs, or no column for a state.
    """
    first = lines.first()
    if lines.names is None:
        width = len(first or [])
        heads = [f"x{k + 1}" for k in range(width - 1)] + ["symbol"]
        if inputs is not None:
            heads = [str(k + 1) for k in range(width)]
    else:
        heads = list(lines.names)
        width = len(heads)
    end = bool(heads and heads[-1] == "" and width > 2)
    if first is not None and len(first) == width + 1:  # a name less than fields
        width += 1
        end = first[-1] == ""
        heads = [*heads, ""] if end else ["", *heads]
    index = 0 if UNNAMED.fullmatch(heads[0]) and width - end > 2 else None
    places = [k for k in range(width - end) if k != index]
    for k in places:
        if len(heads[k]) > MOST_CHARACTERS:
            wanted = f"names of columns of at most {MOST_CHARACTERS} characters"
            fail(lines.path, lines.line, wanted, heads[k])
    parts = {k: _unit(heads[k]) for k in places}
    names, units = ({k: part[i] for k, part in parts.items()} for i in (0, 1))
    of_inputs = _named(lines, names, heads, inputs) if inputs else _last(names)
    states = [k for k in places if k not in of_inputs]
    if not states:
        fail(lines.path, lines.line, "a column for a state beside the inputs", ",".join(heads))
    return Columns(width, states, of_inputs, names, units, lines.names is not None, index, end)


def _unit(head: str) -> tuple[str, str]:
    """Return name and unit of a column."""
    match = UNIT.fullmatch(head)
    unit = (match[2] if match[2] is not None else match[3]) if match else ""
    if match is None or not match[1] or unit.isdecimal():  # x[0] is a name
        return head, ""
    return match[1], unit.strip()


def _named(
    lines: Lines, names: dict[int, str], heads: list[str], inputs: Sequence[str]
) -> list[int]:
    """Return the places of columns that are named as inputs."""
    found = []
    for wanted in inputs:
        places = [k for k, name in names.items() if wanted.strip() in (name, heads[k])]
        if len(places) != 1 or places[0] in found:
            raise ProblemError(
                f"'{lines.path}': `inputs` (--inputs) must name columns of the file, each once, "
                f"among {one_line(', '.join(names.values()))}; got {describe(wanted)}"
            )
        found += places
    return found


def _last(names: dict[int, str]) -> list[int]:
    """Return the places of the columns that are inputs by their names; the last of them is."""
    places = list(names)
    said = [k for k in places if names[k].lower().startswith("input")]
    if said and places[-1] in said and len(said) < len(places):
        return said
    last = COUNTED.fullmatch(names[places[-1]])
    found = [places[-1]]
    if last is not None:
        for k in reversed(places[:-1]):
            match = COUNTED.fullmatch(names[k])
            if match is None or match[1] != last[1]:
                break
            found.insert(0, k)
    return found if len(found) < len(places) else found[-1:]
