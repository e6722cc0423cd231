"""What the page of a policy needs to know, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.automata.automaton import edges_between
from capsyn.cells.cell_tree import CellTree
from capsyn.cells.split_tree import SplitTree
from capsyn.errors import ProblemError
from capsyn.explorer.facts import facts
from capsyn.explorer.memory_data import memory_automaton, memory_facts, needs_memory
from capsyn.explorer.policy_data import policy_data
from capsyn.modelling.domain import Ball
from capsyn.modelling.targets import describe_target, target_axes
from capsyn.policies.colors import symbol_looks, tiles
from capsyn.policies.policy import Policy
from capsyn.policies.report import report

DRAWINGS: dict[str, tuple[tuple[str, ...], int, float]] = {
    "pendulum": (("theta", "omega"), 1, 2.0),
    "cart-pole": (("x", "v", "theta", "omega"), 1, 2.0),
    "double-tank": (("x1", "x2"), 3, 0.5),
}
"""Drawings that the page has: the states that they are of, how many inputs they show, and how long
their poles are, or how high the upper tank is above the lower [m]."""
DRAWN = {"cart-pendulum": "pendulum", "cart-pendulum-4": "pendulum", "cart-pole": "cart-pole"}
DRAWN |= dict.fromkeys(["double-tank-a", "double-tank-b"], "double-tank")
"""The drawings of the built-in problems."""


def page_data(policy: Policy, drawing: str | None = None) -> dict[str, Any]:
    """Return what the page of a policy shows and computes with: `policy_data` and more.

    For the drawing, of which `ProblemError` tells if it does not fit, see `explore`.
    """
    figures, drawn = report(policy), _drawing(policy, drawing)
    return policy_data(policy) | {
        "target": _target(policy),
        "automaton": _automaton(policy),
        "leaves": policy.cells.leaf_count,
        "drawing": drawn,
        "drawn_length": None if drawn is None else DRAWINGS[drawn][2],
        "looks": [[look.color, look.marks] for look in symbol_looks(len(policy.alphabet))],
        "tiles": tiles().astype(np.uint8),
        "shares": policy.volume_shares.tolist(),
        "loops": policy.model is not None,
        "proved": _proved(policy, figures["evidence"].get("certificate", {})),
        "facts": facts(figures, memory_facts(policy) if needs_memory(policy) else []),
    }


def _proved(policy: Policy, certificate: dict[str, Any]) -> dict[str, Any] | None:
    """Return the map of a certificate, its ripple and the refuted starts; None without a map."""
    if "map" not in certificate or certificate["states"] != list(policy.domain.names):
        return None
    keys = ("ripple", "refuted")
    return certificate["map"] | {key: certificate[key] for key in keys}


def _target(policy: Policy) -> dict[str, Any] | None:
    """Return a target in words, and as a ball where it is one."""
    target, domain = policy.target, policy.space
    if target is None:
        return None
    description: dict[str, Any] = {"text": describe_target(target, domain)}
    if isinstance(target, Ball):
        description["ball"] = {"center": target.center.tolist(), "radius": target.radius}
        description["axes"] = target_axes(target, domain)
    return description


def _automaton(policy: Policy) -> dict[str, Any]:
    """Return the finite state machine; of oblique splits and affine leaves which symbols there are.

    An affine leaf is one of the cells of each symbol of its rows. Of pages with memory see
    `memory_automaton`.
    """
    what = "cells" if policy.cells.kind == "cells" else "leaves"
    if needs_memory(policy):
        vertices, edges = memory_automaton(policy)
        return {"vertices": vertices, "edges": edges, "what": what}
    counts = np.bincount(_leaf_labels(policy.cells), minlength=len(policy.controls))
    used = np.flatnonzero(counts).tolist()
    if policy.has_planes:
        pairs: list[Any] = [(source, target, None, None) for source in used for target in used]
    else:
        pairs = [(e.source, e.target, e.possible, e.sliding) for e in edges_between(policy, used)]
    keys = ("source", "target", "possible", "sliding")
    return {
        "vertices": [{"symbol": k, "cells": int(counts[k])} for k in used],
        "edges": [dict(zip(keys, pair)) for pair in pairs],
        "what": what,
    }


def _leaf_labels(cells: CellTree | SplitTree) -> np.ndarray:
    """Return the labels of all leaves, of affine ones those of all their rows."""
    if not isinstance(cells, CellTree) or cells.affine is None:
        return cells.leaf_labels()
    labels = cells.labels_at(np.flatnonzero(cells.entries < 0))
    return np.concatenate([labels[labels < cells.affine.first], cells.affine.symbols])


def _drawing(policy: Policy, wanted: str | None) -> str | None:
    """Return the drawing of a policy's system, if there is one."""
    if wanted == "none":
        return None
    if wanted is None:
        usual = DRAWN.get(policy.name)
        return usual if usual and policy.domain.names == DRAWINGS[usual][0] else None
    if wanted not in DRAWINGS:
        raise ProblemError(
            f"`drawing` must be one of {', '.join(DRAWINGS)} or none; got '{wanted}'"
        )
    states, inputs, _ = DRAWINGS[wanted]
    if len(states) != policy.domain.n:
        raise ProblemError(
            f"`drawing` '{wanted}' is of {len(states)} states ({', '.join(states)}); the policy "
            f"has {policy.domain.n}"
        )
    if inputs != policy.alphabet.m:
        raise ProblemError(
            f"`drawing` '{wanted}' shows {inputs} inputs; the policy has {policy.alphabet.m}"
        )
    return wanted
