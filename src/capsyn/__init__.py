"""capsyn: control alphabet policies from nonlinear models, small enough for any machine."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from capsyn.alphabet import Alphabet as Alphabet
    from capsyn.automaton import Automaton as Automaton
    from capsyn.compression.compress import compress as compress
    from capsyn.decision_tree import DecisionTree as DecisionTree
    from capsyn.domain import Ball as Ball
    from capsyn.domain import Box as Box
    from capsyn.errors import CapsynError as CapsynError
    from capsyn.explorer.explore import explore as explore
    from capsyn.exports.export import export as export
    from capsyn.online import online_controller as online_controller
    from capsyn.policy import Policy as Policy
    from capsyn.problem import Problem as Problem
    from capsyn.settings import SsacSettings as SsacSettings
    from capsyn.simulation import Trajectory as Trajectory
    from capsyn.simulation import simulate as simulate
    from capsyn.subdivision import subdivide as subdivide
    from capsyn.synthesis import synthesize as synthesize
    from capsyn.verification.agreement import agreement as agreement
    from capsyn.verification.lyapunov import lyapunov as lyapunov
    from capsyn.verification.monte_carlo import Uniform as Uniform
    from capsyn.verification.monte_carlo import monte_carlo as monte_carlo

__version__ = "0.1.0"

_PUBLIC = {
    "Alphabet": "alphabet",
    "Automaton": "automaton",
    "Ball": "domain",
    "Box": "domain",
    "CapsynError": "errors",
    "DecisionTree": "decision_tree",
    "Policy": "policy",
    "Problem": "problem",
    "SsacSettings": "settings",
    "Trajectory": "simulation",
    "Uniform": "verification.monte_carlo",
    "agreement": "verification.agreement",
    "compress": "compression.compress",
    "explore": "explorer.explore",
    "export": "exports.export",
    "lyapunov": "verification.lyapunov",
    "monte_carlo": "verification.monte_carlo",
    "online_controller": "online",
    "simulate": "simulation",
    "subdivide": "subdivision",
    "synthesize": "synthesis",
}
__all__ = [
    "Alphabet",
    "Automaton",
    "Ball",
    "Box",
    "CapsynError",
    "DecisionTree",
    "Policy",
    "Problem",
    "SsacSettings",
    "Trajectory",
    "Uniform",
    "agreement",
    "compress",
    "explore",
    "export",
    "lyapunov",
    "monte_carlo",
    "online_controller",
    "simulate",
    "subdivide",
    "synthesize",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that ``import capsyn`` stays fast."""
    if name in _PUBLIC:
        value = getattr(importlib.import_module(f"capsyn.{_PUBLIC[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'capsyn' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])
