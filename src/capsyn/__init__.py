"""capsyn: control alphabet policies from nonlinear models, small enough for any machine."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from capsyn.version import __version__ as __version__

if TYPE_CHECKING:
    from capsyn.alphabets.candidates import actuator_combinations as actuator_combinations
    from capsyn.alphabets.choose import choose_alphabet as choose_alphabet
    from capsyn.alphabets.study import AlphabetStudy as AlphabetStudy
    from capsyn.automata.automaton import Automaton as Automaton
    from capsyn.certification.certificate import Certificate as Certificate
    from capsyn.certification.certify import certify as certify
    from capsyn.compression.compress import compress as compress
    from capsyn.controllers.online import online_controller as online_controller
    from capsyn.errors import CapsynError as CapsynError
    from capsyn.explorer.explore import explore as explore
    from capsyn.exports.export import export as export
    from capsyn.improvement.improve import improve as improve
    from capsyn.limits.asked import KeepLimits as KeepLimits
    from capsyn.modelling.alphabet import Alphabet as Alphabet
    from capsyn.modelling.domain import Ball as Ball
    from capsyn.modelling.domain import Box as Box
    from capsyn.modelling.problem import Problem as Problem
    from capsyn.modelling.settings import SsacSettings as SsacSettings
    from capsyn.modelling.switching import Switching as Switching
    from capsyn.modelling.tails.riccati import riccati_tail as riccati_tail
    from capsyn.modelling.tails.tail import Tail as Tail
    from capsyn.optima.optimum import optimum as optimum
    from capsyn.policies.policy import DecisionTree as DecisionTree
    from capsyn.policies.policy import Policy as Policy
    from capsyn.simulation.simulate import Trajectory as Trajectory
    from capsyn.simulation.simulate import simulate as simulate
    from capsyn.simulation.tracking import tracking as tracking
    from capsyn.subdivision.subdivide import subdivide as subdivide
    from capsyn.synthesis.fitted_tail import fitted_tail as fitted_tail
    from capsyn.synthesis.synthesize import synthesize as synthesize
    from capsyn.tuning.free import Free as Free
    from capsyn.tuning.tune import tune as tune
    from capsyn.verification.agreement import agreement as agreement
    from capsyn.verification.lyapunov import lyapunov as lyapunov
    from capsyn.verification.monte_carlo import monte_carlo as monte_carlo
    from capsyn.verification.trials import Uniform as Uniform

_PUBLIC = {
    "Alphabet": "modelling.alphabet",
    "AlphabetStudy": "alphabets.study",
    "Automaton": "automata.automaton",
    "Ball": "modelling.domain",
    "Box": "modelling.domain",
    "CapsynError": "errors",
    "Certificate": "certification.certificate",
    "DecisionTree": "policies.policy",
    "Free": "tuning.free",
    "KeepLimits": "limits.asked",
    "Policy": "policies.policy",
    "Problem": "modelling.problem",
    "SsacSettings": "modelling.settings",
    "Switching": "modelling.switching",
    "Tail": "modelling.tails.tail",
    "Trajectory": "simulation.simulate",
    "Uniform": "verification.trials",
    "actuator_combinations": "alphabets.candidates",
    "agreement": "verification.agreement",
    "certify": "certification.certify",
    "choose_alphabet": "alphabets.choose",
    "compress": "compression.compress",
    "explore": "explorer.explore",
    "export": "exports.export",
    "fitted_tail": "synthesis.fitted_tail",
    "improve": "improvement.improve",
    "lyapunov": "verification.lyapunov",
    "monte_carlo": "verification.monte_carlo",
    "online_controller": "controllers.online",
    "optimum": "optima.optimum",
    "riccati_tail": "modelling.tails.riccati",
    "simulate": "simulation.simulate",
    "subdivide": "subdivision.subdivide",
    "synthesize": "synthesis.synthesize",
    "tracking": "simulation.tracking",
    "tune": "tuning.tune",
}
__all__ = list(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that ``import capsyn`` stays fast."""
    if name in _PUBLIC:
        value = getattr(importlib.import_module(f"capsyn.{_PUBLIC[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'capsyn' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])
