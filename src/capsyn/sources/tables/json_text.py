"""JSON of other tools, read with care: bounded, each key once, finite numbers."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

from capsyn.errors import ProblemError
from capsyn.sources.text import check_room, decoded
from capsyn.validation import describe, one_line

MEMORY = 32
"""Bytes that values take for each byte of text, at most."""
MOST_DIGITS = 300
"""Most digits of a whole number."""


class _Refused(ValueError):
    """What JSON allows, and a table must not have."""


def json_of(path: str, data: bytes) -> Any:
    """Return what is in the bytes of a JSON file; `path` is for errors.

    Raises
    ------
    ProblemError
        No JSON, nested too deeply, a key that comes twice in one object, or numbers that are not
        finite.
    """
    check_room(path, len(data), MEMORY)
    text = decoded(path, data)
    try:
        return json.loads(
            text,
            object_pairs_hook=_object,
            parse_float=_float,
            parse_int=_int,
            parse_constant=_constant,
        )
    except RecursionError:
        raise ProblemError(f"'{path}' is no table: its JSON is nested too deeply") from None
    except ValueError as error:  # of JSON itself, too
        raise ProblemError(f"'{path}' is no table: {one_line(str(error))}") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for k, key in enumerate(keys) if key in keys[:k])
        raise _Refused(f"the key {describe(twice)} comes twice in an object")
    return found


def _float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise _Refused(f"numbers must be finite; got {describe(text)}")
    return value


def _int(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise _Refused(f"whole numbers must have at most {MOST_DIGITS} digits")
    return int(text)


def _constant(text: str) -> NoReturn:
    raise _Refused(f"numbers must be finite; got {text}")


def told(value: Any) -> str:
    """Return a short text of a value, however deep it is."""
    if isinstance(value, dict):
        return f"an object with {len(value)} keys"
    return f"a list of {len(value)}" if isinstance(value, list) else describe(value)


def is_real(value: Any) -> bool:
    """Return whether a value is a number: not true or false, and not a text."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
