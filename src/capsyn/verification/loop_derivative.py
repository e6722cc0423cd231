"""dV/dt along the closed loop, as a program: in plain arithmetic and in intervals.

Exogenous inputs w do not move: V may depend on them, and dV/dt is grad_x V(x, w) . f(x, u, w).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from capsyn.errors import ProblemError
from capsyn.modelling.discrete import refuse_map
from capsyn.modelling.transcription import user_program
from capsyn.policies.policy import Policy
from capsyn.programs.builder import ProgramBuilder
from capsyn.programs.ends import Interval
from capsyn.programs.expansion import Expansion, expand
from capsyn.programs.intervals import evaluate_intervals
from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Program
from capsyn.validation import describe

CHUNK = 4096
"""Boxes that are evaluated at once: their values stay in the cache."""
STATES, UNDEFINED = 1024, 0.1
"""Random states at which V is tried, and the share of them where it may be undefined."""
PAIRS, HALVINGS = 1024, 45
"""Pairs of random states between which a jump of V is looked for, and how closely."""
JUMP = 1e-5
"""Least jump of V, relative to its greatest value, that is taken for one."""
JUMPS = {"floor", "ceil", "sign", "copysign", "fmod", "remainder"}
"""Operations that jump: a V that uses them has no derivative along the loop."""


class LoopDerivative:
    """The derivative ``grad V . f`` of a function under every symbol of a policy, at readings.

    Raises
    ------
    ProblemError
        A policy without a model or with gaps, or a V that has no derivative along its dynamics.
    """

    def __init__(self, policy: Policy, V: Callable[..., Any]) -> None:
        if not isinstance(policy, Policy):
            raise ProblemError(f"`policy` must be a Policy; got {describe(policy)}")
        n, m, size = policy.domain.n, policy.alphabet.m, policy.space.n
        if policy.model is None:
            raise ProblemError(
                f"`policy` must have a model to follow; '{policy.name}' was made without one"
            )
        refuse_map(policy, "policy", "V has no time derivative")
        if policy.gaps:
            raise ProblemError(f"`policy` must have no gaps; '{policy.name}' has some")
        if not callable(V):
            raise ProblemError(f"`V` must be a function; got {describe(V)}")
        ports = (("x", size),), (("value", 1), ("gradient", size))
        program = user_program("V", V, *ports, told=size - n)
        _check(program, policy)
        builder = ProgramBuilder()
        x, u = ([builder.input() for _ in range(count)] for count in (size, m))
        value, *gradient = builder.call(program, x)[: 1 + n]
        xdot = builder.call(policy.model.dynamics, x, u)[:n]
        derivative = builder.constant(0.0)
        for slope, speed in zip(gradient, xdot):
            derivative = builder.apply("add", derivative, builder.apply("mul", slope, speed))
        inputs = (("x", size), ("u", m))
        # a factor 0 hides what is undefined, so everything that must be defined is an output
        self._program = builder.build(
            "derivative",
            inputs,
            (("derivative", 1), ("others", 1 + 2 * n)),
            [derivative, value, *gradient, *xdot],
        )
        self._expansion: Expansion = expand(
            builder.build("derivative", inputs, (("derivative", 1),), [derivative])
        )
        self._controls = policy.controls

    def values(self, states: np.ndarray, symbols: np.ndarray) -> np.ndarray:
        """Return dV/dt (B,) at readings (B, n) under symbols (B,), NaN where it is undefined.

        Symbols are indices; -1, as well as their number, is the default control.
        """
        derivative, others = self._program.evaluate(states.T, self._controls[symbols].T)
        return np.where(np.isfinite(others).all(axis=0), derivative[0], np.nan)

    def bounds(self, lower: np.ndarray, upper: np.ndarray, symbols: np.ndarray) -> Interval:
        """Return bounds (B,) of dV/dt over boxes with corners (n, B), under symbols (B,).

        At a kink of V they hold for the gradients on either side and all between. Both are NaN
        where dV/dt, V or the dynamics may be undefined.
        """
        low, high = np.empty(len(symbols)), np.empty(len(symbols))
        for start in range(0, len(symbols), CHUNK):
            part = slice(start, start + CHUNK)
            low[part], high[part] = self._bounds(lower[:, part], upper[:, part], symbols[part])
        return low, high

    def _bounds(self, lower: np.ndarray, upper: np.ndarray, symbols: np.ndarray) -> Interval:
        control = self._controls[symbols].T
        inputs = (lower, upper), (control, control)
        (low, high), others = evaluate_intervals(self._program, *inputs)
        undefined = np.isnan(low[0]) | np.isnan(others[0]).any(axis=0)
        (closer,) = evaluate_intervals(
            self._expansion.program, *inputs, inexact=self._expansion.inexact
        )
        # the expanded form may be defined where the program is not, and the other way round
        return (
            np.where(undefined, np.nan, np.fmax(low[0], closer[0][0])),
            np.where(undefined, np.nan, np.fmin(high[0], closer[1][0])),
        )


def _check(program: Program, policy: Policy) -> None:
    """Raise `ProblemError` unless V has a derivative along the loop."""
    first = program.input_count
    value, *gradient = program.results[: 1 + policy.domain.n]
    needed = {value}
    for k, (name, *operands) in reversed(list(enumerate(program.instructions, first))):
        if k not in needed or name == "const":
            continue
        if name in JUMPS or OPERATIONS[name].boolean:
            raise ProblemError(
                f"`V` must be continuous; its operation '{name}' jumps (fabs, fmin, fmax and "
                "if_else are allowed)"
            )
        needed.update(operands[1:] if name == "select" else operands)
    if all(k >= first and program.instructions[k - first] == ("const", 0.0) for k in gradient):
        raise ProblemError("`V` must depend on the state; its gradient is 0 everywhere")
    states = policy.space.sample(STATES)
    rows = np.concatenate(program.evaluate(states.T))[: 1 + policy.domain.n]
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=0))
    if len(bad) > UNDEFINED * len(states):
        state = ", ".join(f"{v:g}" for v in states[bad[0]])
        raise ProblemError(
            f"`V` must have a finite value and gradient inside the domain; at ({state}) and "
            f"{len(bad) / len(states):.0%} of random states it has none"
        )
    _check_continuity(program, policy)


def _check_continuity(program: Program, policy: Policy) -> None:
    """Raise `ProblemError` where V jumps: between random states, or at the seam of an angle.

    Exogenous inputs are the same for two states, as along a loop: between values of theirs V may
    jump. Halving the way between two states, towards the greater change of V, ends at a jump if
    there is one on the way.
    """
    domain, n = policy.space, policy.domain.n

    def value(states: np.ndarray) -> np.ndarray:
        return program.evaluate(states.T)[0][0]

    start, end = domain.sample(PAIRS, [1]), domain.sample(PAIRS, [2])
    end[:, n:] = start[:, n:]
    first, last = value(start), value(end)
    values = np.abs(np.concatenate([first, last]))
    usual = values[np.isfinite(values)].max(initial=0.0)
    for _ in range(HALVINGS):
        middle = (start + end) / 2
        between = value(middle)
        near = (np.abs(between - first) >= np.abs(last - between))[:, None]
        start, end = np.where(near, start, middle), np.where(near, middle, end)
        first, last = value(start), value(end)
    jump = np.abs(last - first)
    for axis in np.flatnonzero(domain.periodic[:n]):
        seam = domain.sample(PAIRS, [3])
        low, high = seam.copy(), seam.copy()
        low[:, axis], high[:, axis] = domain.lower[axis], domain.upper[axis]
        start, jump = np.vstack([start, low]), np.append(jump, np.abs(value(low) - value(high)))
    worst = int(np.argmax(np.where(np.isfinite(jump), jump, 0.0)))
    if jump[worst] > JUMP * usual:
        state = ", ".join(f"{v:g}" for v in start[worst])
        raise ProblemError(f"`V` must be continuous; it jumps by {jump[worst]:.3g} at ({state})")
