"""Finds what a text names: a built-in problem, or a problem or function in the user's files."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from capsyn import problems
from capsyn.errors import ProblemError
from capsyn.modelling.problem import Problem
from capsyn.tuning.free import free_arguments


def find_problem(text: str) -> Problem:
    """Return the problem of a built-in name, ``path/to/file.py[:name]`` or ``package.module:name``.

    The name of the `Problem` in the file or module is ``problem`` unless given. What the user's
    file prints while it is run goes to stderr.

    Raises
    ------
    ProblemError
        There is no such problem, the file that holds it fails, or some of it is free; the message
        names the file and, where it can, the line.
    """
    found = find_tunable(text)
    if isinstance(found, Problem):
        return found
    raise ProblemError(
        f"'{text}' has free settings ({', '.join(free_arguments(found))}): give them with "
        "--settings, or find them with capsyn tune"
    )


def find_tunable(text: str) -> Any:
    """Return what `find_problem` does, or a function that returns a problem, with free arguments.

    Raises
    ------
    ProblemError
        There is neither, or the file that holds it fails.
    """
    place, colon, name = text.rpartition(":")
    if not colon or name.endswith(".py"):
        place, name = text, ""
    name = name or "problem"
    if not place.endswith(".py") and not colon:
        if text not in problems.names() and Path(f"{text}.py").is_file():
            raise ProblemError(
                f"there is no built-in problem '{text}'; for the file give '{text}.py', or "
                f"'{text}.py:NAME' where the problem in it is not named 'problem'"
            )
        return problems.get(text)
    module = _load(place)
    found = getattr(module, name, None)
    if not isinstance(found, Problem) and not free_arguments(found):
        held = [key for key, value in vars(module).items() if isinstance(value, Problem)]
        held += [key for key, value in vars(module).items() if free_arguments(value)]
        names = ", ".join(f"{place}:{key}" for key in held) or "none"
        raise ProblemError(f"'{place}' must hold a capsyn.Problem named '{name}'; found {names}")
    return found


def find_function(text: str, others: tuple[type, ...] = ()) -> Any:
    """Return the function that ``path/to/file.py:name`` or ``package.module:name`` names.

    What is there may also be one of `others`.

    Raises
    ------
    ProblemError
        There is none, or the file fails.
    """
    place, name, function = _named(text, "a function")
    if not callable(function) and not isinstance(function, others):
        raise ProblemError(f"'{place}' must hold a function named '{name}'")
    return function


def find_controller(text: str) -> Any:
    """Return what acts, of ``path/to/file.py:name`` or ``package.module:name``.

    It is a function of states, or an agent with a method ``predict``.

    Raises
    ------
    ProblemError
        There is none, or the file fails.
    """
    place, name, found = _named(text, "a controller")
    if not callable(found) and not callable(getattr(found, "predict", None)):
        raise ProblemError(f"'{place}' must hold a function or an agent named '{name}'")
    return found


def find_symbols(text: str) -> Any:
    """Return the symbols of ``path/to/file.py:name`` or ``package.module:name``: not checked.

    They are an `Alphabet`, numbers or a box of inputs.

    Raises
    ------
    ProblemError
        There is nothing, or the file fails.
    """
    place, name, found = _named(text, "symbols")
    if found is None:
        raise ProblemError(f"'{place}' must hold symbols named '{name}'")
    return found


def _named(text: str, what: str) -> tuple[str, str, Any]:
    """Return place and name of ``PLACE:NAME``, and what is there under the name, None if nothing.

    `what` must be given so, as errors say.
    """
    place, colon, name = text.rpartition(":")
    if not colon or not name.isidentifier():
        raise ProblemError(f"{what} must be given as FILE.py:NAME; got '{text}'")
    return place, name, getattr(_load(place), name, None)


def given_source(policy: Any, text: str | None) -> Any:
    """Return the labelling function of a controller for a policy; None for None."""
    from capsyn.sources.callables import labels_of

    return None if text is None else labels_of(find_controller(text), policy.alphabet)


def find_features(text: str) -> dict[str, Any]:
    """Return the functions that ``path/to/file.py[:name]`` or ``package.module:name`` holds.

    They are a dict of functions by name, called ``features`` unless given.

    Raises
    ------
    ProblemError
        There is none, or the file fails.
    """
    place, colon, name = text.rpartition(":")
    if not colon or name.endswith(".py"):
        place, name = text, "features"
    if not place.endswith(".py") and not colon:
        raise ProblemError(f"features must be given as FILE.py or FILE.py:NAME; got '{text}'")
    features = getattr(_load(place), name, None)
    if not isinstance(features, dict):
        raise ProblemError(f"'{place}' must hold a dict of functions named '{name}'")
    return features


def _load(place: str) -> ModuleType:
    """Return the module that a file or a dotted name makes; files beside it can be imported."""
    path = Path(place)
    is_file = place.endswith(".py")
    if is_file and not path.is_file():
        raise ProblemError(f"there is no file '{place}'")
    entry = str(path.parent.resolve()) if is_file else os.getcwd()
    sys.path.insert(0, entry)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            return _run_file(path) if is_file else importlib.import_module(place)
    except (Exception, SystemExit) as error:  # the user's own code may raise anything
        lines = [
            frame.lineno
            for frame in traceback.extract_tb(error.__traceback__)
            if is_file and Path(frame.filename).resolve() == path.resolve()
        ]
        where = f"'{place}'" + (f", line {lines[-1]}" if lines else "")
        reason = " ".join(str(error).split())
        kind = "" if isinstance(error, ProblemError) else f"{type(error).__name__}: "
        raise ProblemError(f"{where}: {kind}{reason}") from error
    finally:
        if entry in sys.path:
            sys.path.remove(entry)


def _run_file(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module
