"""What to free next where no settings meet the goal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capsyn.errors import ProblemError
from capsyn.tuning.family import Family
from capsyn.tuning.goal import Goal

OTHER = 0.25
"""Share of all ranges at which what does not change is fixed."""


MORE = "try more settings, or a finer grid"
"""Advice where there is no other."""


def advice(family: Family, settings: Mapping[str, Any], goal: Goal) -> str:
    """Return what to free next: ranges at whose bounds the best settings lie, and what is fixed."""
    edges = {name: free.edge(settings[name]) for name, free in family.free.items()}
    steps = [
        f"widen {name}, which is best at its bound {edge}"
        for name, edge in edges.items()
        if edge is not None
    ]
    first = family(family.middle)
    try:
        other = family({name: free.value(free.at(OTHER)) for name, free in family.free.items()})
    except ProblemError:  # settings that the function does not take say nothing of what is fixed
        return ", ".join(steps) or MORE
    same = {
        "horizon": first.horizon == other.horizon,
        "control_weight": first.settings.control_weight == other.settings.control_weight,
        "price": goal.least in ("switches", "knee") and first.switching == other.switching,
    }
    if first.tail is None:
        steps.append("give the problem a tail")
    elif first.tail == other.tail and str(first.tail).startswith("riccati"):
        same["tail"] = True
    steps += [f"free {name}" for name, is_same in same.items() if is_same]
    return ", ".join(steps) or MORE
