"""Built-in problems, by name; each module makes its own."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable
from typing import Any

from capsyn.errors import ProblemError
from capsyn.modelling.problem import Problem

_MAKERS = {
    "cart-pendulum": ("cart_pendulum", "cart_pendulum"),
    "cart-pendulum-4": ("cart_pendulum", "cart_pendulum_4"),
    "double-tank-a": ("double_tank", "double_tank_a"),
    "double-tank-b": ("double_tank", "double_tank_b"),
    "cart-pole": ("cart_pole", "cart_pole"),
    "planar-quadrotor": ("planar_quadrotor", "planar_quadrotor"),
    "spacecraft": ("spacecraft", "spacecraft"),
    "double-pendulum": ("double_pendulum", "double_pendulum"),
    "boost-converter": ("boost_converter", "boost_converter"),
    "inverter": ("inverter", "inverter"),
    "building": ("building", "building"),
    "docking": ("docking", "docking"),
    "quadrotor": ("quadrotor", "quadrotor"),
}


_GREEDY: dict[str, dict[str, Any]] = {
    "cart-pole": {"tail": None, "horizon": 0.6, "leaves": "constant", "max_level": 2},
    "spacecraft": {"tail": None, "horizon": 2.0, "max_level": 1},
    "planar-quadrotor": {"tail": None, "horizon": 0.8, "max_level": 1},
}
"""What problems were before they had what serves them; `GREEDY` of a module says it, too."""


def names() -> list[str]:
    """Return the names of the built-in problems."""
    return list(_MAKERS)


def plain(name: str) -> Problem:
    """Return a built-in problem without its `Switching` and its tail, as in the paper.

    The policy of this problem does not depend on the symbol in force. The horizon of this problem
    is longer, because it has no tail.

    Raises
    ------
    ProblemError
        No built-in problem has this name. The message suggests the nearest name.
    """
    problem, (module, _) = get(name), _MAKERS[name]
    before = getattr(_module(module), "GREEDY", _GREEDY.get(name, {}))
    return problem.replace(switching=None, **{"tail": None, **before})


def get(name: str) -> Problem:
    """Return a built-in problem, with a price on switching that suits its actuators.

    Raises
    ------
    ProblemError
        No built-in problem has this name. The message suggests the nearest name.
    """
    if name not in _MAKERS:
        near = difflib.get_close_matches(name, _MAKERS, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(_MAKERS)}"
        raise ProblemError(f"there is no problem '{name}'; {hint}")
    module, function = _MAKERS[name]
    maker: Callable[[], Problem] = getattr(_module(module), function)
    return maker()


def _module(name: str) -> Any:
    return importlib.import_module(f"capsyn.problems.{name}")
