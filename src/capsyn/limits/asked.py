"""How limits are to be kept: the sampled loop, and the cells in which capsyn looks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError, warn
from capsyn.limits.invariant import LimitedLoop
from capsyn.limits.tubes import Flow
from capsyn.modelling.discrete import refuse_map
from capsyn.modelling.grid import MAX_COUNT
from capsyn.modelling.transcription import user_program
from capsyn.native.bounds import box_bounds
from capsyn.policies.policy import Policy, cell_tree
from capsyn.programs.program import Ports, Program
from capsyn.validation import describe, finite_number, keep, whole_numbers

MOST_PAIRS = 1 << 20
"""Most cells times labels that are taken unless told."""
FINE = 8
"""Cells that most of what moves in a sample crosses, where so many are affordable."""
SAMPLES = 2048
"""Random states at which it is looked how far they move in a sample."""


@dataclass(frozen=True)
class KeepLimits:
    """How a policy keeps limits; see ``keep_limits`` of `synthesize`.

    Parameters
    ----------
    cells : int or (n,), optional
        Cells along each axis of states and exogenous inputs. Default: the policy's own grid, made
        as fine as the motion of states in a sample asks for and `MOST_PAIRS` allows.
    model : callable ``(x, u, p) -> n rates``, or ``(x, u, w, p)``, optional
        The plant with parameters p, if the plant differs from the problem's model.
    parameters : mapping of names to pairs, optional
        Ranges (low, high) of the components of p, in order. Limits are kept for all constant
        parameters within these ranges.

    Raises
    ------
    ProblemError
        An argument that cannot be used.
    """

    cells: Any = None
    model: Callable[..., Any] | None = None
    parameters: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.model is not None and not callable(self.model):
            raise ProblemError(
                f"`model` must be a function of x, u and p; got {describe(self.model)}"
            )
        if not isinstance(self.parameters, Mapping):
            raise ProblemError(
                f"`parameters` must be ranges by name; got {describe(self.parameters)}"
            )
        ranges = {}
        for name, ends in self.parameters.items():
            if not isinstance(ends, (tuple, list, np.ndarray)) or len(ends) != 2:
                raise ProblemError(f"`parameters` must be pairs (low, high); got {describe(ends)}")
            low, high = (finite_number(f"parameters['{name}']", end) for end in ends)
            if low > high:
                raise ProblemError(
                    f"`parameters` must be pairs (low, high); got {low:g} to {high:g} for '{name}'"
                )
            ranges[str(name)] = (low, high)
        if ranges and self.model is None:
            raise ProblemError("`parameters` need a `model`, a function of x, u and p; got none")
        keep(self, parameters=ranges)

    def dynamics(self, policy: Policy) -> Program:
        """Return the dynamics of the plant of a `policy`, with or without parameters."""
        assert policy.model is not None
        own, names = policy.model.dynamics, self.parameters
        if self.model is None:
            return own
        n = policy.space.n
        inputs: Ports = (*own.inputs, *((("p", len(names)),) if names else ()))
        told = n - policy.domain.n
        more: dict[str, Any] = {"told": told, "rates": True, "parameters": True}
        return user_program("model", self.model, inputs, own.outputs, **more)


def check_limits(problem: Any, asked: Any) -> KeepLimits | None:
    """Return how limits of a problem are to be kept; None where they need not be.

    `asked` is true, false or a `KeepLimits`. What cannot be done is a `ProblemError`.
    """
    if asked is False:
        return None
    if asked is not True and not isinstance(asked, KeepLimits):
        raise ProblemError(
            f"`keep_limits` must be True, False or a capsyn.KeepLimits; got {describe(asked)}"
        )
    asked = KeepLimits() if asked is True else asked
    if problem.limits is None:
        raise ProblemError("`keep_limits` needs a problem with `limits`; this one has none")
    refuse_map(problem, "keep_limits", "enclosures follow what happens between samples")
    unit, period, delay = problem.time_unit, problem.settings.period, problem.delay
    if delay > period:
        raise ProblemError(
            f"`keep_limits` needs a delay of at most the sample time, {period:g} {unit}; "
            f"got {delay:g} {unit}"
        )
    switching = problem.switching
    if switching is not None and switching.input_holds(problem.alphabet).any():
        raise ProblemError("`keep_limits` takes no `hold` of inputs; holds of symbols will do")
    if asked.cells is not None:
        most = {"least": 1, "most": MAX_COUNT}
        whole_numbers("cells", asked.cells, problem.space.n, **most)
    return asked


def limited_loop(policy: Policy, asked: KeepLimits, backend: str = "auto") -> LimitedLoop:
    """Return the loop of a policy with its model's limits, and the cells to look at."""
    assert policy.model is not None and policy.settings is not None
    assert policy.model.limits is not None
    rules, period, labels = policy.rules, policy.settings.period, len(policy.controls)
    layered = policy.switching is not None or policy.delay > 0
    own_default = policy.settings.on_no_descent == "default"
    candidates = labels if own_default else labels - 1
    samples = np.maximum(1, np.ceil(rules.holds / period - 1e-9)).astype(np.int64)  # as loops do
    for kind in np.unique(rules.kinds):
        alike = np.flatnonzero(rules.kinds == kind)
        if len(set(samples[alike].tolist())) > 1:
            names = " and ".join(policy.alphabet.names[k] for k in alike[:2])
            raise ProblemError(
                f"`keep_limits` needs one `hold` for symbols of the same control; {names} differ"
            )
    pairs = candidates * (labels if policy.delay else 1)
    ends = np.array(list(asked.parameters.values())).reshape(-1, 2).T
    ranges = (ends[0], ends[1]) if asked.parameters else None
    counts = _counts(policy, period, pairs) if asked.cells is None else asked.cells
    counts = whole_numbers("cells", counts, policy.space.n, least=1, most=MAX_COUNT)
    policy.space.check_resolution(counts)
    return LimitedLoop(
        Flow.of(asked.dynamics(policy), backend),
        box_bounds(policy.model.limits, backend),
        policy.space,
        policy.space.n - policy.domain.n,
        counts,
        policy.controls,
        candidates,
        period,
        samples,
        policy.delay,
        rules.forbidden if layered else None,
        ranges,
    )


