"""sSAC as plain data: what a process needs to answer as another one does."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from capsyn.answers import Packed
from capsyn.cluster import Job
from capsyn.domain import Box
from capsyn.model import Model
from capsyn.settings import SsacSettings
from capsyn.ssac import BatchController, batch_controller

PROBES = 2048
"""Random states whose solutions, bit by bit, tell whether two machines compute the same."""


@dataclasses.dataclass(frozen=True)
class LabelJob:
    """A controller's question: which symbols could be best.

    Parameters
    ----------
    model : Model
        The system.
    domain : Box
        Where the probe is taken.
    values, default : (N, m), (m,)
        The symbols' control vectors and that of the prediction [input units].
    horizon : float
        Prediction horizon T [s].
    settings : SsacSettings
        Options, with `steps` given.
    method : str
        The method of `BatchController` that answers.
    backend : "c" or "numpy"
        How to solve.
    """

    model: Model
    domain: Box
    values: np.ndarray
    default: np.ndarray
    horizon: float
    settings: SsacSettings
    method: str
    backend: str

    def plain(self) -> str:
        """Return this as JSON, the programs as a policy's file holds them."""
        data = {
            "model": self.model.to_json(),
            "domain": self.domain.to_json(),
            "values": self.values.tolist(),
            "default": self.default.tolist(),
            "horizon": self.horizon,
            "settings": self.settings.to_json(),
            "method": self.method,
            "backend": self.backend,
        }
        return json.dumps(data, sort_keys=True)

    def job(self) -> Job:
        """Return the job for workers, on batches of ``(states (B, n), rows of each chunk)``."""
        return Job(build, self.plain())


def build(plain: str) -> tuple[Callable[[tuple[np.ndarray, list[int]]], Packed], Callable[[], Any]]:
    """Return what answers and what probes, of a `LabelJob` as JSON; kernels are built here."""
    data = json.loads(plain)
    domain, values = Box(**data["domain"]), np.array(data["values"])
    controller = batch_controller(
        Model.from_json(data["model"], domain.n, values.shape[1], len(values)),
        domain,
        values,
        np.array(data["default"]),
        data["horizon"],
        SsacSettings(**data["settings"]),
        data["backend"],
    )
    label = getattr(controller, data["method"])

    def answer(batch: tuple[np.ndarray, list[int]]) -> Packed:
        states, rows = batch
        return Packed.of([label(chunk) for chunk in np.split(states, np.cumsum(rows)[:-1])])

    return answer, lambda: probe(controller, domain)


def probe(controller: BatchController, domain: Box) -> tuple[np.ndarray, ...]:
    """Return costs, gradients and scales of the probe."""
    solution = controller.solve(domain.sample(PROBES, 0))
    return solution.cost, solution.gradients, solution.scales
