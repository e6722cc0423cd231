"""Program organisation units: functions and blocks with typed variables, and their text."""

from __future__ import annotations

import dataclasses
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from capsyn.exports.structured_text.lines import comment, plain
from capsyn.exports.text import WIDTH, broken

SHORT = 32767
"""Largest INT; tables with larger numbers are of DINT, which is twice the size."""


@dataclass(frozen=True)
class Variable:
    """A variable of an elementary type, or, where it has a size, an array of it from 0 on.

    `start` is the value that it begins with, `values` are those of an array; none: zeros.
    """

    name: str
    kind: str
    about: str = ""
    start: str = ""
    size: int = 0
    values: tuple[str, ...] = ()


@dataclass(frozen=True)
class Pou:
    """A function, which has the type of its result, or a function block, which has none.

    `about` are remarks in front of it, `inner` the variables that nobody else sees; statements
    are those of IEC 61131-3, with comments in lines of their own.
    """

    name: str
    result: str
    about: tuple[str, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    inner: tuple[Variable, ...]
    body: tuple[str, ...]

    @property
    def word(self) -> str:
        """What declares it."""
        return "FUNCTION" if self.result else "FUNCTION_BLOCK"


def renamed_unit(pou: Pou, names: Mapping[str, str]) -> Pou:
    """Return a unit whose variables have other names, each in the place of its own."""
    if not names:
        return pou

    def told(variables: tuple[Variable, ...]) -> tuple[Variable, ...]:
        return tuple(dataclasses.replace(v, name=names.get(v.name, v.name)) for v in variables)

    body = "\n".join(pou.body)
    lines = _NAME.sub(lambda found: names.get(found[0], found[0]), body).splitlines()
    parts = (part for line in lines for part in ([line] if len(line) <= WIDTH else broken(line)))
    return dataclasses.replace(
        pou,
        inputs=told(pou.inputs),
        outputs=told(pou.outputs),
        inner=told(pou.inner),
        body=tuple(parts),
    )


_NAME = re.compile(r"\(\*.*?\*\)|(?<![\w.#])[A-Za-z_]\w*", re.DOTALL)
"""A comment, which is kept as it is, or a name."""


def table(name: str, values: np.ndarray) -> Variable:
    """Return an array of whole numbers, of INT where they fit."""
    kind = "INT" if np.abs(values.astype(np.int64)).max(initial=0) <= SHORT else "DINT"
    return Variable(name, kind, size=len(values), values=tuple(map(str, values.tolist())))


def element(array: Variable, index: str) -> str:
    """Return an element of an array, as DINT where it is a whole number."""
    text = f"{array.name}[{index}]"
    return f"INT_TO_DINT({text})" if array.kind == "INT" else text


def declaration(variable: Variable, names: Mapping[str, str] | None = None) -> list[str]:
    """Return the lines that declare a variable, with what it is behind it, or above if too long.

    `names` are the types of another language than IEC 61131-3.
    """
    kind = names[variable.kind] if names else variable.kind
    array, of = ("Array", "of") if names else ("ARRAY", "OF")
    if not variable.size:
        start = f" := {variable.start}" if variable.start else ""
        lines = [f"    {variable.name} : {kind}{start};"]
    else:
        lines = [f"    {variable.name} : {array}[0..{variable.size - 1}] {of} {kind}"]
        if variable.values:
            pad = " " * 8
            text = ", ".join(variable.values)
            lines[0] += " := ["
            lines += textwrap.wrap(text, WIDTH - 3, initial_indent=pad, subsequent_indent=pad)
            lines[-1] += "]"
        lines[-1] += ";"
    text = plain(variable.about).rstrip("*( ")
    if not text:
        return lines
    if len(lines) == 1 and len(lines[0]) + len(text) + 7 <= WIDTH:
        return [f"{lines[0]} (* {text} *)"]
    return [*comment([text], indent=4), *lines]


def section(
    word: str, variables: Iterable[Variable], names: Mapping[str, str] | None = None
) -> list[str]:
    """Return a section of declarations; nothing where there are no variables."""
    lines = [line for variable in variables for line in declaration(variable, names)]
    return [word, *lines, "END_VAR"] if lines else []


def text(pou: Pou) -> list[str]:
    """Return a unit in IEC 61131-3."""
    return [
        *comment(pou.about),
        f"{pou.word} {pou.name}{f' : {pou.result}' if pou.result else ''}",
        *section("VAR_INPUT", pou.inputs),
        *section("VAR_OUTPUT", pou.outputs),
        *section("VAR", pou.inner),
        *pou.body,
        f"END_{pou.word}",
    ]
