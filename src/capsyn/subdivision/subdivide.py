"""Algorithm 1 of the paper: adaptive cell subdivision, over any labelling function.

Test points lie on an integer lattice eight times finer than the finest cells, so that vertices,
centres, edge midpoints and the points of the quarter rule are whole numbers, and a point that
cells or levels share is solved once.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.cells.affine_leaves import PriceRatios
from capsyn.cells.masks import (
    Label,
    Scored,
    checked_masks,
    checked_pair,
    indicators,
    masks_of_scores,
    masks_of_symbols,
)
from capsyn.cells.row_table import RowTable
from capsyn.errors import ProblemError
from capsyn.execution.checkpoint import Remembered
from capsyn.execution.processors import pool_of
from capsyn.modelling.alphabet import Alphabet, Outside, check_outside
from capsyn.modelling.domain import Box
from capsyn.modelling.grid import Grid
from capsyn.modelling.time_unit import check_time_unit
from capsyn.policies.policy import Policy
from capsyn.subdivision.cell_blocks import SubdivisionTask
from capsyn.subdivision.constant import ConstantSubdivision
from capsyn.subdivision.lattice_points import LatticePoints, Progress
from capsyn.subdivision.limits import Limits
from capsyn.subdivision.plan import SubdivisionPlan
from capsyn.subdivision.rounds import RoundSubdivision
from capsyn.validation import describe, is_list, one_of, true_or_false, whole_number

RETURNS = ("symbols", "masks", "scores", "masks+scores")


def subdivide(
    label: Callable[[np.ndarray], Any],
    domain: Box,
    symbols: int | Alphabet,
    *,
    partitions: Any = 9,
    refinement: Any = 2,
    max_level: int = 4,
    leaves: str = "constant",
    leaf_error: float = 0.01,
    refine: str = "isotropic",
    test_points: str = "vertices+center",
    seed: int = 0,
    returns: str = "symbols",
    preference: Sequence[int] | None = None,
    in_force: bool = False,
    outside: Outside = "error",
    name: str = "policy",
    time_unit: str = "s",
    max_solves: int | None = None,
    max_seconds: float | None = None,
    max_memory: int | str | None = None,
    memory_limit: int | str | None = None,
    threads: int = 1,
    progress: Callable[[Progress], None] | None = None,
) -> Policy:
    """Return the policy of a labelling function, by Algorithm 1 of the paper.

    Parameters
    ----------
    label : callable
        States (B, n) to what `returns` says.
    domain : Box
        States to label.
    symbols : int or Alphabet
        Number of symbols N, or the alphabet itself.
    partitions, refinement : int or (n,)
        Cells of the root grid, and children of a split cell, per axis.
    max_level : int
        Most times that a cell is split along an axis.
    leaves : "constant" or "affine"
        One symbol for each cell, or for cells on a switching surface rows that are affine in the
        state: the symbol of the largest. Rows are fitted to the scores at the cell's test points,
        or, without scores, to its labels, and kept as integers.
    leaf_error : float
        Largest estimated share of a cell, 0 to 1, where its rows may be wrong; see the notes.
    refine : "isotropic" or "adaptive"
        Split cells along all axes, or along those only along which their labels, or the errors of
        their rows, vary: fewer solves, most of all with affine leaves in three dimensions and more.
        Of at most 16 axes.
    test_points : str
        ``"vertices+center"``, with ``+edge_midpoints``, ``+faces`` (their centres) and
        ``+random:R`` added as wanted; or ``"center+faces"``, without the 2^n vertices.
    seed : int
        Seed of the random test points.
    returns : "symbols", "masks", "scores" or "masks+scores"
        What `label` returns: symbol indices (B,), -1 for the default; masks of the symbols that
        could be best, unsigned (B,), bit N for the default, 0 where there is no finite answer, or
        beyond 63 symbols uint64 (B, W), bit ``i % 64`` of word ``i // 64`` for symbol i;
        scores (B, N), the largest is best, or (B, N + 1) with that of the default, NaN where there
        is no finite answer; or a pair of masks and scores.
    preference : sequence of int, optional
        Symbols (N for the default), most preferred first, to break ties. Default: by index.
    in_force : bool
        Whether `label` returns symbols (B, N + 1), or masks (B, N + 1) or (B, N + 1, W): one for
        each symbol in force, and last for the default control, which is in force before the first
        decision. Then the policy depends on the symbol in force, which stays where it ties.
    outside : "error", "nearest" or symbol
        Rule of the policy for states outside the domain.
    name : str
        Name of the policy.
    time_unit : "ns", "us", "ms", "s", "min", "h" or "d"
        What the policy counts time in.
    max_solves : int, optional
        Of constant leaves, split along all axes: stop before a level that would exceed so many
        solves, with a valid coarser policy. Else: spend them on the cells where the estimated error
        is largest, until they are used up or no cell can be split.
    max_seconds : float, optional
        Stop after a block of cells, or a round of splits, that ends later [s], with a valid
        policy that is coarser in what was not reached. The only setting by which results depend
        on the machine. The root grid is always labelled.
    max_memory : int or str, optional
        Stop likewise before a block that may exceed so much memory [bytes, or text as ``"2GB"``].
    memory_limit : int or str, optional
        Refuse, before any work, what may take more memory at worst [bytes, or text]; default: what
        is available. A budget of solves or memory bounds the worst case. Levels of
        constant cells, split along all axes, that would take more than a quarter are labelled in
        blocks, with the same result.
    threads : int
        Threads that call `label`; the result does not depend on it.
    progress : callable, optional
        Called with a `Progress` now and then.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or a label that is no symbol.
    SynthesisError
        More than 1 % of the states have no finite answer.

    Notes
    -----
    A cell is uniform when one symbol could be best at all its test points, and it takes the most
    preferred of those. A tie must not hide a switching surface: above the finest level, a test
    point (not a random one) of a uniform cell where several symbols tie is moved a quarter of the
    way to the cell's centre and must agree there too. A mixed cell of the finest level takes the
    symbol that most of its points could have, among those that some point determines alone.

    With affine leaves, a cell that is not uniform is accepted when its rows give all its test
    points a symbol that could be best there, and their estimated error is at most `leaf_error`:
    the mean over the test points of ``min(1, rho / margin)^2``, with `margin` the difference of the
    two largest rows and `rho` the root mean square of what it differs by from that of the scores
    (Chebyshev's inequality). Else it is split. So refinement follows the curvature of surfaces.
    Of centre and other fixed points, which rows are fitted to, the centre has half the weight.

    An adaptive split of constant leaves is along the axes along which two neighbouring test points
    have no symbol in common. With affine leaves it is along those along which the error of the rows
    varies at least 0.8 times as much as along any: its differences between opposite test points
    show products of coordinates, and those from points half-way show squares; where none of the
    latter are tested and squares, seen at the centre, prevail, all axes are split.
    """
    if not callable(label):
        raise ProblemError(f"`label` must be a function; got {describe(label)}")
    if not isinstance(domain, Box):
        raise ProblemError(f"`domain` must be a capsyn.Box; got {describe(domain)}")
    domain.check_wide("domain")
    check_time_unit(time_unit)
    true_or_false("in_force", in_force)
    if in_force and returns in ("scores", "masks+scores"):
        raise ProblemError(
            f"`returns` must be symbols or masks for labels `in_force`; got {describe(returns)}"
        )
    alphabet = symbols
    if not isinstance(alphabet, Alphabet):
        alphabet = Alphabet(range(whole_number("symbols", symbols, least=1)))
    plan = SubdivisionPlan.of(
        Grid.of(partitions, refinement, max_level, domain.n),
        Limits.of(max_solves, max_seconds, max_memory, memory_limit),
        leaves=leaves,
        leaf_error=leaf_error,
        refine=refine,
        test_points=test_points,
        seed=seed,
    )
    plan.check(domain, len(alphabet))
    labels = len(alphabet) + 1 if in_force else 1
    labelling = Labelling(label, returns, preference, threads, progress, labels)
    policy = carry_out(plan, labelling, domain, alphabet, outside, name)
    return dataclasses.replace(policy, time_unit=time_unit)


@dataclass(frozen=True)
class Labelling:
    """What labels states, and how it is called; see `subdivide`."""

    label: Callable[[np.ndarray], Any]
    returns: str = "symbols"
    preference: Sequence[int] | None = None
    threads: int = 1
    progress: Callable[[Progress], None] | None = None
    in_force: int = 1  # symbols in force that masks (B, J, W) are given for; 1: masks (B, W)
    prices: PriceRatios | None = None  # on switching, that scores pay while others are in force


def carry_out(
    plan: SubdivisionPlan,
    labelling: Labelling,
    domain: Box,
    alphabet: Alphabet,
    outside: Outside = "error",
    name: str = "policy",
) -> Policy:
    """Return the policy of a plan that was checked for a domain and so many symbols.

    The other arguments, and errors, are those of `subdivide`.
    """
    label, returns, n_symbols = labelling.label, labelling.returns, len(alphabet)
    one_of("returns", returns, list(RETURNS))
    if plan.affine and labelling.in_force > 1 and labelling.prices is None:
        raise ProblemError(
            "`leaves` must be constant where labels depend on the symbol in force and no scores "
            "pay prices; got affine"
        )
    threads = whole_number("threads", labelling.threads, least=1)
    order = _order(labelling.preference, n_symbols)
    outside = check_outside(outside, alphabet)
    if isinstance(label, Remembered) and not plan.in_rounds:  # its chunks are those of blocks
        plan = plan.with_room(label.checkpoint.settle("block_memory", plan.room))
    started = time.perf_counter()
    with pool_of(threads) as pool:
        points = LatticePoints(
            (_scored if plan.affine else _masks)(label, returns, n_symbols, labelling.in_force),
            domain,
            plan.lattice,
            n_symbols,
            pool if threads > 1 else None,
            labelling.progress,
            plan.affine,
            plan.limits.max_solves if plan.in_rounds else None,
            labelling.in_force,
            None if labelling.prices is None else labelling.prices.ratios[:, -1] < 0,
        )
        dear = labelling.prices is not None and labelling.prices.unit > 0
        rows = RowTable(order, labelling.in_force, dear)
        plain = not returns.endswith("scores")
        task = SubdivisionTask(plan, rows, points, plain, labelling.prices)
        work = RoundSubdivision(task) if plan.in_rounds else ConstantSubdivision(task)
        cells = work.run()
    seconds = time.perf_counter() - started
    return Policy(
        name=name,
        domain=domain,
        alphabet=alphabet,
        default=np.zeros(alphabet.m),
        cells=cells,
        outside=outside,
        statistics=work.statistics(),
        timings={"label": points.seconds, "subdivide": seconds - points.seconds},
        transitions=None if labelling.in_force == 1 else rows.labels(),
    )


def _masks(
    label: Callable[[np.ndarray], Any], returns: str, n_symbols: int, in_force: int = 1
) -> Label:
    """Return a labelling function that gives checked masks, for so many labels in force."""
    if returns == "masks":
        return checked_masks(label, n_symbols, in_force)
    if returns == "symbols":
        return masks_of_symbols(label, n_symbols, in_force=in_force)
    scored = _scored(label, returns, n_symbols, in_force)
    return lambda states: scored(states)[0]


def _scored(
    label: Callable[[np.ndarray], Any], returns: str, n_symbols: int, in_force: int = 1
) -> Scored:
    """Return a labelling function that gives checked masks and scores."""
    if returns == "scores":
        return masks_of_scores(label, n_symbols)
    if returns == "masks+scores":
        return checked_pair(label, n_symbols, in_force)
    return indicators(_masks(label, returns, n_symbols), n_symbols)


def _order(preference: Sequence[int] | None, n_symbols: int) -> list[int]:
    """Return symbols and the default, most preferred first."""
    wanted = range(n_symbols + 1)
    if preference is None:
        return list(wanted)
    if not is_list(preference, len(wanted)) or any(s not in list(preference) for s in wanted):
        raise ProblemError(
            f"`preference` must name each of 0..{n_symbols} once; got {describe(preference)}"
        )
    return [int(s) for s in preference]
