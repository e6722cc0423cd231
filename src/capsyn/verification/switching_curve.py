"""What prices and least times do to a policy: switches, cost and success, side by side."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import PriceRatios
from capsyn.cells.cell_tree import CellTree
from capsyn.controllers.ssac import BatchController, policy_controller
from capsyn.controllers.unsolved.diagnosis import Diagnosis
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.execution.processors import processors
from capsyn.modelling.discrete import horizon_time
from capsyn.modelling.switching import Switching
from capsyn.modelling.time_unit import NAMES
from capsyn.native.compiler import has_compiler
from capsyn.policies.policy import Policy, cell_tree
from capsyn.programs.model import gathered_cost
from capsyn.simulation.experiment import set_up
from capsyn.simulation.options import LoopOptions
from capsyn.simulation.plant import plant_of
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.plan import SubdivisionPlan
from capsyn.subdivision.subdivide import Labelling, carry_out
from capsyn.synthesis.synthesize import SAMPLES
from capsyn.validation import describe, finite_number, whole_number

PRICES = (0.0, "0.3%", "1%", "2%", "3%", "5%", "10%")
"""Prices that are tried unless others are given."""
DEARER = 1.03
"""How much of the least cost the recommended price may take."""
LOST = 0.005
"""Share of the trials that it may lose."""
CHATTER = 0.05
"""Share of the samples at which a policy that does not chatter may switch."""
HINT_TRIALS, HINT_SAMPLES, HINT_PRICES = 32, 3000, (0.0, "0.1%", "0.3%", "1%")
"""Loops, and prices, that the hint looks at."""
HINT_SECONDS = 0.5
"""Longest time that a policy took which is made anew for the hint [s]."""
HORIZONS = 20
"""Prediction horizons that a loop takes unless it is told otherwise."""


@dataclass(frozen=True)
class SwitchingPoint:
    """What closed loops do under one price on switching and one least time.

    Parameters
    ----------
    price : str
        The price as it was given: a number or a share.
    value : float
        The price as a number [cost / time unit]; the largest one if there are several.
    hold : float
        Least time of all symbols [time unit]; the longest one if there are several.
    rows, cells, solves : int
        Numbers of the policy: rows of its transition function, leaves, and solves.
    switches : float
        Switches per time unit, over all trials.
    cost : float
        Mean cost of the trials: their running cost, or their terminal cost if there is no running
        cost.
    success : float, optional
        Share of the trials that end in the target; None without a target.
    recommended : bool
        Whether this point has the fewest switches of all points that cost and lose little more than
        the best.
    """

    price: str
    value: float
    hold: float
    rows: int
    cells: int
    solves: int
    switches: float
    cost: float
    success: float | None
    recommended: bool = False

    def to_json(self) -> dict[str, Any]:
        """Return the point as plain data."""
        return dataclasses.asdict(self)


def switching_curve(
    policy: Policy,
    prices: Sequence[Any] = PRICES,
    holds: Sequence[float] | None = None,
    *,
    trials: int = 200,
    duration: float | None = None,
    rate: float | None = None,
    seed: int = 0,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[SwitchingPoint, ...]:
    """Return what prices and least times do to the closed loops of a policy that sSAC made.

    For each price, the policy is made anew, with the settings and forbidden transitions that it
    carries. All loops start from the same random states of the domain. All loops are told the same
    exogenous inputs, which are drawn from their box and constant along a loop.

    Parameters
    ----------
    policy : Policy
        A policy of cells that carries its model, such as `capsyn.synthesize` makes.
    prices : numbers >= 0 and shares such as ``"1%"``
        The prices to try. Each is one price for all switches, in place of the policy's own prices;
        see `capsyn.Switching`.
    holds : floats, optional
        Least times of all symbols [time unit]. Each is tried with every price. Default: the
        policy's own.
    trials, rate, seed, backend, threads
        The arguments of the same names of `capsyn.monte_carlo`. Trials run to the end of their
        time.
    duration : float, optional
        Time of a trial [time unit]. Default: `HORIZONS` prediction horizons.
    progress : callable, optional
        A function that is called with a text about what comes next.

    Raises
    ------
    ProblemError
        A policy that cannot be made anew, or an argument that cannot be used.
    """
    base = _controller(policy, backend)
    own = policy.switching or Switching(hold=policy.min_dwell)
    times = [own.hold] if holds is None else [finite_number("holds", h, least=0.0) for h in holds]
    tried = [(p, dataclasses.replace(own, price=p, hold=h)) for h in times for p in prices]
    if not tried:
        raise ProblemError("`prices` and `holds` must have one value each at least; got none")
    states, options = _loops(policy, trials, duration, rate, seed, backend, threads)
    points: list[SwitchingPoint] = []
    for price, switching in tried:
        told = price if isinstance(price, str) else f"{price:g}"
        if progress is not None:
            progress(f"price {told}, hold {switching.hold}")
        points.append(_point(repriced(policy, base, switching, threads), told, states, options))
    best = knee(points)
    return tuple(dataclasses.replace(p, recommended=p is best) for p in points)


def _loops(
    policy: Policy,
    trials: int,
    duration: float | None,
    rate: float | None,
    seed: int,
    backend: str,
    threads: int | None,
) -> tuple[np.ndarray, LoopOptions]:
    """Return the states (B, n) that loops start from, and how they run."""
    trials = whole_number("trials", trials, least=1)
    if duration is None:
        duration = HORIZONS * (horizon_time(policy) or 1.0)
    options = LoopOptions(duration, rate, seed=seed, backend=backend, threads=threads)
    return policy.space.sample(trials, [seed, 6]), options


def switching_point(
    policy: Policy,
    *,
    trials: int = 200,
    duration: float | None = None,
    rate: float | None = None,
    seed: int = 0,
    backend: str = "auto",
    threads: int | None = None,
) -> SwitchingPoint:
    """Return what closed loops of a policy do, with its own prices and least times.

    Parameters
    ----------
    policy : Policy
        Any policy that carries its model.
    trials, duration, rate, seed, backend, threads
        The arguments of the same names of `switching_curve`.

    Raises
    ------
    ProblemError
        A policy without a model, or an argument that cannot be used.
    """
    price = 0.0 if policy.switching is None else policy.switching.price
    told = f"{price:.6g}" if isinstance(price, float) else "several"
    return _point(policy, told, *_loops(policy, trials, duration, rate, seed, backend, threads))


def _point(policy: Policy, price: str, states: np.ndarray, options: LoopOptions) -> SwitchingPoint:
    """Return what closed loops of a policy from states (B, n) do."""
    switching, rules = policy.switching, policy.rules
    finite = rules.prices[np.isfinite(rules.prices)]
    value = float(finite.max(initial=0.0)) if switching is not None else 0.0
    return SwitchingPoint(
        price,
        value,
        float(max(rules.holds.max(), rules.input_holds.max(initial=0.0))),
        len(np.unique(policy.cells.constant_leaves(len(policy.transitions)))),
        policy.cells.leaf_count,
        policy.statistics.get("solves", 0),
        *_figures(policy, states, options),
    )


def chatter_hint(policy: Policy, threads: int | None = None) -> str | None:
    """Return a sentence for a policy without memory that chatters, with the recommended price.

    It chatters when more than `CHATTER` of the samples of a short closed loop switch. Where the
    policy took longer than `HINT_SECONDS` to make no price is tried. Without a C compiler there is
    no hint: loops by NumPy take longer than many a policy.
    """
    cells, settings, statistics = policy.cells, policy.settings, policy.statistics
    known = isinstance(cells, CellTree) and policy.model is not None and settings is not None
    if not known or policy.switching is not None or policy.delay or "seed" not in statistics:
        return None
    if not has_compiler():
        return None
    assert settings is not None
    rate = 1 / settings.period
    duration = HINT_SAMPLES / rate
    with warnings.catch_warnings():  # of a loop that nobody asked for
        warnings.simplefilter("ignore", CapsynWarning)
        states, options = _loops(policy, HINT_TRIALS, duration, rate, 0, "auto", threads)
        switches, cost, _ = _figures(policy, states, options)
        if not switches > CHATTER * rate:
            return None
        unit = policy.time_unit
        told = f"it switches {switches:.3g} times per {NAMES[unit]} at {rate:g} samples"
        if sum(policy.timings.values()) > HINT_SECONDS:
            return f"{told}: `capsyn switching FILE --curve` shows what a price does with that"
        points = switching_curve(
            policy, HINT_PRICES, trials=HINT_TRIALS, duration=duration, rate=rate, threads=threads
        )
        best = next(point for point in points if point.recommended)
    if best.value == 0.0 or best.switches > 0.9 * switches:
        return None
    more = best.cost / cost - 1 if cost > 0 else 0.0
    return (
        f"{told}: --switch-price {best.price} makes that {best.switches:.3g} at {more:+.1%} of the "
        "cost; `capsyn switching FILE --curve` shows others"
    )


def repriced(
    policy: Policy, base: BatchController, switching: Switching, threads: int | None = None
) -> Policy:
    """Return a policy made anew with another `Switching`; `base` is its controller without one."""
    cells, statistics = cell_tree(policy), policy.statistics
    if switching.has_share:
        sample = policy.space.sample(SAMPLES, statistics["seed"] + 1)
        switching = switching.with_spread(base.spread(base.solve(sample)))
    prices = switching.prices(policy.alphabet, policy.default_control)
    formulation = dataclasses.replace(base.formulation, prices=prices)
    controller = dataclasses.replace(base, formulation=formulation)
    affine = statistics.get("leaves") == "affine"
    level = cells.max_level
    if affine:  # the grid is that of the rows
        level = max(int(cells.times(some).max()) for some in cells.levels())
    plan = SubdivisionPlan.of(
        dataclasses.replace(cells.grid, max_level=level),
        Limits.of(None, None, None, None),
        leaves="affine" if affine else "constant",
        leaf_error=statistics.get("leaf_error", 0.01),
        refine=statistics.get("refine", "isotropic"),
        test_points=statistics["test_points"],
        seed=statistics["seed"],
    )
    label, returns = (controller.scored, "masks+scores") if affine else (controller.masks, "masks")
    ratios = PriceRatios.of(prices)
    labelling = Labelling(
        label,
        returns,
        controller.preference,
        processors(threads),
        in_force=controller.in_force,
        prices=ratios,
        diagnosis=Diagnosis(formulation),
    )
    made = carry_out(plan, labelling, policy.space, policy.alphabet)
    return dataclasses.replace(
        policy,
        cells=made.cells,
        kept=None,
        transitions=made.transitions,
        switching=switching,
        min_dwell=0.0,
        statistics=made.statistics,
        evidence={},
    )


def _controller(policy: Policy, backend: str) -> BatchController:
    """Return the controller of a policy without prices; `ProblemError` where there is none."""
    cell_tree(policy)
    controller = policy_controller(policy, backend)
    if controller is None or "seed" not in policy.statistics:
        raise ProblemError(
            "`policy` must be one that capsyn.synthesize made, with its model; got "
            f"{describe(policy)}"
        )
    prices = None
    if policy.delay:
        prices = np.zeros((len(policy.alphabet) + 1,) * 2)
    formulation = dataclasses.replace(controller.formulation, prices=prices)
    return dataclasses.replace(controller, formulation=formulation)


def _figures(
    policy: Policy, states: np.ndarray, options: LoopOptions
) -> tuple[float, float, float | None]:
    """Return switches per time unit, mean cost, and share in the target at the end."""
    plant = plant_of(policy)
    cost = gathered_cost(plant.running_cost, plant.terminal_cost)
    plant = dataclasses.replace(plant, running_cost=cost)
    experiment = set_up(policy, plant, options)
    count = len(states)
    trials = experiment.trials(states, np.full(count, plant.delay), np.zeros((count, 0)))
    experiment.run(trials, None, None)
    time = trials["end"].sum() / experiment.rate
    success = None
    if experiment.target is not None:
        at_end = experiment.loop.inside.evaluate(trials["state"].T)[0][0]
        success = float((at_end != 0).mean())
    return float(trials["switches"].sum() / time), float(trials["cost"].mean()), success


def knee(points: Sequence[Any]) -> Any:
    """Return the point of fewest switches that costs and loses little more than the best.

    Points have ``switches``, ``cost`` and ``success`` as `SwitchingPoint` has them.
    """
    most = max(point.success or 0.0 for point in points)
    good = [point for point in points if (point.success or 0.0) >= most - LOST]
    least = min(point.cost for point in good)
    near = [point for point in good if point.cost - least <= (DEARER - 1) * abs(least)]
    return min(near, key=lambda point: point.switches)
