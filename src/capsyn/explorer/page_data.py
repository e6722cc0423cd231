"""What the page of a policy needs to know, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.automata.automaton import edges_between
from capsyn.errors import ProblemError
from capsyn.explorer.facts import facts
from capsyn.explorer.policy_data import policy_data
from capsyn.modelling.domain import Ball
from capsyn.modelling.targets import describe_target, target_axes
from capsyn.policies.colors import PALETTE
from capsyn.policies.policy import Policy
from capsyn.policies.report import report

DRAWINGS = {
    "pendulum": ("theta", "omega"),
    "cart-pole": ("x", "v", "theta", "omega"),
    "double-tank": ("x1", "x2"),
}
"""Drawings that the page has, and the states that they are of."""
DRAWN_INPUTS = {"pendulum": 1, "cart-pole": 1, "double-tank": 3}
"""How many inputs they show."""
DRAWN_LENGTH = {"pendulum": 2.0, "cart-pole": 2.0, "double-tank": 0.5}
"""How long their poles are, and how high the upper tank is above the lower [m]."""
DRAWN = {
    "cart-pendulum": "pendulum",
    "cart-pendulum-4": "pendulum",
    "cart-pole": "cart-pole",
    "double-tank-a": "double-tank",
    "double-tank-b": "double-tank",
}
"""The drawings of the built-in problems."""
LEAVES = {"cells": "cells", "tree": "leaves"}
"""What the page calls the leaves of cells, and of a tree."""


def page_data(policy: Policy, drawing: str | None = None) -> dict[str, Any]:
    """Return what the page of a policy shows and computes with: `policy_data` and more.

    Parameters
    ----------
    policy : Policy
        The policy, or decision tree.
    drawing : str, optional
        One of `DRAWINGS`, or ``"none"``. Default: that of the built-in problem of this name.

    Raises
    ------
    ProblemError
        A drawing of other states, or none of that name.
    """
    figures, drawn = report(policy), _drawing(policy, drawing)
    return policy_data(policy) | {
        "target": _target(policy),
        "automaton": _automaton(policy),
        "drawing": drawn,
        "drawn_length": None if drawn is None else DRAWN_LENGTH[drawn],
        "palette": list(PALETTE),
        "shares": policy.volume_shares.tolist(),
        "loops": policy.model is not None,
        "facts": facts(figures),
    }


def _target(policy: Policy) -> dict[str, Any] | None:
    """Return a target in words, and as a ball where it is one."""
    target, domain = policy.target, policy.domain
    if target is None:
        return None
    description: dict[str, Any] = {"text": describe_target(target, domain)}
    if isinstance(target, Ball):
        description["ball"] = {"center": target.center.tolist(), "radius": target.radius}
        description["axes"] = target_axes(target, domain)
    return description


def _automaton(policy: Policy) -> dict[str, Any]:
    """Return the finite state machine; of oblique splits only which symbols there are."""
    counts = np.bincount(policy.cells.leaf_labels(), minlength=len(policy.controls))
    used = np.flatnonzero(counts).tolist()
    if policy.has_planes:
        edges: list[Any] = [(source, target, None, None) for source in used for target in used]
    else:
        edges = [(e.source, e.target, e.possible, e.sliding) for e in edges_between(policy, used)]
    keys = ("source", "target", "possible", "sliding")
    return {
        "vertices": [{"symbol": k, "cells": int(counts[k])} for k in used],
        "edges": [dict(zip(keys, edge)) for edge in edges],
        "what": LEAVES[policy.cells.kind],
    }


def _drawing(policy: Policy, wanted: str | None) -> str | None:
    """Return the drawing of a policy's system, if there is one."""
    if wanted == "none":
        return None
    if wanted is None:
        usual = DRAWN.get(policy.name)
        fits = usual is not None and policy.domain.names == DRAWINGS[usual]
        return usual if fits else None
    if wanted not in DRAWINGS:
        raise ProblemError(
            f"`drawing` must be one of {', '.join(DRAWINGS)} or none; got '{wanted}'"
        )
    if len(DRAWINGS[wanted]) != policy.domain.n:
        raise ProblemError(
            f"`drawing` '{wanted}' is of {len(DRAWINGS[wanted])} states "
            f"({', '.join(DRAWINGS[wanted])}); the policy has {policy.domain.n}"
        )
    if DRAWN_INPUTS[wanted] != len(policy.alphabet.inputs):
        raise ProblemError(
            f"`drawing` '{wanted}' shows {DRAWN_INPUTS[wanted]} inputs; "
            f"the policy has {len(policy.alphabet.inputs)}"
        )
    return wanted
