"""From Siemens SCL, as this project writes it, to IEC 61131-3; anything else is an error."""

from __future__ import annotations

import re

KINDS = {"Bool": "BOOL", "Int": "INT", "DInt": "DINT", "Real": "REAL", "LReal": "LREAL"}
KINDS["Time"] = "TIME"
WORDS = frozenset(
    "IF THEN ELSE END_IF WHILE DO END_WHILE FOR TO END_FOR CASE OF END_CASE AND OR NOT MOD TRUE "
    "FALSE INT_TO_DINT DINT_TO_INT DINT_TO_LREAL".split()
)
TOKENS = re.compile(
    r"(?P<comment>\(\*.*?\*\))|(?P<time>T#\w+)|(?P<typed>LREAL#)?(?P<number>-?\d+(?:\.\d+(?:E-?\d+)?)?)"
    r"|(?P<mark>#)?(?P<name>[A-Za-z_]\w*)(?P<given>\s*:=)?|(?P<called>\"\w+\"(?=\())"
    r"|(?P<bracket>[()])|(?P<other>[^\w\"#])",
    re.DOTALL,
)


class NoScl(Exception):
    """What is no SCL, or none of this project."""


def to_iec(text: bytes) -> bytes:
    """Return the units of a source as IEC 61131-3."""
    lines = text.decode("ascii").splitlines()
    made: list[str] = []
    while lines:
        line = lines.pop(0)
        made += _unit(line, lines) if line else [line]
    return ("\n".join(made) + "\n").encode()


def _unit(line: str, lines: list[str]) -> list[str]:
    found = re.fullmatch(r'(FUNCTION|FUNCTION_BLOCK) "(\w+)"(?: : (\w+))?', line)
    if not found or bool(found[3]) != (found[1] == "FUNCTION"):
        raise NoScl(line)
    word, name, result = found.groups()
    if lines[:2] != ["{ S7_Optimized_Access := 'TRUE' }", "VERSION : 0.1"]:
        raise NoScl(lines[:2])
    begin, end = lines.index("BEGIN"), lines.index(f"END_{word}")
    head, body = lines[2:begin], lines[begin + 1 : end]
    del lines[: end + 1]
    inner = "VAR_TEMP" if result else "VAR"
    if set(re.findall(r"^VAR\w*", "\n".join(head), re.M)) - {"VAR_INPUT", "VAR_OUTPUT", inner}:
        raise NoScl(head)
    variables = {v for v in re.findall(r"^    (\w+) : ", "\n".join(head), re.M)} | {name}
    single = any(re.search(r" Real\b", row) for row in head)
    return [
        f"{word} {name}{f' : {KINDS[result]}' if result else ''}",
        *(_declaration(row).replace("VAR_TEMP", "VAR") for row in head),
        *_statements("\n".join(body), variables, single).splitlines(),
        f"END_{word}",
    ]


def _declaration(row: str) -> str:
    found = re.match(r"    (\w+) : (Array\[0\.\.\d+\] of )?(\w+)(.*)", row)
    if not found:
        return row
    name, array, kind, rest = found.groups()
    if kind not in KINDS:
        raise NoScl(row)
    array = (array or "").replace("Array", "ARRAY").replace("of", "OF")
    return f"    {name} : {array}{KINDS[kind]}{rest}"


def _statements(body: str, variables: set[str], single: bool) -> str:
    made, at, depth = [], 0, 0
    for found in TOKENS.finditer(body):
        if found.start() != at:
            raise NoScl(body[at : found.end()])
        at = found.end()
        text = found[0]
        depth += {"(": 1, ")": -1}.get(found["bracket"] or "", 0)
        if found["name"]:
            formal = bool(depth and found["given"])
            known = found["name"] in (variables if found["mark"] else WORDS)
            if found["mark"] if formal else not known:
                raise NoScl(text)
            text = text.removeprefix("#")
        elif found["number"]:
            if bool(found["typed"]) != ("." in text and not single):
                raise NoScl(text)
            text = found["number"]
        elif found["called"]:
            text = text.strip('"')
        made.append(text)
    if at != len(body):
        raise NoScl(body[at:])
    return "".join(made)
