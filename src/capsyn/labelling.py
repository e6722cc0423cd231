"""Who answers a synthesis: this process, or the workers of a cluster, with or without a memory."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from capsyn import __version__
from capsyn.answers import Labelling, digest
from capsyn.checkpoint import Checkpoint
from capsyn.cluster import Workers
from capsyn.label_job import label_job, probe
from capsyn.model import Model
from capsyn.problem import Problem
from capsyn.remote_labels import IN_FLIGHT, RemoteLabels
from capsyn.ssac import BatchController, batch_controller


@dataclass(frozen=True)
class Answerer:
    """What labels states.

    Parameters
    ----------
    controller : BatchController
        The controller whose answers they are, in this process.
    label : callable
        States (B, n) to an answer.
    threads : int
        Threads that should call it.
    """

    controller: BatchController
    label: Labelling
    threads: int


@contextlib.contextmanager
def answerer(
    controller: BatchController,
    problem: Problem,
    model: Model,
    method: str,
    threads: int,
    backend: str = "auto",
    executor: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    asked: dict[str, Any] | None = None,
) -> Iterator[Answerer]:
    """Yield what answers for a method of a controller.

    Parameters
    ----------
    controller : BatchController
        Of `problem` and its transcribed `model`.
    method : str
        The name of its method.
    threads : int
        Threads of this process that solve, where it does.
    backend : "auto", "c" or "numpy"
        As asked for.
    executor : dask.distributed.Client, optional
        The workers to ask.
    checkpoint : path, optional
        The directory of a `Checkpoint`.
    asked : dict, optional
        What the questions depend on beside the problem, as plain data, for the manifest.
    """
    values, default = problem.alphabet.values, problem.default
    given = (model, problem.domain, values, default, problem.horizon, controller.settings)
    label = getattr(controller, method)
    with contextlib.ExitStack() as stack:
        if executor is not None:
            workers = Workers(
                executor,
                lambda used: label_job(*given, method, used),
                backend,
                controller.backend,
            )
            if workers.used != controller.backend:
                controller = batch_controller(*given, workers.used)
            label, threads = RemoteLabels(workers), IN_FLIGHT
            stack.callback(label.close)
        if checkpoint is not None:
            about = manifest(controller, problem, model, {"answers": method, **(asked or {})})
            label = stack.enter_context(Checkpoint(checkpoint, about)).remember(label)
        yield Answerer(controller, label, threads)


def manifest(
    controller: BatchController, problem: Problem, model: Model, asked: dict[str, Any]
) -> dict[str, Any]:
    """Return all that answers and questions depend on, as plain data for a `Checkpoint`."""
    solved = {str(i): array for i, array in enumerate(probe(controller, problem.domain))}
    programs = json.dumps(model.to_json(), sort_keys=True)
    settings = dataclasses.asdict(controller.settings)
    return {
        "capsyn": __version__,
        "name": problem.name,
        "model": hashlib.sha256(programs.encode()).hexdigest()[:16],
        **{key: problem.domain.to_json()[key] for key in ("lower", "upper", "periodic", "names")},
        "alphabet": problem.alphabet.to_json(),
        "default": problem.default.tolist(),
        "horizon": problem.horizon,
        "partitions": list(problem.partitions),
        "refinement": list(problem.refinement),
        "max_level": problem.max_level,
        "outside": problem.outside,
        "min_dwell": problem.min_dwell,
        **settings,
        **asked,
        "backend": controller.backend,
        "bits of results": digest(solved)[:16],
    }
