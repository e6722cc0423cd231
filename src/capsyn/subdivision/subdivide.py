"""Algorithm 1 of the paper: adaptive cell subdivision, over any labelling function.

Test points lie on an integer lattice that is eight times finer than the finest cells. Vertices,
centres, edge midpoints and the points of the quarter rule are therefore whole numbers. A point that
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
from capsyn.controllers.unsolved.diagnosis import UNKNOWN, Diagnosis
from capsyn.controllers.unsolved.inside import InsideAnswers
from capsyn.errors import ProblemError, SynthesisError
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
        A function of states (B, n) that returns what `returns` says.
    domain : Box
        The states that get a label.
    symbols : int or Alphabet
        Number of symbols N, or the alphabet itself.
    partitions, refinement : int or (n,)
        Cells of the root grid along each axis, and children of a split cell along each axis.
    max_level : int
        How often a cell may be split along an axis.
    leaves : "constant" or "affine"
        "constant" gives each cell one symbol. "affine" gives cells on a switching surface rows that
        are affine in the state, and the symbol of the largest row. Rows are fitted to the scores at
        the cell's test points, or to the labels if there are no scores. Rows are kept as integers.
    leaf_error : float
        Largest estimated share of an affine leaf, 0 to 1, in which its rows may be wrong; see the
        notes.
    refine : "isotropic" or "adaptive"
        "isotropic" splits cells along all axes. "adaptive" splits a cell only along the axes along
        which its labels, or the errors of its rows, vary. Adaptive splits save solves, most of all
        with affine leaves from three dimensions on. They take at most 16 axes.
    test_points : str
        The points of a cell that are labelled: ``"vertices+center"``, or ``"center+faces"`` without
        the 2^n vertices. Add ``+edge_midpoints``, ``+faces`` (centres of faces) or ``+random:R`` as
        wanted.
    seed : int
        Seed of the random test points.
    returns : "symbols", "masks", "scores" or "masks+scores"
        What `label` returns. "symbols" are indices (B,), -1 for the default control. "masks" are
        the symbols that could be best: unsigned integers (B,), with bit N for the default, and 0 if
        there is no finite answer. Beyond 63 symbols, masks are uint64 (B, W), with bit ``i % 64``
        of word ``i // 64`` for symbol i. "scores" are numbers (B, N), the largest is best, or (B, N
        + 1) with the score of the default; NaN means no finite answer. "masks+scores" is a pair of
        both.
    preference : sequence of int, optional
        Symbols (N for the default), most preferred first, which decide ties. Default: by index.
    in_force : bool
        Whether `label` answers for each symbol in force: with symbols (B, N + 1), or masks (B, N +
        1) or (B, N + 1, W). The last column is for the default control, which is in force before
        the first decision. The policy then depends on the symbol in force, which stays if it ties
        with the best.
    outside : "error", "nearest" or symbol
        The policy's rule for states outside the domain.
    name : str
        Name of the policy.
    time_unit : "ns", "us", "ms", "s", "min", "h" or "d"
        The unit of time of the policy.
    max_solves : int, optional
        Most solves. Constant leaves that are split along all axes stop before a level that would
        exceed the number, with a valid coarser policy. Other leaves spend the solves on the cells
        of largest estimated error, until the solves are used up or no cell can be split.
    max_seconds : float, optional
        Stop after the block of cells, or the round of splits, in which this time [s] runs out. The
        policy is valid, and coarser where the run did not come. Only this option makes results
        depend on the machine. The root grid is always labelled.
    max_memory : int or str, optional
        Stop in the same way before a block that may take more memory [bytes, or text as ``"2GB"``].
    memory_limit : int or str, optional
        Refuse a run that may take more memory at worst, before any work [bytes, or text]. Default:
        the memory that is available. A budget of solves or memory bounds the worst case. Constant
        cells that are split along all axes are labelled in blocks, if a level would take more than
        a quarter of the memory. The result is the same.
    threads : int
        Number of threads that call `label`. The result does not depend on it.
    progress : callable, optional
        A function that is called with a `Progress` now and then.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or a label that is no symbol.
    SynthesisError
        More than 1 % of the states have no finite answer.

    Notes
    -----
    A cell is uniform if one symbol could be best at all its test points. A uniform cell takes the
    most preferred of such symbols. A tie must not hide a switching surface, so there is a quarter
    rule. Above the finest level, it moves a test point (not a random one) where several symbols of
    a uniform cell tie. The point moves a quarter of the way to the cell's centre, and must agree
    there, too. A mixed cell of the finest level takes the symbol that most of its points could
    have, among the symbols that some point determines alone.

    With affine leaves, a cell that is not uniform is accepted under two conditions. First, the
    cell's rows give all test points a symbol that could be best there. Second, the estimated error
    is at most `leaf_error`: the mean over the test points of ``min(1, rho / margin)^2``
    (Chebyshev's inequality). `margin` is the difference of the two largest rows. `rho` is the root
    mean square of how much this difference misses the difference of the scores. Other cells are
    split, so refinement follows the curvature of surfaces. Rows are fitted to the centre and other
    fixed points, and the centre has half the weight.

    An adaptive split of constant leaves is along the axes along which two neighbouring test points
    have no symbol in common. An adaptive split of affine leaves is along the axes along which the
    error of the rows varies at least 0.8 times as much as along any axis. Differences of the error
    between opposite test points show products of coordinates. Differences from points half-way show
    squares. If no points half-way are tested, and the centre shows that squares prevail, all axes
    are split.
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
    diagnosis: Diagnosis | None = None  # of states without an answer; see `InsideAnswers`


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
    answers: Any = (_scored if plan.affine else _masks)(
        label, returns, n_symbols, labelling.in_force
    )
    told = labelling.diagnosis
    if told is not None:
        answers = InsideAnswers(answers, told.defined, domain, plan.grid.counts)
    with pool_of(threads) as pool:
        points = LatticePoints(
            answers,
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
        cells = _run(work, points, told)
    seconds = time.perf_counter() - started
    limits = answers.statistics() if isinstance(answers, InsideAnswers) else {}
    return Policy(
        name=name,
        domain=domain,
        alphabet=alphabet,
        default=np.zeros(alphabet.m),
        cells=cells,
        outside=outside,
        statistics=work.statistics() | limits,
        timings={"label": points.seconds, "subdivide": seconds - points.seconds},
        transitions=None if labelling.in_force == 1 else rows.labels(),
    )


def _run(
    work: RoundSubdivision | ConstantSubdivision, points: LatticePoints, told: Diagnosis | None
) -> Any:
    """Return the cells of a subdivision; where it stops for lost answers, `told` says why."""
    try:
        return work.run()
    except SynthesisError as error:
        if points.example is None:
            raise
        reason = told.why(points.example) if told else UNKNOWN
        raise SynthesisError(f"{error}: {reason}") from None


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
