"""Certificates: what is proved about the sampled loop from a set of starts, and what is not."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from capsyn.certification.cell_map import NO_START, OPEN, PROVED, REFUTED, cell_map
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.modelling.time_unit import NAMES
from capsyn.notebook import table
from capsyn.statistics import TOLD


@dataclass(frozen=True, eq=False)
class ProvedCells:
    """The grid of cells of a proof, in C order.

    Parameters
    ----------
    domain : Box
        The box that the cells divide: the policy's states.
    counts : n ints
        Cells along each axis, K cells in all.
    starts : (K,)
        Share of each cell's volume that lies in the initial set.
    arrives : (K,)
        Share of each cell's starts that are proved to arrive.
    within : (K,)
        Time by which all starts of a cell have arrived [time unit]; infinite if the cell is not
        wholly proved.
    stays : (K,) booleans
        Whether a loop may be in the cell once it has arrived. The loop then stays in such cells for
        ever.
    refuted : (K,) booleans
        Whether the cell has a start from which a simulated loop fails.
    """

    domain: Box
    counts: tuple[int, ...]
    starts: np.ndarray
    arrives: np.ndarray
    within: np.ndarray
    stays: np.ndarray
    refuted: np.ndarray

    def statuses(self) -> np.ndarray:
        """Return what is known of each cell, (K,) uint8: `NO_START`, `PROVED`, `OPEN`, `REFUTED`.

        A cell is proved if all of its starts are proved.
        """
        known = np.where(self.arrives >= 1, PROVED, OPEN)
        known = np.where(self.starts > 0, known, NO_START)
        return np.where(self.refuted, REFUTED, known).astype(np.uint8)


class Proof(Protocol):
    """What can write how something is proved."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to a file."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proved about a sampled loop. Shares are shares of the initial set's volume.

    Parameters
    ----------
    conditions : dict
        The conditions of the proof, as plain data: sets, rate, delay, noise and parameters.
    method : str
        The method of the proof: ``"pieces"`` (polygons cut at labels) or ``"boxes"``.
    cells : ProvedCells
        The grid, with what is proved about each cell.
    arrival : float
        Share of the starts that are proved to arrive in the target, without being in `avoid` or
        outside the domain before.
    staying : float
        Share of the starts that are proved to arrive, and to stay for ever in a set around the
        target; see `ripple`.
    avoiding : float
        Share of the starts that are proved never to be in `avoid`: before they arrive, and
        afterwards if they stay.
    within : float
        Time by which every proved start has arrived [time unit].
    switch_rate : float
        Bound on the changes of the symbol per time unit, on average in the long run; NaN if nothing
        stays.
    ripple : (n, 2)
        Least and greatest value of each state once the loop stays [state units]; NaN if nothing
        stays.
    refuted : (R, n)
        Starts from which a simulated loop fails.
    failures : R strings
        How each such loop fails: ``"stands still"``, ``"goes round"``, ``"leaves the domain"``,
        ``"enters avoid"``, ``"begins in avoid"`` or ``"does not arrive"``.
    open : float
        Share of the starts that are neither proved nor in a cell with a refuted start.
    replays : R strings
        The command that simulates each refuted start, if the command line made the certificate.
    seconds : float
        Time that the proof took [s].
    stopped : bool
        Whether the proof was stopped before its end. What is proved stays proved.
    proof : optional
        The proof that `save` writes.
    """

    conditions: dict[str, Any]
    method: str
    cells: ProvedCells
    arrival: float
    staying: float
    avoiding: float
    within: float
    switch_rate: float
    ripple: np.ndarray
    refuted: np.ndarray
    failures: tuple[str, ...]
    open: float
    replays: tuple[str, ...] = ()
    seconds: float = 0.0
    stopped: bool = False
    proof: Proof | None = None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the proof of arrival to a file at `path`, which ``capsyn check`` then checks.

        Raises
        ------
        ProblemError
            A certificate without a proof, such as one from a policy's file, or a place that cannot
            be written.
        """
        if self.proof is None:
            raise ProblemError("`certificate` must come from `capsyn.certify` to be saved")
        self.proof.save(path)

    def __repr__(self) -> str:
        unit = self.conditions.get("time_unit", "s")
        return (
            f"Certificate({self.arrival:.2%} proved to arrive within {self.within:.4g} {unit}, "
            f"{self.staying:.2%} to stay, {len(self.refuted)} refuted, {self.open:.2%} open)"
        )

    def _repr_html_(self) -> str:
        """Return what is proved as a table for notebooks."""
        unit = self.conditions.get("time_unit", "s")
        rows = [
            ("proved to arrive", f"{self.arrival:.2%} within {self.within:.4g} {unit}"),
            ("proved to stay", f"{self.staying:.2%}"),
            ("refuted starts", f"{len(self.refuted):,}"),
            ("open", f"{self.open:.2%}"),
            ("method", self.method),
        ]
        return table(repr(self), rows)

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, with the first `TOLD` refuted starts."""
        unit, domain = NAMES[self.conditions.get("time_unit", "s")], self.cells.domain
        refuted: list[dict[str, Any]] = [
            {"state": state, "failure": failure}
            for state, failure in zip(self.refuted[:TOLD].tolist(), self.failures)
        ]
        for start, replay in zip(refuted, self.replays):
            start["replay"] = replay
        return {
            "conditions": self.conditions,
            "method": self.method,
            "states": list(domain.names),
            "units": list(domain.units),
            "cells": list(self.cells.counts),
            "arrival": self.arrival,
            "staying": self.staying,
            "avoiding": self.avoiding,
            "within": _number(self.within),
            "switch_rate": _number(self.switch_rate),
            "ripple": None if np.isnan(self.ripple).any() else self.ripple.tolist(),
            "refuted": refuted,
            "open": self.open,
            "seconds": self.seconds,
            "stopped": self.stopped,
            "time_unit_name": unit,
        }

    def evidence(self) -> dict[str, Any]:
        """Return the evidence for a policy's file: the figures, and a map of the cells.

        Pass it to ``policy.with_evidence(certificate=..)``. `cell_map` describes the map.
        """
        cells = self.cells
        return self.to_json() | {"map": cell_map(cells.counts, cells.statuses(), cells.stays)}


def _number(value: float) -> float | None:
    """Return a number as JSON has it: None where it is not finite."""
    return value if math.isfinite(value) else None
