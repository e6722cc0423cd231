"""The policy of the states alone, while what it is told beside them stays."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from capsyn.cells.cut import cut
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.modelling.exogenous import one_exogenous
from capsyn.modelling.targets import INSIDE, Target, target_axes, target_program
from capsyn.programs.builder import restricted


def at(policy: Any, exogenous: Any) -> Any:
    """Return what `Policy.at` does."""
    told = policy.exogenous
    if told is None:
        raise ProblemError("`exogenous` must be left out: the policy is told nothing to be fixed")
    w = one_exogenous(exogenous, told)
    n = policy.domain.n
    steps = told.locate(w[None], policy.cells.counts[n:])[0]
    changes: dict[str, Any] = {
        "exogenous": None,
        "cells": cut(policy.cells, steps),
        "model": None if policy.model is None else policy.model.at(w),
        "target": cut_target(policy.target, policy.space, n, w),
        "kept": None if policy.kept is None else policy.kept.at(w, told),
        "statistics": {},
        "timings": {},
        "evidence": {},
    }
    if hasattr(policy, "guarantee"):
        changes["guarantee"] = dataclasses.replace(policy.guarantee, cut=True)
    return dataclasses.replace(policy, **changes)


def cut_target(target: Target | None, space: Box, n: int, w: np.ndarray) -> Target | None:
    """Return a target of the first n axes, where the others have the values w."""
    if target is None:
        return None
    if not hasattr(target, "instructions") and max(target_axes(target, space)) < n:
        return target
    program = target_program(target, space)
    return restricted(program, (("x", n),), INSIDE, {program.inputs[0][0]: w})
