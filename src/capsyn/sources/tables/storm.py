"""Schedulers of the probabilistic model checker Storm, as JSON.

``storm .. --buildstateval --buildchoicelab --exportscheduler FILE.json`` writes a list with an
entry for each state: ``s``, the values of its variables by name, and ``c``, its choices, each with
``labels``, or with ``--buildchoiceorig`` the ``origin`` in the model. The names of choices are the
symbols.
"""

from __future__ import annotations

import json
import os
from typing import Any, NoReturn

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.sources.table import MOST_POINTS, Table, check_points
from capsyn.sources.tables.json_text import is_real, json_of, told
from capsyn.sources.tables.points import Points
from capsyn.sources.tables.symbols import Coder, named
from capsyn.sources.text import check_alphabet, naming, path_text, read_bytes
from capsyn.validation import one_line

NO_CHOICE = "loop"
"""The symbol of a choice that comes from no command: Storm adds it where a state has none."""


def read_storm(path: str | os.PathLike[str], alphabet: Alphabet | None = None) -> Table:
    """Return the table of a scheduler of Storm.

    Variables are whole numbers or booleans, so states are points of a grid with steps of 1. A state
    is a gap if it is not in the file, or if its choice is undefined.

    Parameters
    ----------
    path : path
        The file.
    alphabet : Alphabet, optional
        Control vectors by the names of the choices. Default: 0, 1, .. in the order of the file.

    Raises
    ------
    ProblemError
        The file has another format, the scheduler has memory or is randomised, or choices have no
        names.
    """
    path = path_text(path)
    check_alphabet(alphabet)
    entries = json_of(path, read_bytes(path))
    if not isinstance(entries, list) or not entries:
        raise ProblemError(f"'{path}' must be a list of states, as Storm writes it")
    if len(entries) > MOST_POINTS:
        raise ProblemError(f"'{path}' must have at most {MOST_POINTS:,} states")
    names: list[str] | None = None
    states: list[list[Any]] = []
    choices: list[str] = []
    unnamed: dict[str, str] = {}
    for k, entry in enumerate(entries):
        if not isinstance(entry, dict) or "s" not in entry or "c" not in entry:
            _fail(path, k, "an object with 's' and 'c'", entry)
        if entry.get("m", 0) != 0:
            _fail(path, k, "a scheduler without memory", f"memory state {entry['m']}")
        values = _values(path, k, entry["s"])
        if names is None:
            names = list(values)
            with naming(path):
                check_points((1,) * len(names))
        if list(values) != names and set(values) != set(names):
            _fail(path, k, f"the variables {one_line(', '.join(names))}", list(values))
        states.append([values[name] for name in names])
        choices.append(_choice(path, k, entry["c"], unnamed))
    if NO_CHOICE in choices and set(choices) <= {"", NO_CHOICE}:
        raise ProblemError(
            f"'{path}' must have names of choices: run Storm with --buildchoicelab or "
            "--buildchoiceorig"
        )
    lines = np.arange(1, len(entries) + 1)
    coder = Coder()
    codes = coder(choices, lines.tolist())
    bits, alphabet = named(path, coder, codes, alphabet)
    points = Points(path, names, None, np.array(states, dtype=float), lines, bits, "state")
    return points.whole_table(alphabet)


def _values(path: str, k: int, values: Any) -> dict[str, Any]:
    """Return the values of the variables of a state, or its number."""
    if is_real(values):
        values = {"state": values}
    if not isinstance(values, dict) or not values:
        _fail(path, k, "values of variables (--buildstateval)", values)
    for name, value in values.items():
        if not is_real(value) and not isinstance(value, bool):
            _fail(path, k, f"a whole number or boolean for '{one_line(name, 100)}'", value)
        if abs(value) > 1e15:
            _fail(path, k, f"a number within +-1e15 for '{one_line(name, 100)}'", value)
    return values


def _choice(path: str, k: int, choices: Any, unnamed: dict[str, str]) -> str:
    """Return the name of the only choice of a state; empty where there is none.

    `unnamed` has names of commands without a label, by their texts.
    """
    if choices == "undefined":
        return ""
    if not isinstance(choices, list) or not choices or not isinstance(choices[0], dict):
        _fail(path, k, "a list of choices, or 'undefined'", choices)
    if len(choices) > 1:
        _fail(
            path, k, "one choice: the scheduler must not be randomised", f"{len(choices)} choices"
        )
    choice = choices[0]
    origin, labels = choice.get("origin"), choice.get("labels")
    if isinstance(origin, dict) and isinstance(origin.get("action-label"), str):
        if origin["action-label"]:
            return _text(path, k, origin["action-label"])
    if isinstance(labels, list) and labels and all(isinstance(text, str) for text in labels):
        return _text(path, k, ",".join(labels))
    if not origin:
        return NO_CHOICE
    try:
        text = json.dumps(origin, sort_keys=True)
    except RecursionError:
        _fail(path, k, "an origin that is not nested so deeply", origin)
    return unnamed.setdefault(text, f"command {len(unnamed) + 1}")


def _text(path: str, k: int, text: str) -> str:
    text = text.strip()
    if not text or not text.isprintable():
        _fail(path, k, "a printable name of a choice", text)
    return text


def _fail(path: str, k: int, wanted: str, got: Any) -> NoReturn:
    """Raise the error of an entry that is not what was expected."""
    instead = got if isinstance(got, str) and " " in got else told(got)
    raise ProblemError(f"'{path}', state {k + 1} of the list: expected {wanted}; got {instead}")
