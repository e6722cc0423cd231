"""Whose symbols a policy has that is not made by sSAC: what ``--source`` says."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from capsyn.cli.better.optimum import optimal_policy
from capsyn.cli.options import option_name, whole_number_list
from capsyn.errors import ProblemError

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.policies.policy import Policy

SOURCES = "ssac, optimum[:T], fcs:DEPTH[:BLOCK,..] or FILE.py:NAME"
SETTINGS = {"fcs": ("sample_time", "control_weight"), "optimum": ("sample_time",)}
"""Settings that a source takes; functions take the sample time."""


def kind_of(source: str) -> str:
    """Return which kind of source a text names: ssac, optimum, fcs or function."""
    name, colon, _ = source.partition(":")
    if name in ("optimum", "fcs") or source == "ssac":
        return name
    if not colon or name == "ssac":
        raise ProblemError(f"--source must be {SOURCES}; got '{source}'")
    return "function"


def sourced_policy(
    problem: Problem,
    source: str,
    options: dict[str, Any],
    rules: dict[str, Any],
    settings: dict[str, Any],
    unused: dict[str, Any],
) -> Policy:
    """Return the policy of a problem whose symbols are those of another source than sSAC.

    `options` are those of `capsyn.subdivide`, and the backend; `rules` are fields of the problem;
    what is None is its own. `settings` are fields of its settings that were given. `unused` are
    options by name that must be None.
    """
    from capsyn.execution.processors import processors
    from capsyn.sources.callables import labels_of, problem_policy

    kind = kind_of(source)
    taken = SETTINGS.get(kind, ("sample_time",))
    wrong = [option_name(name) for name in settings if name not in taken]
    wrong += [name for name, value in unused.items() if value is not None]
    if wrong:
        raise ProblemError(f"--source {kind if kind != 'function' else source} takes no {wrong[0]}")
    problem = problem.replace(**{key: value for key, value in rules.items() if value is not None})
    problem = problem.replace(settings=dataclasses.replace(problem.settings, **settings))
    if kind == "optimum":
        return optimal_policy(problem, source, options)
    given = {key: value for key, value in options.items() if value is not None}
    backend, threads = given.pop("backend"), processors(given.get("threads"))
    if kind == "fcs":
        from capsyn.sources.finite_control_set import finite_control_set

        depth, blocks = _sequence(source)
        control = finite_control_set(
            problem, depth, blocks=blocks, backend=backend, threads=threads
        )
        return problem_policy(control, problem, **given | {"threads": 1})
    from capsyn.cli.problem_finder import find_controller

    label = labels_of(find_controller(source), problem.alphabet)
    # one thread: a user's function may not like more
    policy = problem_policy(label, problem, **given | {"threads": 1})
    told = policy.statistics | {"source": {"function": source}}
    return dataclasses.replace(policy, statistics=told)


def _sequence(source: str) -> tuple[int, Any]:
    """Return the depth and the blocks of ``fcs:DEPTH[:BLOCK,..]``."""
    parts = source.split(":")[1:]
    if len(parts) not in (1, 2):
        raise ProblemError(f"--source fcs must be fcs:DEPTH or fcs:DEPTH:BLOCK,..; got '{source}'")
    depth, *blocks = (whole_number_list("--source fcs", part) for part in parts)
    if not isinstance(depth, int):
        raise ProblemError(f"--source fcs must have one depth; got '{source}'")
    return depth, blocks[0] if blocks else 1
