"""Built-in problems, by name; each module makes its own."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from capsyn.errors import ProblemError
from capsyn.problem import Problem

_MAKERS = {
    "cart-pendulum": ("cart_pendulum", "cart_pendulum"),
    "cart-pendulum-4": ("cart_pendulum", "cart_pendulum_4"),
    "double-tank-a": ("double_tank", "double_tank_a"),
    "double-tank-b": ("double_tank", "double_tank_b"),
    "cart-pole": ("cart_pole", "cart_pole"),
}


def names() -> list[str]:
    """Return the names of the built-in problems."""
    return list(_MAKERS)


def get(name: str) -> Problem:
    """Return a built-in problem.

    Raises
    ------
    ProblemError
        There is none of this name; the message suggests the nearest.
    """
    if name not in _MAKERS:
        near = difflib.get_close_matches(name, _MAKERS, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(_MAKERS)}"
        raise ProblemError(f"there is no problem '{name}'; {hint}")
    module, function = _MAKERS[name]
    maker: Callable[[], Problem] = getattr(
        importlib.import_module(f"capsyn.problems.{module}"), function
    )
    return maker()


def find(text: str) -> Problem:
    """Return the problem that a text names.

    Parameters
    ----------
    text : str
        A built-in name, ``path/to/file.py[:name]`` or ``package.module:name``; the name of the
        `Problem` in the file or module is ``problem`` unless given.

    Raises
    ------
    ProblemError
        There is no such problem, or the file that holds it fails.
    """
    place, colon, attribute = text.rpartition(":")
    if not colon or attribute.endswith(".py"):
        place, attribute = text, "problem"
    if place.endswith(".py"):
        module = _run(place, lambda: _load(Path(place)))
    elif colon:
        module = _run(place, lambda: importlib.import_module(place))
    else:
        return get(text)
    problem = getattr(module, attribute or "problem", None)
    if not isinstance(problem, Problem):
        raise ProblemError(f"'{place}' must hold a capsyn.Problem named '{attribute}'; found none")
    return problem


def _load(path: Path) -> ModuleType:
    """Run a file as a module; files beside it can be imported."""
    if not path.is_file():
        raise ProblemError(f"there is no file '{path}'")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.parent.resolve()))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.pop(0)
    return module


def _run(place: str, load: Callable[[], ModuleType]) -> ModuleType:
    try:
        return load()
    except ProblemError:
        raise
    except Exception as error:  # the user's own code may raise anything
        reason = " ".join(str(error).split())
        raise ProblemError(f"'{place}' failed: {type(error).__name__}: {reason}") from error
