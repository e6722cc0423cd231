"""Trials whose controller is a stand-in: a policy of one cell, for what decides without cells."""

from __future__ import annotations

import dataclasses

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.masks import word_count
from capsyn.controllers.formulation import Formulation
from capsyn.modelling.grid import Grid
from capsyn.modelling.problem import Problem
from capsyn.modelling.switching import Switching, SwitchRules
from capsyn.modelling.transcription import transcribe_target
from capsyn.policies.policy import Policy
from capsyn.verification.monte_carlo import Prepared, prepared
from capsyn.verification.trials import TrialOptions


def in_numbers(problem: Problem) -> Switching | None:
    """Return the switching of a problem with numbers in the place of shares."""
    return None if problem.switching is None else problem.switching.with_spread(1.0)


def stand_in_trials(problem: Problem, formulation: Formulation, plan: TrialOptions) -> Prepared:
    """Return trials of a plan under a stand-in for the policy of a problem: one cell."""
    switching = in_numbers(problem)
    policy = Policy(
        name=problem.name,
        domain=problem.domain,
        alphabet=problem.alphabet,
        default=problem.default_control,
        cells=_one_cell(problem.space.n, len(problem.alphabet) + 1),
        outside=problem.outside,
        min_dwell=problem.min_dwell,
        target=transcribe_target(problem),
        horizon=formulation.horizon,
        settings=formulation.settings,
        model=formulation.model,
        time_unit=problem.time_unit,
        outside_at_once=problem.outside_at_once,
        switching=switching and dataclasses.replace(switching, price=0.0, forbidden=()),
        delay=formulation.delay,
        exogenous=problem.exogenous,
    )
    test = prepared(policy, plan)
    if switching is None:
        return test
    experiment = test.experiment
    forbidden = SwitchRules.of(problem).forbidden
    holds = dataclasses.replace(experiment.loop.holds, forbidden=forbidden)
    loop = dataclasses.replace(experiment.loop, holds=holds)
    return dataclasses.replace(test, experiment=dataclasses.replace(experiment, loop=loop))


def _one_cell(n: int, labels: int) -> CellTree:
    """Return one cell for all states of n numbers, of the first of so many labels."""
    mixed = np.zeros((0, 1, word_count(labels)), dtype=np.uint64)
    entry, none = np.array([-1], dtype=np.int32), np.zeros(0, dtype=np.int32)
    return CellTree(Grid((1,) * n, (2,) * n, 0), entry, none, mixed)
