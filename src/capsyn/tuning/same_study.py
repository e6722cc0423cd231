"""What makes a study that goes on the same study: its problem and its loops, in few words."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np

from capsyn.modelling.problem import Problem
from capsyn.modelling.tails.riccati import FIT
from capsyn.modelling.transcription import transcribe_target
from capsyn.tuning.figures import model_of
from capsyn.verification.monte_carlo import Prepared


def problem_facts(problem: Problem) -> list[Any]:
    """Return what the results of a problem depend on, as plain data."""
    return [
        problem.domain.to_json(), problem.alphabet.to_json(), problem.settings.to_json(),
        problem.grid.to_json(), problem.leaves, problem.horizon, problem.default_control,
        problem.outside, model_of(problem).to_json(), problem.tail == FIT, problem.delay,
        problem.min_dwell, None if problem.switching is None else problem.switching.to_json(),
    ]  # fmt: skip


def target_facts(problem: Problem, given: Any) -> Any:
    """Return the target that loops of a problem have, as plain data: that given, else its own."""
    target = problem.target if given is None else given
    if callable(target):
        target = transcribe_target(problem.replace(target=target))
    return getattr(target, "to_json", lambda: target)()


def loop_facts(test: Prepared) -> list[Any]:
    """Return what loops depend on beside problem and cost: all that was drawn, and how they run."""
    loop, options = test.experiment.loop, test.options
    drawn = hashlib.sha256(test.trials.tobytes()).hexdigest()
    noise = None if test.noise is None else [test.noise.deviations, list(test.noise.seeds)]
    holds = loop.holds
    return [
        drawn, noise, loop.period, loop.samples, loop.substeps, loop.outside_at_once,
        loop.inside.to_json(), loop.stop_at_target, loop.pushes, loop.told, options.within,
        options.hold, str(test.experiment.outside), holds.symbols, holds.inputs, holds.kinds,
    ]  # fmt: skip


def digest(facts: Any) -> str:
    """Return a short text for plain data, another for other data."""
    text = json.dumps(facts, sort_keys=True, default=lambda a: np.asarray(a).tolist())
    return hashlib.sha256(text.encode()).hexdigest()[:16]
