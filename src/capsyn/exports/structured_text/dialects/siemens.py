"""Units in Siemens SCL, as external sources of TIA Portal."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

from capsyn.exports.structured_text.lines import comment
from capsyn.exports.structured_text.pou import Pou, section
from capsyn.exports.text import WIDTH, broken

NAMES = {
    "BOOL": "Bool",
    "INT": "Int",
    "DINT": "DInt",
    "REAL": "Real",
    "LREAL": "LReal",
    "TIME": "Time",
}
"""Names of types."""
TOKENS = re.compile(
    r"(?P<comment>\(\*.*?\*\))|(?P<time>T#\w+)|(?P<real>-?\d+\.\d+(?:E-?\d+)?)"
    r"|(?P<name>[A-Za-z_]\w*)(?P<given>\s*:=)?|(?P<bracket>[()])",
    re.DOTALL,
)


def scl(pou: Pou, functions: Collection[str], real: str, header: Iterable[str]) -> list[str]:
    """Return a unit; `functions` are the names of all, `real` the type of numbers.

    Remarks, with those of a header, stand among the statements, where every version reads them.
    """
    inner = "VAR_TEMP" if pou.result else "VAR"
    result = f" : {NAMES[pou.result]}" if pou.result else ""
    lines = _statements(pou, functions, real).splitlines()
    return [
        f'{pou.word} "{pou.name}"{result}',
        "{ S7_Optimized_Access := 'TRUE' }",
        "VERSION : 0.1",
        *section("VAR_INPUT", pou.inputs, NAMES),
        *section("VAR_OUTPUT", pou.outputs, NAMES),
        *section(inner, pou.inner, NAMES),
        "BEGIN",
        *comment(header),
        *comment(pou.about),
        *(part for line in lines for part in ([line] if len(line) <= WIDTH else broken(line))),
        f"END_{pou.word}",
    ]


def _statements(pou: Pou, functions: Collection[str], real: str) -> str:
    """Return statements with marked variables, quoted functions and typed literals.

    In brackets a name before ``:=`` is a parameter of the function that is called.
    """
    variables = {pou.name, *(v.name for v in (*pou.inputs, *pou.outputs, *pou.inner))}
    depth = 0

    def marked(found: re.Match[str]) -> str:
        nonlocal depth
        text, name = found[0], found["name"]
        depth += {"(": 1, ")": -1}.get(found["bracket"] or "", 0)
        if found["real"] and real == "LREAL":
            return f"LREAL#{text}"
        if name in variables and not (depth and found["given"]):
            return f"#{text}"
        return f'"{text}"' if name in functions else text

    return TOKENS.sub(marked, "\n".join(pou.body))
