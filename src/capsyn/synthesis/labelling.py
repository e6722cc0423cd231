"""Who answers a synthesis: this process, or the workers of a cluster, with or without a memory."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.controllers.formulation import Formulation
from capsyn.controllers.ssac import BatchController, batch_controller
from capsyn.execution.answers import Labelling, Packed, digest
from capsyn.execution.checkpoint import Checkpoint
from capsyn.execution.cluster import Job, Workers
from capsyn.synthesis.remote_labels import IN_FLIGHT, RemoteLabels
from capsyn.version import __version__

PROBES = 2048
"""Random states whose solutions, bit by bit, tell whether two machines compute the same."""


@dataclass(frozen=True)
class Answerer:
    """What labels states."""

    controller: BatchController  # whose answers they are, in this process
    label: Labelling  # states (B, n) to an answer
    threads: int  # that should call it


@contextlib.contextmanager
def answerer(
    controller: BatchController,
    method: str,
    threads: int,
    backend: str = "auto",
    executor: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    about: Mapping[str, Any] | None = None,
) -> Iterator[Answerer]:
    """Yield what answers for a method, by its name, of a controller.

    It solves with `threads` of this process, or on the workers of an executor, with the backend
    that was asked for. The directory of a checkpoint is that of a `Checkpoint`, whose manifest
    holds what the questions are `about`: all that they depend on beside the controller, as plain
    data.
    """
    label = getattr(controller, method)
    with contextlib.ExitStack() as stack:
        if executor is not None:
            formulation = controller.formulation
            workers = Workers(
                executor,
                lambda used: label_job(formulation, method, used),
                backend,
                controller.backend,
            )
            if workers.used != controller.backend:
                controller = batch_controller(formulation, workers.used)
            label, threads = RemoteLabels(workers), IN_FLIGHT
            stack.callback(label.close)
        if checkpoint is not None:
            document = {**(about or {}), "answers": method, **manifest(controller)}
            label = stack.enter_context(Checkpoint(checkpoint, document)).remember(label)
        yield Answerer(controller, label, threads)


def manifest(controller: BatchController) -> dict[str, Any]:
    """Return all that the answers of a controller depend on, as plain data for a `Checkpoint`."""
    formulation = controller.formulation
    solved = {str(i): array for i, array in enumerate(probe(controller))}
    programs = json.dumps(formulation.model.to_json(), sort_keys=True)
    domain = formulation.domain.to_json()
    return {
        "capsyn": __version__,
        "model": hashlib.sha256(programs.encode()).hexdigest()[:16],
        **{key: domain[key] for key in ("lower", "upper", "periodic", "names")},
        "default": formulation.default.tolist(),
        "horizon": formulation.horizon,
        **dataclasses.asdict(formulation.settings),
        "backend": controller.backend,
        "bits of results": digest(solved)[:16],
    }


def label_job(formulation: Formulation, method: str, backend: str) -> Job:
    """Return the job of labelling batches of ``(states (B, n), states of each chunk)``.

    A method of `BatchController` answers, by its name; the formulation's settings have `steps`.
    """
    return Job(build, json.dumps([formulation.to_text(), method, backend]))


def build(plain: str) -> tuple[Callable[[tuple[np.ndarray, list[int]]], Packed], Callable[[], Any]]:
    """Return what answers and what probes, of a `label_job`; kernels are built here."""
    text, method, backend = json.loads(plain)
    controller = batch_controller(Formulation.from_text(text), backend)
    label = getattr(controller, method)

    def answer(batch: tuple[np.ndarray, list[int]]) -> Packed:
        states, rows = batch
        return Packed.of([label(chunk) for chunk in np.split(states, np.cumsum(rows)[:-1])])

    return answer, lambda: probe(controller)


def probe(controller: BatchController) -> tuple[np.ndarray, ...]:
    """Return costs, gradients and scales of the probe."""
    solution = controller.solve(controller.formulation.domain.sample(PROBES, 0))
    return solution.cost, solution.gradients, solution.scales
