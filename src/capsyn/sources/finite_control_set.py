"""Finite-control-set model predictive control: the best of all short sequences of symbols [1]_.

References
----------
.. [1] S. Kouro, P. Cortes, R. Vargas, U. Ammann and J. Rodriguez, Model predictive control - a
   simple and powerful method to control power converters, IEEE Transactions on Industrial
   Electronics 56(6), 2009.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.masks import cheapest, empty, holds, masks_of_members, preferred, word_count
from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.modelling.problem import Problem
from capsyn.modelling.switching import Switching
from capsyn.modelling.transcription import transcribe
from capsyn.native.compiled import compiled
from capsyn.policies.policy import Policy
from capsyn.programs.model import Model
from capsyn.programs.program import Program
from capsyn.sources.delayed import delayed
from capsyn.sources.sequence_costs import BATCH, FiniteControlSetKernel, Moves, NumpyCosts
from capsyn.validation import BACKENDS, describe, finite_number, one_of, whole_number, whole_numbers

MOST_SEQUENCES = 1_000_000
"""Most sequences of symbols that are tried at a state."""
MOST_DEPTH = 200
"""Most moves of a sequence, which only a single symbol comes near."""
SAMPLES = 2048
"""Random states at which a price that is a share is made a number."""

MOST_STEPS = 1_000_000
"""Most integration steps of a sequence that a policy's file says it was made with."""
MADE, NAMES = "finite_control_set", ("depth", "sample_time", "blocks", "steps", "control_weight")
"""How the statistics of a policy call the control that made it, and what they say of that."""

Costs = Callable[[np.ndarray], np.ndarray]
"""``states (B, n) -> costs (B, N)``, safe to call from threads."""


