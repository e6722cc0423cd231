"""Strategies of the probabilistic model checker PRISM, and the states that they number.

``prism .. -exportstrat FILE`` writes a line for each state, ``NUMBER:ACTION`` or
``(VALUES)=ACTION``; as an induced model, ``.tra``, transitions whose last word is the action. Where
states are numbers, ``-exportstates`` writes what they are: the names of the variables, ``(x,y)``,
then ``NUMBER:(VALUES)`` a line.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.sources.table import MOST_POINTS, Table, check_points
from capsyn.sources.tables.numbers import number
from capsyn.sources.tables.points import Points
from capsyn.sources.tables.symbols import Coder, named
from capsyn.sources.text import (
    check_alphabet,
    check_room,
    decoded,
    fail,
    naming,
    path_text,
    read_bytes,
)

CHOICE = re.compile(r"(\d{1,15}|\([^()]*\))\s*(?:,\s*(\d{1,15}))?\s*[:=]\s*(.*)", re.ASCII)
"""A state, a memory state, and an action."""
STATE = re.compile(r"(\d{1,15})\s*:\s*(\([^()]*\))", re.ASCII)
"""The number of a state, and its values."""
COUNTS = re.compile(r"\d+ \d+( \d+)?", re.ASCII)
"""The first line of transitions: numbers of states, choices and transitions."""
UNDEFINED = {"?", "-", "*"}
"""Actions of states where a strategy has none."""
MEMORY = 24
"""Bytes that reading takes for each of the file, at most."""


def read_prism(
    path: str | os.PathLike[str],
    alphabet: Alphabet | None = None,
    states: str | os.PathLike[str] | None = None,
) -> Table:
    """Return the table of a strategy of PRISM.

    Variables are whole numbers or booleans, so states are points of a grid with steps of 1. A state
    without a line is a gap.

    Parameters
    ----------
    path : path
        The file of the strategy: actions, indices of choices, or an induced model with actions.
    alphabet : Alphabet, optional
        Control vectors by the names of the actions. Default: 0, 1, .. in the order of the file.
    states : path, optional
        The file that ``-exportstates`` wrote. Default: a file beside the strategy, of the same
        name, that ends in ``.sta``, or in ``_states`` before the ending. No such file is needed if
        the strategy has the values.

    Raises
    ------
    ProblemError
        The file has another format, the strategy has memory or is randomised, or states are only
        numbers.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    rows = list(_rows(path))
    if not rows:
        fail(path, 1, "a state and its action", None)
    induced = COUNTS.fullmatch(rows[0][1]) is not None
    keys, actions, lines = (_transitions if induced else _choices)(path, rows)
    beside = _beside(path) if states is None else path_text(states)
    names, known = (None, {}) if beside is None else _states(beside)
    numbered = {key for key in keys if key.isdecimal()}
    if numbered and beside is None:
        raise ProblemError(
            f"'{path}' numbers its states; `states` (--exported-states) must be the file that "
            "PRISM wrote with -exportstates"
        )
    values: dict[str, list[float]] = {}
    for key, line in zip(keys, lines):
        if key in values:
            continue
        if key.isdecimal():
            if int(key) not in known:
                fail(path, line, f"a state of '{beside}'", key)
            values[key] = known[int(key)]
        else:
            values[key] = _values(path, line, key)
        if len(values[key]) != len(values[keys[0]]):
            fail(path, line, f"{len(values[keys[0]])} values of variables", key)
    if names is not None and len(names) != len(values[keys[0]]):
        raise ProblemError(
            f"'{beside}' must name {len(values[keys[0]])} variables; got {len(names)}"
        )
    with naming(path):
        check_points((1,) * len(values[keys[0]]))
    coder = Coder()
    bits, alphabet = named(path, coder, coder(actions, lines), alphabet)
    array = np.array([values[key] for key in keys])
    points = Points(path, names, None, array, np.array(lines), bits)
    return points.whole_table(alphabet)


def _rows(path: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a file that are not blank and no comments, and their numbers."""
    data = read_bytes(path)
    check_room(path, len(data), MEMORY)
    text = decoded(path, data).replace("\r\n", "\n").replace("\r", "\n")
    for k, line in enumerate(text.split("\n")):
        line = " ".join(line.split())
        if line and not line.startswith("#"):
            if k >= 4 * MOST_POINTS:
                raise ProblemError(f"'{path}' must have at most {4 * MOST_POINTS:,} lines")
            yield k + 1, line


def _choices(path: str, rows: list[tuple[int, str]]) -> tuple[list[str], list[str], list[int]]:
    """Return states and actions as texts, and their lines, of a strategy as actions or indices."""
    keys, actions = [], []
    for line, row in rows:
        match = CHOICE.fullmatch(row)
        if match is None:
            fail(path, line, "a state and its action, as 0:action or (0,1)=action", row)
        if match[2] is not None and int(match[2]):
            fail(path, line, "a strategy without memory", row)
        if match[3].startswith("{") or not match[3].isprintable():
            fail(path, line, "one action: the strategy must not be randomised", match[3])
        keys.append(match[1])
        actions.append("" if match[3] in UNDEFINED else match[3])
    return keys, actions, [line for line, _ in rows]


def _transitions(path: str, rows: list[tuple[int, str]]) -> tuple[list[str], list[str], list[int]]:
    """Return states and actions as texts, and their lines, of an induced model."""
    before = 2 + rows[0][1].count(" ")  # state, successor, probability; of an MDP a choice, too
    keys, actions = [], []
    for line, row in rows[1:]:
        words = row.split(None, before)
        if len(words) <= before or not words[0].isdecimal() or len(words[0]) > 15:
            fail(path, line, f"{before} numbers and the name of an action", row)
        keys.append(words[0])
        actions.append(words[before])
    if not keys:
        fail(path, rows[0][0] + 1, "a transition", None)
    return keys, actions, [line for line, _ in rows[1:]]


def _beside(path: str) -> str | None:
    """Return the file of states beside a strategy, if there is one."""
    file = Path(path)
    found = [file.with_suffix(".sta"), file.with_name(f"{file.stem}_states{file.suffix}")]
    return next((str(other) for other in found if other.is_file() and str(other) != path), None)


def _states(path: str) -> tuple[list[str], dict[int, list[float]]]:
    """Return the names of the variables, and the values by the numbers of states."""
    rows = list(_rows(path))
    if not rows or not re.fullmatch(r"\([^():]+\)", rows[0][1]):
        fail(
            path,
            rows[0][0] if rows else 1,
            "(NAME,..), the variables",
            rows[0][1] if rows else None,
        )
    names = [name.strip() for name in rows[0][1][1:-1].split(",")]
    values: dict[int, list[float]] = {}
    for line, row in rows[1:]:
        match = STATE.fullmatch(row)
        if match is None:
            fail(path, line, "a state, as 0:(0,1)", row)
        if int(match[1]) in values:
            fail(path, line, "a state that has no line yet", row)
        values[int(match[1])] = _values(path, line, match[2])
        if len(values[int(match[1])]) != len(names):
            fail(path, line, f"{len(names)} values of variables", row)
    return names, values


def _values(path: str, line: Any, text: str) -> list[float]:
    """Return the values of the variables in a text such as ``(0,1,true)``."""
    parts = [part.strip() for part in text[1:-1].split(",")]
    values = [number(part) for part in parts]
    if not all(abs(value) <= 1e15 for value in values):
        fail(path, line, "values of variables: whole numbers, true or false", text)
    return values
