"""sSAC as plain data: what a process needs to answer as another one does."""

from __future__ import annotations

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


def label_job(
    model: Model,
    domain: Box,
    values: np.ndarray,
    default: np.ndarray,
    horizon: float,
    settings: SsacSettings,
    method: str,
    backend: str,
) -> Job:
    """Return the job of labelling batches of ``(states (B, n), states of each chunk)``.

    Parameters
    ----------
    model, domain, values, default, horizon, settings, backend
        As for `batch_controller`; `settings` with `steps`, `backend` "c" or "numpy".
    method : str
        The method of `BatchController` that answers.
    """
    plain = {
        "model": model.to_json(),  # the programs as a policy's file holds them
        "domain": domain.to_json(),
        "values": values.tolist(),
        "default": default.tolist(),
        "horizon": horizon,
        "settings": settings.to_json(),
        "method": method,
        "backend": backend,
    }
    return Job(build, json.dumps(plain, sort_keys=True))


def build(plain: str) -> tuple[Callable[[tuple[np.ndarray, list[int]]], Packed], Callable[[], Any]]:
    """Return what answers and what probes, of a `label_job`; kernels are built here."""
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
