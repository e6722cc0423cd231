"""Agreement: where a policy gives another symbol than the controller that it came from.

Algorithm 1 looks only at test points. Random states show what lies between test points. They show
how well cells follow a switching surface. They also show islands, which all test points of a cell
missed.

If the symbol in force matters, each state is compared with each symbol in force. Then J = N + 1,
with the default control, and otherwise J is 1. If a policy is told exogenous inputs, states in this
module are readings: states and exogenous inputs, drawn independently.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.masks import Label, checked_masks, masks_of_symbols
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.execution.processors import processors
from capsyn.modelling.exogenous import exogenous_text
from capsyn.modelling.settings import MAX_STEPS
from capsyn.policies.policy import Policy
from capsyn.sources.finite_control_set import source_of
from capsyn.statistics import TOLD, check_confidence, clopper_pearson
from capsyn.validation import BACKENDS, describe, one_of, whole_number
from capsyn.verification.tally import Island, Rule, Tally

CHUNK = 8192
"""States that are compared at once, with one symbol in force each."""
FEWEST = 64
"""Of several symbols in force there are fewer, but so many at least."""
WAVE = 32
"""Chunks of `CHUNK` states that are in memory at once."""

Controller = Callable[[np.ndarray], Any]
"""States (B, n) to symbols (B,); -1 is the default control."""


@dataclass(frozen=True, eq=False)
class Agreement:
    """How often a policy of N symbols gives the symbol of its controller at random states.

    If the symbol in force matters, `states` and `agreeing` are means over the symbols in force. All
    other counts are then of pairs of a state and a symbol in force.

    Parameters
    ----------
    symbols : N + 1 strings
        Names of the symbols, "default" last.
    seed : int
        Seed of the states, which are ``policy.space.sample(states, seed)``.
    states, agreeing : int
        Number of random states, and number of states at which the policy agrees, rounded down.
    confidence, low, high : float
        Clopper-Pearson interval of the share that agrees. For a mean over symbols in force, the
        interval is on the safe side, because it counts each state once.
    ties : int
        Number of states at which several symbols could be best. Each of these symbols agrees.
    not_finite : int
        Number of states at which the controller has no finite result. Only the default control
        agrees there.
    level_states, level_agreeing : (depth + 1,)
        Number of states in cells of each level, and how many of them agree. A decision tree has one
        level.
    mixed_states, mixed_agreeing : int
        Number of states in cells whose test points did not agree, and how many of these states
        agree. The other states lie in uniform cells. The leaves of a decision tree count as mixed.
    pairs : (N + 1, N + 1)
        Number of states by the policy's symbol (row) and the controller's symbol (column), the
        default last.
    disagreeing_states : (D, n)
        The first states that disagree [state units], at most `KEPT`.
    disagreeing_symbols : (D, 2)
        The policy's and the controller's symbol at each of these states; -1 is the default control.
    island_cells, island_states : int
        Number of uniform cells with disagreeing states, and number of these states.
    islands : tuple of Island
        The uniform cells with disagreeing states, at most `KEPT`, the cell with most such states
        first.
    in_force_agreeing : (J,), optional
        Number of states that agree for each symbol in force, the default last.
    disagreeing_in_force : (D,), optional
        The symbols in force at the first pairs that disagree; -1 is the default control.
    exogenous : str
        Exogenous inputs that were drawn with the states, with their bounds, in words; empty if
        there are none.
    steps : int, optional
        Runge-Kutta steps of sSAC over the horizon, if they are not the policy's own.
    """

    symbols: tuple[str, ...]
    seed: int
    states: int
    agreeing: int
    confidence: float
    low: float
    high: float
    ties: int
    not_finite: int
    level_states: np.ndarray
    level_agreeing: np.ndarray
    mixed_states: int
    mixed_agreeing: int
    pairs: np.ndarray
    disagreeing_states: np.ndarray
    disagreeing_symbols: np.ndarray
    island_cells: int
    island_states: int
    islands: tuple[Island, ...]
    in_force_agreeing: np.ndarray | None = None
    disagreeing_in_force: np.ndarray | None = None
    exogenous: str = ""
    steps: int | None = None

    @property
    def share(self) -> float:
        """Share of the states at which the policy agrees, which estimates the share of the volume.

        If the symbol in force matters, this is the mean over the symbols in force.
        """
        if self.in_force_agreeing is None:
            return self.agreeing / self.states
        return float(self.in_force_agreeing.mean()) / self.states

    def __repr__(self) -> str:
        return (
            f"Agreement({self.agreeing} of {self.states} states, {self.low:.3%} to "
            f"{self.high:.3%}, {self.island_cells} islands)"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain data, with the first `TOLD` states and islands."""
        known = {k: v for k, v in vars(self).items() if v is not None}
        data = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in known.items()}
        told: dict[str, Any] = {
            "symbols": list(self.symbols),
            "share": self.share,
            "disagreeing_states": self.disagreeing_states[:TOLD].tolist(),
            "disagreeing_symbols": self.disagreeing_symbols[:TOLD].tolist(),
            "islands": [island.to_json() for island in self.islands[:TOLD]],
        }
        if self.in_force_agreeing is not None and self.disagreeing_in_force is not None:
            told["disagreeing_in_force"] = self.disagreeing_in_force[:TOLD].tolist()
            told["in_force"] = self._by_symbol(data.pop("in_force_agreeing"))
        if not self.exogenous:
            del data["exogenous"]
        return data | told

    def _by_symbol(self, agreeing: list[int]) -> list[dict[str, Any]]:
        """Return the share for each symbol in force, with its interval, as plain data."""
        rows = []
        for name, count in zip(self.symbols, agreeing, strict=True):
            low, high = clopper_pearson(count, self.states, self.confidence)
            row = {"symbol": name, "agreeing": count, "share": count / self.states}
            rows.append(row | {"low": low, "high": high})
        return rows


