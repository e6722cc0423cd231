"""The least cost of closed loops with an alphabet, by dynamic programming on a grid."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.execution.memory import available_memory
from capsyn.execution.memory import memory as amount_of
from capsyn.execution.processors import processors
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.targets import check_initial, placed
from capsyn.optima.comparison import OptimumComparison, compared
from capsyn.optima.grid import USUAL, StateGrid
from capsyn.optima.iteration import reached, solved, wider_grid
from capsyn.optima.loops import Lookahead
from capsyn.optima.task import Task, task_of
from capsyn.policies.policy import Policy
from capsyn.sources.callables import problem_policy
from capsyn.validation import (
    BACKENDS,
    describe,
    finite_array,
    finite_number,
    one_of,
    state_array,
    true_or_false,
    whole_number,
    whole_numbers,
)

COARSE = 0.1
"""Error of a grid that is too coarse for a bound."""
GROWTH = 4
"""How many times the memory a grid may take that is widened, before its intervals grow."""
MOST_SWEEPS = 1_000_000
"""Most samples of a loop."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """The least cost of closed loops, as `capsyn.optimum` finds it.

    Parameters
    ----------
    name : str
        Name of the problem.
    box : Box
        The box of the grid.
    counts : n ints
        Intervals along each axis.
    values : (R, nodes along each axis)
        Least cost to go from each node over the duration, less a sample. If the symbol in force
        matters, there is a row for each symbol in force, and for each further sample of its hold.
    objective : str
        The cost in words.
    duration, period : float
        Time of a loop, and time of a sample [time unit].
    sweeps : int
        Passes over the grid. There are fewer passes than samples if more passes would change
        nothing, or if one pass takes several samples.
    starts : (B, n)
        Initial states [state units].
    costs : (B,)
        Costs of the loops of the optimum's own policy from these states.
    switches : (B,)
        Changes of the symbol in these loops.
    left : int
        Number of loops that left the box, however often it was widened.
    memory : int
        Memory that the optimum took [bytes].
    seconds : float
        Time that the optimum took [s].
    lookahead : Lookahead
        The function that finds the best symbol of a state.
    """

    name: str
    box: Box
    counts: tuple[int, ...]
    values: np.ndarray
    objective: str
    duration: float
    period: float
    sweeps: int
    starts: np.ndarray
    costs: np.ndarray
    switches: np.ndarray
    left: int
    memory: int
    seconds: float
    lookahead: Lookahead = dataclasses.field(repr=False)

    @property
    def bound(self) -> bool:
        """Whether the grid holds all states that its loops reach, with an error below a tenth.

        Otherwise the cost of the loops is no bound.
        """
        return self.left == 0 and abs(self.grid_error) < COARSE

    @property
    def mean(self) -> float:
        """Mean of `costs`."""
        return float(self.costs.mean())

    @property
    def grid_error(self) -> float:
        """The grid's error: the values at the starts over the costs of the loops, less 1."""
        return float(self.cost(self.starts).mean() / self.mean - 1) if self.mean else 0.0

    def cost(self, states: Any, current: Any = -1) -> Any:
        """Return the least cost (...) of loops from states (..., n), from the values of the grid.

        `current` are the symbols in force, one or (...); -1 is the default control.

        Raises
        ------
        ProblemError
            States of another shape.
        """
        flat, shape, now = self._asked(states, current)
        costs = self.lookahead.options(flat, now).min(axis=1, initial=np.inf)
        return costs.reshape(shape)[()]

    def symbols(self, states: Any, current: Any = -1) -> Any:
        """Return the best symbols (...) at states (..., n): the optimum's own policy.

        `current` is that of `cost`. If symbols tie, the symbol in force stays, or else the lowest
        wins.

        Raises
        ------
        ProblemError
            States of another shape.
        """
        flat, shape, now = self._asked(states, current)
        return self.lookahead.choose(flat, now).reshape(shape)[()]

    def control(self, time: float, states: Any) -> np.ndarray:
        """Return the controls (B, m) at states (B, n), as a controller for `capsyn.simulate`.

        The `time` does not change the result.

        Raises
        ------
        ProblemError
            States of another shape. Or prices or least times make the symbol in force matter.
        """
        if self.lookahead.task.remembers:
            raise ProblemError(
                "`control` must not depend on the symbol in force, as it does with prices and "
                "least times: take `policy`"
            )
        return self.lookahead.task.alphabet.values[self.symbols(states)]

    def policy(self, problem: Any, **options: Any) -> Policy:
        """Return a policy of cells with the best symbols of the optimum; see `problem_policy`.

        Parameters
        ----------
        problem : Problem
            The problem of the optimum.
        options
            Options of `capsyn.subdivide`.

        Raises
        ------
        ProblemError
            The problem has exogenous inputs, which an optimum fixes. Or `problem_policy` refuses
            it.
        """
        task = self.lookahead.task
        if getattr(problem, "exogenous", None) is not None:
            raise ProblemError("`problem` must have no exogenous inputs: they are fixed here")
        if not task.remembers:
            return problem_policy(self.symbols, problem, **options)
        labels = np.arange(len(task.alphabet) + 1)
        labels[-1] = -1

        def label(states: np.ndarray) -> np.ndarray:
            return np.stack([self.symbols(states, label) for label in labels], axis=1)

        switching = problem.switching
        if switching is not None and switching.has_share:
            problem = problem.replace(switching=task.switching)
        return problem_policy(label, problem, in_force=True, **options)

    def compare(self, controller: Any, **options: Any) -> OptimumComparison:
        """Return the costs of a controller's closed loops beside the optimum's, from equal starts.

        Parameters
        ----------
        controller : Policy or callable ``(time, states (B, n)) -> controls (B, m)``
            The controller to compare. The controller is told the same exogenous inputs as the
            optimum.
        options
            Options ``outside``, ``backend`` and ``threads`` of `capsyn.simulate`, and the
            ``confidence`` of the interval (0.95 by default).

        Raises
        ------
        ProblemError
            The controller does not fit the system.
        """
        return compared(self, controller, **options)

    def to_json(self) -> dict[str, Any]:
        """Return the optimum as plain data, without its values."""
        return {
            "name": self.name,
            "objective": self.objective,
            "lower": self.box.lower.tolist(),
            "upper": self.box.upper.tolist(),
            "counts": list(self.counts),
            "duration": self.duration,
            "period": self.period,
            "sweeps": self.sweeps,
            "starts": len(self.starts),
            "mean": self.mean if np.isfinite(self.mean) else None,
            "switches": float(self.switches.mean()),
            "grid_error": self.grid_error if np.isfinite(self.grid_error) else None,
            "left": self.left,
            "bound": self.bound,
            "memory": self.memory,
            "seconds": self.seconds,
        }

    def _asked(self, states: Any, current: Any) -> tuple[np.ndarray, tuple[int, ...], np.ndarray]:
        states = state_array(states, self.box.n)
        shape, count = states.shape[:-1], len(self.lookahead.task.alphabet)
        now = np.asarray(current)
        good = now.dtype.kind in "iu" and ((now >= -1) & (now < count)).all()
        if not good or (now.ndim and now.shape != shape):
            raise ProblemError(
                f"`current` must be symbols from -1 to {count - 1}, one or {shape}; "
                f"got {describe(current)}"
            )
        return states.reshape(-1, self.box.n), shape, np.broadcast_to(now, shape).reshape(-1)


