"""What the page of a policy needs to know, as plain data."""

from __future__ import annotations

import base64
import warnings
from typing import Any

import numpy as np

from capsyn.automaton import Automaton
from capsyn.cells import CellTree
from capsyn.domain import Ball, Box
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.explorer.facts import facts
from capsyn.plant import choose_substeps, plant_of
from capsyn.policy import Policy
from capsyn.policy_file import CELL_ARRAYS, TREE_ARRAYS
from capsyn.report import report
from capsyn.split_tree import SplitTree
from capsyn.targets import describe_target, target_axes, target_program

RATES = (20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)
"""Sample rates that the page offers beside the policy's own [1 / s]."""
DEFAULT_RATE = 1000.0
"""Of a policy without settings [1 / s]."""
DRAWINGS = {
    "pendulum": ("theta", "omega"),
    "cart-pole": ("x", "v", "theta", "omega"),
    "double-tank": ("x1", "x2"),
}
"""Drawings that the page has, and the states that they are of."""
DRAWN = {
    "cart-pendulum": "pendulum",
    "cart-pendulum-4": "pendulum",
    "cart-pole": "cart-pole",
    "double-tank-a": "double-tank",
    "double-tank-b": "double-tank",
}
"""The drawings of the built-in problems."""


def page_data(policy: Policy, drawing: str | None = None) -> dict[str, Any]:
    """Return what the page of a policy shows and computes with, as plain data.

    Arrays are little-endian, in base64. ``model`` is null for a policy without dynamics.

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
    figures = report(policy)
    return {
        "name": policy.name,
        "domain": policy.domain.to_json(),
        "alphabet": policy.alphabet.to_json(),
        "names": [*policy.alphabet.names, "default"],
        "controls": policy.controls.tolist(),
        "default": policy.default.tolist(),
        "cells": _cells(policy.cells),
        "outside": policy.outside,
        "min_dwell": policy.min_dwell,
        "horizon": policy.horizon,
        "model": _model(policy),
        "target": _target(policy),
        "automaton": _automaton(policy),
        "drawing": _drawing(policy, drawing),
        "shares": policy.volume_shares.tolist(),
        "facts": facts(figures),
        "sha256": figures["sha256"],
    }


def packed(array: np.ndarray) -> str:
    """Return the bytes of an array, little-endian and in C order, in base64."""
    little = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<"), copy=False)
    return base64.b64encode(little.tobytes()).decode("ascii")


def _cells(cells: CellTree | SplitTree) -> dict[str, Any]:
    counts = [int(count) for count in cells.counts]
    if isinstance(cells, SplitTree):
        return {"kind": "tree", "counts": counts, "depth": cells.depth} | {
            name: packed(getattr(cells, name)) for name in TREE_ARRAYS
        }
    return {
        "kind": "cells",
        "counts": counts,
        "partitions": list(cells.partitions),
        "refinement": list(cells.refinement),
        "max_level": cells.max_level,
    } | {name: packed(getattr(cells, name)) for name in CELL_ARRAYS}


def _model(policy: Policy) -> dict[str, Any] | None:
    """Return the programs of the closed loop, and its integration steps at every rate offered."""
    if policy.model is None:
        return None
    own = DEFAULT_RATE if policy.settings is None else 1 / policy.settings.sample_time
    plant = plant_of(policy)
    with warnings.catch_warnings():  # a switch in the dynamics: the best steps there are
        warnings.simplefilter("ignore", CapsynWarning)
        substeps = {
            rate: choose_substeps(plant, policy.controls, np.zeros((0, 1)), 1 / rate)
            for rate in sorted({*RATES, own})
        }
    return {
        "dynamics": plant.dynamics.to_json(),
        "running_cost": plant.running_cost.to_json(),
        "terminal_cost": plant.terminal_cost.to_json(),
        "inside": None
        if policy.target is None
        else target_program(policy.target, policy.domain).to_json(),
        "rate": own,
        "rates": [{"rate": rate, "substeps": steps} for rate, steps in substeps.items()],
    }


def _target(policy: Policy) -> dict[str, Any] | None:
    """Return a target in words, and as a shape where it is one."""
    target, domain = policy.target, policy.domain
    if target is None:
        return None
    told: dict[str, Any] = {"text": describe_target(target, domain)}
    if isinstance(target, Ball):
        told["ball"] = {"center": target.center.tolist(), "radius": target.radius}
    if isinstance(target, Box):
        told["box"] = {"lower": target.lower.tolist(), "upper": target.upper.tolist()}
    if isinstance(target, (Ball, Box)):
        told["axes"] = target_axes(target, domain)
    return told


def _automaton(policy: Policy) -> dict[str, Any]:
    """Return the finite state machine; of oblique splits only which symbols there are."""
    if isinstance(policy.cells, SplitTree) and len(policy.cells.planes):
        used = np.unique(policy.cells.labels_at(policy.cells.mixed_cells)).tolist()
        edges = [(source, target, None, None) for source in used for target in used]
        cells = np.bincount(
            policy.cells.labels_at(policy.cells.mixed_cells), minlength=len(policy.controls)
        )
        what = "leaves"
        vertices = [
            {"symbol": k, "region": f"A{(k + 1) % len(policy.controls)}", "cells": int(cells[k])}
            for k in used
        ]
    else:
        machine = Automaton.of(policy)
        what = "cells" if isinstance(policy.cells, CellTree) else "leaves"
        vertices = [
            {
                "symbol": region.label,
                "region": machine.region_name(region.label),
                "cells": region.cells,
            }
            for region in machine.regions
        ]
        edges = [(e.source, e.target, e.possible, e.sliding) for e in machine.edges]
    keys = ("source", "target", "possible", "sliding")
    return {
        "vertices": vertices,
        "edges": [dict(zip(keys, edge)) for edge in edges],
        "what": what,
    }


def _drawing(policy: Policy, wanted: str | None) -> str | None:
    """Return the drawing of a policy's system, if there is one."""
    if wanted == "none":
        return None
    if wanted is None:
        found = DRAWN.get(policy.name)
        fits = found is not None and policy.domain.names == DRAWINGS[found]
        return found if fits else None
    if wanted not in DRAWINGS:
        raise ProblemError(
            f"`drawing` must be one of {', '.join(DRAWINGS)} or none; got '{wanted}'"
        )
    if len(DRAWINGS[wanted]) != policy.domain.n:
        raise ProblemError(
            f"`drawing` '{wanted}' is of {len(DRAWINGS[wanted])} states "
            f"({', '.join(DRAWINGS[wanted])}); the policy has {policy.domain.n}"
        )
    return wanted
