"""A policy as plain data for the page: what lookups and closed loops in JavaScript need."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.explorer.memory_data import memory_data, needs_memory, one_hold
from capsyn.modelling.discrete import horizon_time
from capsyn.policies.file import content_of
from capsyn.policies.policy import Policy
from capsyn.programs.builder import loop_programs
from capsyn.programs.continuity import rate_kinks
from capsyn.programs.step_doubling import FALLING, KINKED, STALLS, UNRESOLVED
from capsyn.simulation.closed_loop import SLACK
from capsyn.simulation.plant import (
    ACCURACY,
    COST_ACCURACY,
    LADDER,
    PERCENTILE,
    PIECES,
    SAMPLES,
    TRIED,
)

RATE = 1000.0
"""Sample rate of closed loops [1 / time unit] where a policy has no settings."""
STRUCTURE = ("partitions", "refinement", "max_level")


def policy_data(policy: Policy) -> dict[str, Any]:
    """Return a policy as plain data with arrays, which `pack` takes.

    It is what the policy's file holds (see docs/policy-format.md) but for the programs, which go to
    the page as JavaScript (`model_javascript`), with

    - ``domain``: the box of readings: the states, and after them the exogenous inputs, if any,
      which ``exogenous`` has alone;
    - ``symbols``, ``controls``: names (N + 1) and control vectors (N + 1, m), the default last; its
      name is "outside" where cells of it are gaps;
    - ``law``, only where it is true: the default is a law, and its control that of the middle;
    - ``counts``: steps of the lattice along each axis;
    - ``cells``: partitions, refinement, max_level and arrays, those of affine rows symbol by
      symbol; None of a decision tree;
    - ``tree``: arrays of a decision tree, else None;
    - ``features``: names and thresholds of a tree's features, or None; see `features_javascript`;
    - ``discrete``, only where it is true: the model is a map, once a sample;
    - ``horizon``: of the prediction as a time, or None;
    - ``rate``: sample rate [1 / time unit] of closed loops for which none is given;
    - ``slack``: samples by which a time that should be a whole number of them may be off;
    - ``sampled``: what the steps of closed loops are chosen by, see `choose_substeps`; None where
      there is no model, or a map;
    - ``memory``, of policies that `needs_memory` names: see `memory_data`. There ``min_dwell``
      is the least time of all symbols where they have the same.

    The sets of labels seen in mixed cells are bit masks of 32-bit words, lowest word first.
    """
    data = {"features": None} | content_of(policy)
    if data["features"]:
        data["features"] = {key: data["features"][key] for key in ("names", "thresholds")}
    del data["model"]
    structure = {k: data.pop(k) for k in STRUCTURE if k in data}
    arrays = policy.cells.arrays()
    if isinstance(policy.cells, CellTree):
        seen = np.bitwise_or.reduce(policy.cells.mixed_labels, axis=1)  # whatever is in force
        arrays["mixed_labels"] = _words(seen, len(policy.alphabet) + 1)
    if "row_symbols" in arrays:  # what is alike stands together
        order = np.argsort(arrays["row_symbols"], kind="stable")
        arrays |= {name: arrays[name][order] for name in ("row_constants", "row_slopes")}
    if isinstance(data["target"], dict) and "program" in data["target"]:
        data["target"] = {"program": None}
    if needs_memory(policy):
        data |= {"memory": memory_data(policy), "min_dwell": one_hold(policy)}
    if policy.model is not None and policy.model.prediction is not None:
        data["law"] = True
    if policy.discrete:
        data |= {"discrete": True, "horizon": horizon_time(policy)}
    return data | {
        "domain": policy.space.to_json(),
        "symbols": [*policy.alphabet.names, "outside" if policy.gaps else "default"],
        "controls": policy.controls.tolist(),
        "counts": list(policy.cells.counts),
        "cells": None,
        "tree": None,
        policy.cells.kind: structure | arrays,
        "rate": page_rate(policy),
        "slack": SLACK,
        "sampled": _sampled(policy),
    }


def _sampled(policy: Policy) -> dict[str, Any] | None:
    """Return what the page chooses the steps of closed loops by, as `choose_substeps` does."""
    if (model := policy.model) is None or policy.discrete:
        return None
    programs = loop_programs(model.dynamics, model.running_cost, discrete=False)
    return {
        "states": policy.space.sample(SAMPLES, 0),
        "accuracy": ACCURACY,
        "cost_accuracy": COST_ACCURACY,
        "percentile": PERCENTILE,
        "pieces": PIECES,
        "sides": len(rate_kinks(*programs).results),
        "kinked": KINKED,
        "ladder": list(LADDER),
        "falling": FALLING,
        "stalls": STALLS,
        "tried": TRIED,
        "unresolved": UNRESOLVED,
    }


def page_rate(policy: Policy) -> float:
    """Return the samples per time unit that a page begins with: the policy's own, if it has one."""
    return RATE if policy.settings is None else 1 / policy.settings.period


def _words(masks: np.ndarray, labels: int) -> np.ndarray:
    """Return bit masks (K, W) uint64 of labels as words of 32 bits (K, 1) or (K, 2 W)."""
    if labels < 32:
        return masks.astype(np.int64)
    return (
        np.stack([masks & np.uint64(0xFFFFFFFF), masks >> np.uint64(32)], axis=-1)
        .astype(np.uint32)
        .reshape(len(masks), -1)
    )