@dataclass(frozen=True, eq=False)
class FiniteControlSet:
    """Finite-control-set predictive control for batches of states.

    A call with states (B, n) returns symbols (B,), as `capsyn.subdivide` and others need it.
    `finite_control_set` makes it.

    Parameters
    ----------
    solver : callable
        The function that computes the costs.
    backend : "c" or "numpy"
        Whether the solver is compiled or in NumPy.
    states, symbols : int
        Numbers of states n and of symbols N.
    threads : int
        Number of threads that solve. The result does not depend on it.
    problem : Problem or Policy
        The problem, with numbers in place of prices that are shares; or the policy that it made.
    spread : float
        The price that stands for 100 % [cost / time unit].
    start : two programs
        Dynamics and running cost, which must be finite where a prediction starts.
    prices : (N + 1, N), optional
        Cost of a change from each label in force (the default last) to each symbol [cost]; infinite
        if the change is forbidden. None: nothing depends on the symbol in force.
    made : dict
        `depth`, `sample_time`, `blocks`, `steps` and `control_weight` of `finite_control_set`.
    """

    solver: Costs
    backend: str
    states: int
    symbols: int
    threads: int
    problem: Problem | Policy
    spread: float
    start: tuple[Program, Program]
    prices: np.ndarray | None
    made: Mapping[str, Any]

    @property
    def in_force(self) -> int:
        """Number of labels in force that `masks` tells apart: 1, or N + 1, the default last."""
        return 1 if self.prices is None else len(self.prices)

    def costs(self, states: np.ndarray) -> np.ndarray:
        """Return the least costs (B, N) of the sequences from states (B, n), by first symbol.

        A cost is infinite if no sequence has a finite cost, or if the model is not finite at the
        state under the first symbol. The costs leave out the price of the first symbol, which
        depends on the symbol in force. The costs also leave out the delay.

        Raises
        ------
        ProblemError
            States of another shape.
        """
        states = self._checked(states)
        size = max(BATCH, -(-len(states) // self.threads))
        parts = [states[k : k + size] for k in range(0, max(len(states), 1), size)]
        with ThreadPoolExecutor(self.threads) as pool:
            run = map if len(parts) < 2 else pool.map
            costs = np.concatenate(list(run(self.solver, parts)))
        dynamics, cost = self.start
        with np.errstate(all="ignore"):
            costs[~np.isfinite(cost.evaluate(states.T)[0][0])] = np.inf
            for k, u in enumerate(self.problem.alphabet.values):
                rates = dynamics.evaluate(states.T, u)[0]
                costs[~np.isfinite(rates).all(axis=0), k] = np.inf
        return costs

    def masks(self, states: np.ndarray) -> np.ndarray:
        """Return the symbols whose cost ties with the least, as bit masks (B, W), for `states`.

        A mask is 0 if no sequence has a finite cost. Costs tie if they are within a billionth of
        the least cost, relative to its size. If the problem has switching or a delay, there is a
        mask for each label in force, (B, N + 1, W).
        """
        if self.prices is None:
            return self._tied(self.costs(states))
        return self._after_delay(self._checked(states))

    @functools.cached_property
    def _after_delay(self) -> Callable[[np.ndarray], np.ndarray]:
        """``states (B, n) -> masks (B, N + 1, W)`` of where they are when a decision acts."""
        if not self.problem.delay:
            return lambda states: self._next(states, np.arange(self.in_force))
        return delayed(self._next, self.problem)

    def _next(self, states: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """Return the masks (B, J, W) of states (B, n) for J labels in force."""
        assert self.prices is not None
        costs = self.costs(states)
        return np.stack([self._tied(costs + self.prices[j]) for j in labels], axis=1)

    def _tied(self, costs: np.ndarray) -> np.ndarray:
        """Return the masks (B, W) of the costs (B, N) that tie with the least."""
        return masks_of_members(cheapest(costs), word_count(self.symbols + 1))

    def __call__(self, states: np.ndarray, current: Any = -1) -> np.ndarray:
        """Return the first symbol (B,) of the best sequence from states (B, n).

        Of tied symbols, the symbol in force is returned, or else the lowest. -1 is returned if no
        sequence has a finite cost. `current` are the symbols in force, one or (B,); -1 is the
        default control.

        Raises
        ------
        ProblemError
            States of another shape, or symbols in force that are none.
        """
        masks, now = self.masks(states), self._in_force(current, len(states))
        if self.prices is not None:
            masks = masks[np.arange(len(masks)), now]
        best = np.where(empty(masks), -1, preferred(masks, range(self.symbols)))
        stays = holds(masks, now) & (self.prices is not None)
        return np.where(stays, now, best)

    def _in_force(self, current: Any, count: int) -> np.ndarray:
        """Return the labels (B,) of symbols in force, checked."""
        labels = np.asarray(current)
        fits = labels.shape in ((), (count,)) and labels.dtype.kind in "iu"
        if not fits or (labels < -1).any() or (labels > self.symbols).any():
            raise ProblemError(
                f"`current` must be symbols, -1 to {self.symbols - 1}, one or {count}; got "
                f"{describe(current)}"
            )
        return np.broadcast_to(np.where(labels < 0, self.symbols, labels), (count,))

    def _checked(self, states: np.ndarray) -> np.ndarray:
        states = np.ascontiguousarray(states, dtype=float)
        if states.ndim != 2 or states.shape[1] != self.states:
            raise ProblemError(f"`states` must be of shape (B, {self.states}); got {states.shape}")
        return states

    def switching_for(self, problem: Problem) -> Switching | None:
        """Return the switching of a problem, with numbers for prices.

        Raises
        ------
        ProblemError
            `problem` has other prices, forbidden transitions or delay than the problem of this
            controller.
        """
        switching = problem.switching
        if switching is not None and switching.has_share:
            switching = switching.with_spread(self.spread)
        own = self.problem
        prices = [_prices(p, 1.0) for p in (problem.replace(switching=switching), own)]
        told = [None if table is None else table.tolist() for table in prices]
        if told[0] != told[1] or problem.delay != own.delay:
            raise ProblemError(
                "`problem` must have the prices, forbidden transitions and delay that its "
                "predictive control was made with; got others"
            )
        return switching


def finite_control_set(
    problem: Problem,
    depth: int,
    *,
    sample_time: float | None = None,
    blocks: Any = 1,
    steps: int = 1,
    control_weight: Any = None,
    tail: Any = None,
    backend: str = "auto",
    threads: int | None = None,
) -> FiniteControlSet:
    """Return finite-control-set predictive control of a problem.

    At a state, the controller tries all sequences of `depth` symbols. Each symbol is held for its
    block of samples. A sequence costs the problem's running cost along the prediction, plus the
    effort ``u^T R u`` times the time that each symbol is held, plus the problem's terminal cost at
    the end. For a discrete-time problem, running costs and efforts are summed over samples. The
    problem's own horizon is not used.

    Parameters
    ----------
    problem : Problem
        The problem: its system, costs and alphabet.
    depth : int
        Number of moves of a sequence, 1 to `MOST_DEPTH`.
    sample_time : float, optional
        Time of a sample [time unit of the problem]. Default: that of the problem's settings, or of
        its map if it is in discrete time.
    blocks : int or (depth,) ints
        Number of samples for which each move is held (move blocking).
    steps : int
        Runge-Kutta steps per sample; 1 of a discrete-time problem.
    control_weight : float or (m, m), optional
        Weight R of the effort [cost / (input unit^2 time unit)]. Default: the weight of the
        problem's settings.
    tail : optional
        A terminal cost in place of the problem's own; see `Problem`. With a tail, a depth of 1 or 2
        may do what long sequences do without a tail.
    backend : "auto", "c" or "numpy"
        How to solve: compiled if there is a compiler ("auto"), or as told.
    threads : int, optional
        Number of threads. Default: one per processor.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or more than `MOST_SEQUENCES` sequences.
    KernelBuildError
        ``backend="c"`` without a working compiler.
    """
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a capsyn.Problem; got {describe(problem)}")
    if tail is not None:
        problem = problem.replace(tail=tail)
    given = {"sample_time": sample_time, "blocks": blocks, "steps": steps}
    known = {"control_weight": control_weight, "backend": backend, "threads": threads}
    return _made(problem, transcribe(problem), depth, **given, **known)


def source_of(policy: Policy, backend: str = "auto") -> FiniteControlSet | None:
    """Return the predictive control that a policy was made from, by what it says of itself.

    None: it was not, or has no model any more.

    Raises
    ------
    ProblemError
        What it says makes no sense.
    """
    made = policy.statistics.get("source", {}).get(MADE)
    if made is None or policy.model is None or policy.settings is None:
        return None
    if not isinstance(made, dict) or set(made) != set(NAMES):
        raise ProblemError(f"the source of a policy must say {', '.join(NAMES)}; got {made}")
    control = _made(policy, policy.model, **made, backend=backend, threads=None)
    solver: Any = control.solver
    if (count := int(solver.moves.steps.sum())) > MOST_STEPS:
        raise ProblemError(f"the source of a policy must take few steps; got {count:,}")
    return control


def _made(
    problem: Problem | Policy,
    model: Model,
    depth: int,
    sample_time: float | None,
    blocks: Any,
    steps: int,
    control_weight: Any,
    backend: str,
    threads: int | None,
) -> FiniteControlSet:
    """Return predictive control of a problem, or of a policy made from one, and its model."""
    assert problem.settings is not None
    values = problem.alphabet.values
    count = len(values)
    depth = whole_number("depth", depth, least=1, most=MOST_DEPTH)
    if count**depth > MOST_SEQUENCES:
        raise ProblemError(
            f"`depth` must give at most {MOST_SEQUENCES:,} sequences; got {depth}, {count}^{depth} "
            "of them: hold moves longer with `blocks`"
        )
    steps = whole_number("steps", steps, least=1, most=1_000_000)
    period = _period(problem, sample_time, steps)
    held = np.array(whole_numbers("blocks", blocks, depth, least=1, most=1_000_000))
    settings = problem.settings
    if control_weight is not None:
        settings = dataclasses.replace(settings, control_weight=control_weight)
    efforts = settings.efforts(values)
    one_of("backend", backend, BACKENDS)
    end = model.terminal_cost.first
    none = np.zeros((count, count))
    moves = Moves(values, efforts, np.full(depth, period / steps), held * steps, none)
    made = {
        "depth": depth,
        "sample_time": settings.period if problem.discrete else period,
        "blocks": held.tolist(),
        "steps": steps,
        "control_weight": settings.control_weight,
    }
    kernel = compiled(
        lambda: FiniteControlSetKernel.build(model.step, end, moves), backend, "predicting"
    )
    solver = kernel or NumpyCosts(model.step, end, moves)
    control = FiniteControlSet(
        solver, "c" if kernel else "numpy", problem.space.n, count, processors(threads), problem,
        0.0, (model.dynamics, model.running_cost), None, made,
    )  # fmt: skip
    return _priced(control, period)


def _period(problem: Problem | Policy, sample_time: float | None, steps: int) -> float:
    """Return the time over which costs per time unit count for a sample: 1, of a map."""
    assert problem.settings is not None
    own = problem.settings.period
    if not problem.discrete:
        return finite_number("sample_time", own if sample_time is None else sample_time, above=0.0)
    if sample_time not in (None, own):
        raise ProblemError(
            f"`sample_time` must be left out, or be {own:g}, that of the problem's map; got "
            + describe(sample_time)
        )
    if steps != 1:
        raise ProblemError(f"`steps` must be 1 for a map, which is iterated; got {steps}")
    return 1.0


def _priced(control: FiniteControlSet, period: float) -> FiniteControlSet:
    """Return predictive control that pays for switching as its problem says, of one that does not.

    `period` is that of `_period`.
    """
    problem, spread = control.problem, 0.0
    switching = problem.switching
    if switching is not None and switching.has_share and isinstance(problem, Problem):
        ranges = np.ptp(control.costs(problem.space.sample(SAMPLES, 0)), axis=1)
        ranges = ranges[np.isfinite(ranges)]
        spread = float(np.median(ranges)) / period if ranges.size else 0.0
        problem = problem.replace(switching=switching.with_spread(spread))
    prices = _prices(problem, period)
    if prices is None:
        return control
    solver: Any = control.solver
    moves = dataclasses.replace(solver.moves, prices=prices[:-1])
    solver = dataclasses.replace(solver, moves=moves)
    return dataclasses.replace(
        control, solver=solver, problem=problem, spread=spread, prices=prices
    )


def _prices(problem: Problem | Policy, period: float) -> np.ndarray | None:
    """Return what going from each label to each symbol costs, (N + 1, N), paid over a period.

    None: nothing depends on what is in force.
    """
    alphabet, switching = problem.alphabet, problem.switching
    if switching is None:
        return np.zeros((len(alphabet) + 1, len(alphabet))) if problem.delay else None
    return switching.prices(alphabet, problem.default_control)[:, :-1] * period