def agreement(
    policy: Policy,
    states: int = 100_000,
    *,
    controller: Controller | None = None,
    seed: int = 0,
    confidence: float = 0.95,
    steps: int | None = None,
    backend: str = "auto",
    threads: int | None = None,
) -> Agreement:
    """Return how often, and where, a policy gives the symbol of a controller at random states.

    Parameters
    ----------
    policy : Policy
        The policy.
    states : int
        Number of states, drawn uniformly from the policy's space (its domain and exogenous inputs).
    controller : callable, optional
        What the policy is compared with. A function takes states (B, n), or readings, and returns
        symbol indices (B,), -1 for the default, whatever symbol is in force. The controller may
        also be another policy, or a `FiniteControlSet`. Default: the `FiniteControlSet` that made
        the policy, if one did, else sSAC with the policy's own model, horizon, settings, prices and
        delay.
    seed : int
        Seed of the states.
    confidence : float
        Confidence of the interval of the share.
    steps : int, optional
        Runge-Kutta steps of sSAC over the horizon. More than the policy's own show what its own
        steps hide. Default: the policy's own.
    backend : "auto", "c" or "numpy"
        How sSAC is solved.
    threads : int, optional
        Threads that call the controller. Default: one per processor for sSAC, one for a given
        `controller`. The result does not depend on it.

    Raises
    ------
    ProblemError
        An argument that cannot be used. Or the policy carries no model, and no `controller` is
        given. Or the controller returns something else than symbols.
    KernelBuildError
        ``backend="c"`` without a working compiler.

    Notes
    -----
    If several symbols tie, the policy agrees if it gives one of them; see `BatchController.masks`.
    """
    if not isinstance(policy, Policy):
        raise ProblemError(f"`policy` must be a capsyn.Policy; got {describe(policy)}")
    states = whole_number("states", states, least=1)
    seed = whole_number("seed", seed, least=0)
    confidence = check_confidence(confidence)
    one_of("backend", backend, BACKENDS)
    controller = source_of(policy, backend) if controller is None else controller
    threads = 1 if threads is None and controller is not None else processors(threads)
    if steps is not None:
        steps = whole_number("steps", steps, least=1, most=MAX_STEPS)
        if controller is not None:
            raise ProblemError("`steps` are those of sSAC, for which no `controller` is given")
    rule = _rule(policy, controller, backend, steps)
    tally = Tally(policy, rule)
    with ThreadPoolExecutor(threads) as pool:
        run = map if threads == 1 else pool.map
        for wave in _waves(policy, states, seed, rule.in_force):
            for chunk, labels in zip(wave, run(rule.masks, wave)):
                tally.add(chunk, labels)
    agreeing = states * rule.in_force - tally.wrong
    low, _ = clopper_pearson(agreeing // rule.in_force, states, confidence)
    _, high = clopper_pearson(-(-agreeing // rule.in_force), states, confidence)
    return Agreement(
        symbols=(*policy.alphabet.names, "default"),
        seed=seed,
        states=states,
        agreeing=agreeing // rule.in_force,
        confidence=confidence,
        low=low,
        high=high,
        exogenous=exogenous_text(policy.exogenous),
        steps=steps,
        **tally.results(),
    )


def _rule(policy: Policy, controller: Controller | None, backend: str, steps: int | None) -> Rule:
    """Return what a policy is compared with; sSAC where no controller is given."""
    count = len(policy.alphabet) + 1
    if controller is None:
        if steps is not None and policy.settings is not None:
            settings = dataclasses.replace(policy.settings, steps=steps)
            policy = dataclasses.replace(policy, settings=settings)
        ssac = policy_controller(policy, backend)
        if ssac is None:
            raise ProblemError(
                "`policy` must carry its model, horizon and settings, or `controller` must be "
                f"given; got {policy!r} without them"
            )
        many = policy.remembers or ssac.in_force > 1
        return Rule(ssac.masks, ssac.preference, count if many else 1)
    if not callable(controller):
        raise ProblemError(f"`controller` must be a function; got {describe(controller)}")
    order = tuple(range(count))
    if isinstance(controller, Policy):
        controller = dataclasses.replace(controller, gaps=False)  # a gap is a label like others
        if controller.remembers:
            return Rule(_masks_in_turn(controller, count), order, count)
    own = masks_in_force(controller, count - 1)
    if own is not None:
        return Rule(own, order, count)
    masks = masks_of_symbols(controller, count - 1, "controller")
    return Rule(masks, order, count if policy.remembers else 1)


def masks_in_force(controller: Any, n_symbols: int) -> Label | None:
    """Return the masks (B, N + 1, W) that a controller has for each symbol in force, if it has.

    Those that do say for how many ``in_force`` they have ``masks``, as a `FiniteControlSet` does.
    """
    count = getattr(controller, "in_force", 1)
    if isinstance(controller, Policy) or not isinstance(count, int) or count == 1:
        return None
    return checked_masks(controller.masks, n_symbols, n_symbols + 1)


def _masks_in_turn(policy: Policy, count: int) -> Label:
    """Return the function of states (B, n) to masks (B, J, W) of what follows J labels in force."""
    if len(policy.alphabet) + 1 != count:
        raise ProblemError(
            f"`controller` must have {count - 1} symbols, as the policy has, where it depends on "
            f"the one in force; got {policy!r}"
        )
    labels = np.arange(count)

    def following(states: np.ndarray) -> np.ndarray:
        return np.stack([policy(states, current=label) for label in labels], axis=1)

    return masks_of_symbols(following, count - 1, "controller", count)


def _waves(policy: Policy, count: int, seed: int, in_force: int) -> Iterator[list[np.ndarray]]:
    """Yield the states of ``policy.space.sample(count, seed)``, as lists of chunks (B, n)."""
    domain, random = policy.space, np.random.default_rng(seed)
    most = max(CHUNK // in_force, min(FEWEST, CHUNK))
    wave = max(1, WAVE * CHUNK // (most * in_force))
    sizes = [min(most, count - start) for start in range(0, count, most)]
    for start in range(0, len(sizes), wave):
        yield [
            domain.lower + random.random((size, domain.n)) * domain.widths
            for size in sizes[start : start + wave]
        ]