def optimum(
    problem: Any,
    duration: float,
    *,
    rate: float | None = None,
    counts: Any = None,
    box: Box | None = None,
    starts: Any = 400,
    initial: Box | Ball | None = None,
    seed: int = 0,
    exogenous: Any = None,
    control_weight: Any = 0.0,
    stop_at_target: bool = False,
    widen: int = 4,
    memory: Any = None,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Optimum:
    """Return the least cost of closed loops with the symbols, by dynamic programming on a grid.

    At every sample, the optimum takes the symbol of least total cost, and holds it for the sample.
    The optimum thus does what the best controller would do that knows the state at this rate. A
    loop costs its running cost, or its terminal cost over time if there is no running cost. Each
    change of symbol costs its price times a sample. Least times and forbidden transitions are kept.
    Values between nodes are interpolated linearly, with a correction for the curvature along each
    axis. The values are therefore approximate, so comparisons use the costs of loops of the
    optimum's own policy.

    Parameters
    ----------
    problem : Problem, or Policy with a model
        The system, its costs and its symbols, with at most four states.
    duration : float
        Time of a loop [time unit].
    rate : float, optional
        Samples per time unit. Default: 1 over the ``sample_time`` of the settings.
    counts : int or n ints, optional
        Intervals of the grid along each axis. Default: 2000, 400, 100 or 40 for 1 to 4 states.
    box : Box, optional
        The box of the grid at the beginning. Default: the domain.
    starts : int or (B, n)
        Initial states, or the number of initial states to draw.
    initial : Box or Ball, optional
        The set from which initial states, or the states that it names, are drawn. Default: the
        domain.
    seed : int
        Seed of the initial states.
    exogenous : (k,), or mapping of name to number, optional
        Exogenous inputs, constant along all loops. Exogenous inputs must be given if the problem
        has some.
    control_weight : float or (m, m)
        Weight R of an effort ``u^T R u`` that is added to the cost.
    stop_at_target : bool
        Whether a loop ends in the target and costs no more from then on.
    widen : int
        How often the box may be widened if loops leave it. The intervals keep their size until the
        grid takes four times the memory.
    memory : int or text, optional
        Most memory that the grid may take, as ``"2GB"``. Default: half of the available memory.
    backend : "auto", "c" or "numpy"
        How to compute: compiled if there is a compiler ("auto"), or as told.
    threads : int, optional
        Number of threads. Default: one per processor. The result does not depend on it.
    progress : callable, optional
        A function that is called before the work with a text about the work and its memory.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or a grid that does not fit the memory. The message then
        names a grid that fits.
    KernelBuildError
        ``backend="c"`` without a working compiler.
    """
    began = time.perf_counter()
    one_of("backend", backend, BACKENDS)
    true_or_false("stop_at_target", stop_at_target)
    task = task_of(problem, rate, exogenous, control_weight, stop_at_target)
    samples = _samples(duration, task.period)
    grid = _grid(task, box, counts)
    states = _starts(task, starts, initial, whole_number("seed", seed, least=0))
    limit = available_memory() // 2 if memory is None else amount_of("memory", memory)
    grid.check(len(task.alphabet), task.rows, limit)
    widen, threads = whole_number("widen", widen, least=0), processors(threads)
    limit = min(limit, GROWTH * grid.bytes(len(task.alphabet), task.rows))
    grid, widened = reached(task, grid, states, samples, widen, limit, backend, threads)
    for again in range(widened, widen + 1):
        if progress is not None:
            progress(_plan(task, grid, samples))
        lookahead, sweeps = solved(task, grid, samples, backend, threads)
        loops = lookahead.run(states, samples, threads)
        wider = wider_grid(task, grid, loops, limit)
        if wider is None or again == widen:
            break
        grid = wider
    nodes = lookahead.values[:, : grid.nodes].reshape(-1, *grid.shape)
    return Optimum(
        task.name, grid.box, grid.counts, nodes, task.objective, samples * task.period,
        task.period, sweeps, states, loops.costs, loops.switches, int(loops.left.sum()),
        grid.bytes(len(task.alphabet), task.rows), time.perf_counter() - began, lookahead,
    )  # fmt: skip


def _samples(duration: Any, period: float) -> int:
    samples = finite_number("duration", duration, above=0.0) / period
    if not 0.5 < samples <= MOST_SWEEPS:
        raise ProblemError(
            f"`duration` times `rate` must be 1 to {MOST_SWEEPS:,} samples; got {samples:g}"
        )
    return round(samples)


def _grid(task: Task, box: Box | None, counts: Any) -> StateGrid:
    domain = task.domain
    if box is None:
        box = domain
    elif not isinstance(box, Box) or (box.n, box.periodic) != (domain.n, domain.periodic):
        raise ProblemError(
            f"`box` must be a capsyn.Box of {domain.n} states, periodic where the domain is; "
            f"got {describe(box)}"
        )
    counts = USUAL[domain.n] if counts is None else counts
    return StateGrid(box, whole_numbers("counts", counts, domain.n, least=2, most=10_000_000))


def _starts(task: Task, starts: Any, initial: Box | Ball | None, seed: int) -> np.ndarray:
    n = task.domain.n
    if np.ndim(starts) == 2 and initial is None:
        states = finite_array("starts", starts, 2)
        if states.shape[1] != n or not len(states):
            raise ProblemError(f"`starts` must have shape (B, {n}); got {states.shape}")
        return states
    check_initial(initial, task.domain)
    states = task.domain.sample(whole_number("starts", starts, least=1), [seed, 7])
    return placed(states, initial, task.domain, [seed, 7])


def _plan(task: Task, grid: StateGrid, samples: int) -> str:
    size = grid.bytes(len(task.alphabet), task.rows)
    return (
        f"{grid.text()} intervals, {len(task.alphabet)} symbols: {size / 1e6:,.3g} MB, at most "
        f"{samples:,} sweeps"
    )
