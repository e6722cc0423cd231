"""The sampled loop that a proof is about: plant, labels, and what is not known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsyn.compression.trees import exact_tree
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.modelling.targets import Target, target_program
from capsyn.modelling.transcription import slopes_program
from capsyn.policies.policy import DecisionTree, Policy
from capsyn.programs.continuity import jump_conditions
from capsyn.programs.program import Program
from capsyn.reach.half_spaces import HalfSpaces, half_spaces
from capsyn.simulation.closed_loop import SLACK, Holds
from capsyn.simulation.plant import Plant

LOST = -1
"""The label of a gap: a state there has none."""


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A policy that is asked at samples, and its plant; labels are symbols, the default last."""

    space: Box  # states, and after them exogenous inputs, which stay
    moving: int  # how many are states
    rates: Program  # (x, u[, p]) -> xdot
    slopes: Program  # the Jacobian of the rates in x, by rows
    breaks: Program  # conditions that are constant where the rates do not jump
    target: Program  # x -> inside
    avoid: Program  # x -> inside
    tree: HalfSpaces
    next: np.ndarray  # (R, L): label of each row after each label in force, or `LOST`
    controls: np.ndarray  # (L, m) [input units]
    holds: np.ndarray  # (L,): samples that a label is held once it is entered
    kinds: np.ndarray  # (L,): equal where a change is no switch
    parameters: np.ndarray  # (2, P): least and greatest
    noise: np.ndarray  # (n,): largest error of a measurement [state units]
    period: float  # between samples [time unit]
    delay: float  # [time unit], at most a period
    nearest: bool  # whether a state beyond the domain has the label of the nearest cell

    @property
    def labels(self) -> int:
        """Symbols and the default."""
        return len(self.controls)

    @property
    def layered(self) -> bool:
        """Whether what comes depends on the label in force."""
        constant = (self.next == self.next[:, :1]).all()
        return not constant or self.delay > 0 or bool((self.holds > 1).any())

    @property
    def layers(self) -> int:
        """Labels in force that are told apart."""
        return self.labels if self.layered else 1

    @property
    def first(self) -> int:
        """The layer in which a loop begins: the default is in force."""
        return self.layers - 1

    def layer_of(self, held: np.ndarray) -> np.ndarray:
        """Return the layers of labels in force."""
        return held if self.layered else np.zeros_like(held)


def sampled_loop(
    policy: Policy,
    plant: Plant,
    holds: Holds,
    period: float,
    delay: float,
    *,
    target: Target,
    avoid: Target | None,
    noise: np.ndarray,
    parameters: np.ndarray,
) -> SampledLoop:
    """Return the loop of a policy and a plant.

    Raises
    ------
    ProblemError
        What a proof does not know: least times between changes of an input, a delay longer than a
        sample, affine leaves with prices.
    """
    if holds.inputs.any():
        raise ProblemError("`policy` holds its inputs one by one, which no proof knows")
    if delay > period * (1 + SLACK):
        raise ProblemError(
            f"`delay` must be at most one sample, {period:g} {plant.time_unit}; got {delay:g}"
        )
    tree = policy if isinstance(policy, DecisionTree) else exact_tree(policy)
    at_once = policy.outside_at_once and bool((holds.symbols > 1).any())  # no hold is kept there
    rows = tree.transitions.astype(np.int32)
    now = np.arange(rows.shape[1])
    rows = np.where(holds.forbidden[now, rows], now, rows).astype(np.int32)
    if policy.gaps:
        rows[rows == len(policy.alphabet)] = LOST
    return SampledLoop(
        plant.space,
        plant.states,
        plant.dynamics,
        slopes_program(plant.dynamics),
        jump_conditions(plant.dynamics),
        target_program(target, plant.space),
        target_program(avoid, plant.space),
        half_spaces(tree.cells, plant.space),
        rows,
        policy.controls,
        holds.symbols,
        holds.kinds,
        parameters,
        noise,
        period,
        min(delay, period),
        policy.outside == "nearest" and not tree.has_planes and not at_once,
    )