def moved(policy: Policy, period: float) -> np.ndarray:
    """Return how far states move in a sample, (n,): the median of the fastest symbols'."""
    assert policy.model is not None
    states = policy.space.sample(SAMPLES, 0).T
    fastest = np.zeros(states.shape)
    for control in policy.controls[:-1]:
        u = np.repeat(control[:, None], SAMPLES, axis=1)
        rates = np.abs(policy.model.dynamics.evaluate(states, u)[0])
        fastest = np.fmax(fastest, np.where(np.isfinite(rates), rates, 0.0))
    return np.asarray(np.median(fastest, axis=1) * period)


def _counts(policy: Policy, period: float, pairs: int) -> tuple[int, ...]:
    """Return how many cells there are along each axis, of the policy's own grid."""
    grid = cell_tree(policy).grid
    far = moved(policy, period)
    moves = far > 0
    wanted = FINE * policy.space.widths[moves] / far[moves]
    level = 0
    while True:
        counts, finer = grid.at(level).counts, grid.at(level + 1)
        enough = level >= grid.max_level and (np.array(counts)[moves] >= wanted).all()
        if enough or finer.cells * pairs > MOST_PAIRS or max(finer.counts) > MAX_COUNT:
            if level < grid.max_level and not policy.has_planes:
                many = (" x ".join(map(str, k)) for k in (counts, grid.counts))
                warn("cells that keep limits are {}, coarser than the policy's {}".format(*many))
            return counts
        level += 1
