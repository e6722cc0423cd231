"""sSAC without cells in compiled closed loops, each loop among the symbols of its own alphabet."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence

import numpy as np

from capsyn.controllers.formulation import Formulation
from capsyn.controllers.solver import TIE, bind_default, first_step, relative_rounding
from capsyn.modelling.problem import Problem
from capsyn.modelling.transcription import candidate_insertion
from capsyn.native.source import hand_written
from capsyn.programs.builder import bind
from capsyn.programs.program import Program


class Choice(ctypes.Structure):
    """The ``choice`` of choose.c."""

    _fields_ = [
        *(
            (name, ctypes.c_void_p)
            for name in "first symbols efforts prices shares spreads".split()
        ),
        *((name, ctypes.c_double) for name in "horizon rounding tie gamma alpha_d".split()),
        *((name, ctypes.c_int64) for name in "steps steepest to_default longest".split()),
        ("uses", ctypes.c_void_p),
    ]


def chooses(formulation: Formulation) -> bool:
    """Return whether choose.c knows the rules of a formulation; else NumPy decides."""
    settings, model = formulation.settings, formulation.model
    exact_map = model.sample_time is not None and settings.sensitivity != "first order"
    idle = formulation.prices is not None and settings.on_no_descent == "default"
    return not (exact_map or idle or formulation.delay)


def chooser_source(problem: Problem, formulation: Formulation) -> tuple[str, dict[str, Program]]:
    """Return the C source and the programs of a chooser, for `SimulationKernel.build`."""
    bound = bind_default(formulation.model, formulation.default)
    insertion = candidate_insertion(problem)
    if formulation.model.prediction is None:
        insertion = bind(insertion, u=formulation.default)
    programs = {
        "step": bound.step,
        "adjoint": bound.adjoint,
        "terminal_cost": bound.terminal_cost,
        "insertion": insertion,
    }
    text = hand_written("alphabets/loops/choose.c")
    return f"#define FIRST {first_step(formulation.model)}\n{text}", programs


def choices_of(
    formulation: Formulation,
    efforts: np.ndarray,
    sets: Sequence[np.ndarray],
    uses: np.ndarray,
    priced: tuple[np.ndarray, np.ndarray, np.ndarray] | None,
) -> Callable[[int], Choice]:
    """Return what compiled loops need, by the number of their first trial.

    Trials choose among `sets` (N,) of places in a pool with `efforts` (K + 1,), and count what they
    use in `uses` (T, longest) int32. `priced` are prices and shares (K + 1, K + 1), and the spreads
    (A,) of the sets that prices have for each share.
    """
    settings = formulation.settings
    ordered = [own[np.argsort(efforts[own], kind="stable")] for own in sets]
    arrays = {
        "first": np.concatenate([[0], np.cumsum([len(own) for own in sets])]).astype(np.int64),
        "symbols": np.concatenate(ordered).astype(np.int64),
        "efforts": np.ascontiguousarray(efforts, dtype=np.float64),
    }
    if priced is not None:
        names = ("prices", "shares", "spreads")
        arrays |= {n: np.ascontiguousarray(a, np.float64) for n, a in zip(names, priced)}

    def choices(start: int) -> Choice:
        choice = Choice(
            horizon=formulation.horizon,
            rounding=relative_rounding(np.float64),
            tie=TIE,
            gamma=settings.gamma,
            alpha_d=np.nan if settings.alpha_d is None else settings.alpha_d,
            steps=settings.steps,
            steepest=settings.rule == "steepest",
            to_default=settings.on_no_descent == "default",
            longest=uses.shape[1],
            uses=uses[start:].ctypes.data,
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        choice.arrays = arrays  # are kept alive
        return choice

    return choices
