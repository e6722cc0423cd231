"""Choose the alphabet of a problem: which settings its actuators should have."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from capsyn.alphabets.asked import Asked
from capsyn.alphabets.judge import Judge
from capsyn.alphabets.loops.alphabet_loops import AlphabetLoops
from capsyn.alphabets.search.best_alphabets import Search
from capsyn.alphabets.search.moving import Movable
from capsyn.alphabets.search.objective import Objective
from capsyn.alphabets.search.scores import Scores
from capsyn.alphabets.search.starts import Starts
from capsyn.alphabets.search.storage import Storage
from capsyn.alphabets.study import AlphabetStudy
from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import MAX_SYMBOLS
from capsyn.modelling.problem import Problem
from capsyn.programs.program import Program
from capsyn.random_streams import derived_seed
from capsyn.synthesis.synthesize import check_arguments
from capsyn.tuning.figures import cost_program
from capsyn.tuning.same_study import digest, loop_facts, problem_facts
from capsyn.validation import describe, true_or_false, whole_number
from capsyn.verification.trials import TrialOptions

SEARCHED, CHOSEN = 30, 33
"""Purposes of the seeds of starts: of the search, and of the choice among what it found."""
MORE = 4
"""How many times the starts of the search choose among what it found."""
MOST_COUNT = 8
"""Numbers of symbols from 2 to this are tried where none is given."""
NOT_ASKED = ("stop_at_target", "executor", "track", "model", "parameters", "min_dwell")
"""Arguments of closed loops that are not those of `choose_alphabet`."""


def choose_alphabet(
    problem: Problem,
    candidates: Any,
    count: int | Sequence[int] | None = None,
    *,
    objective: Mapping[str, float] | str | None = None,
    steps: int | Sequence[int] | None = None,
    keep: Sequence[Any] = (),
    exclude: Sequence[Any] = (),
    prices: Mapping[str, float] | None = None,
    own: Sequence[Any] = (),
    cost: Callable[..., Any] | None = None,
    starts: int = 100,
    fresh: int = 1000,
    policies: bool = True,
    synthesis: Mapping[str, Any] | None = None,
    storage: str | os.PathLike[str] | None = None,
    seed: int = 0,
    backend: str = "auto",
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
    **loops: Any,
) -> AlphabetStudy:
    """Choose which settings the actuators should have, among many candidates.

    The search runs closed loops of sSAC itself, without cells, under many alphabets at once. It
    starts from several alphabets: single actuators, pairs, evenly spread ones, unions of orbits of
    the model's symmetries, what mode insertion gradients and what rollouts favour, and the user's
    own. Then it drops, adds and swaps symbols as long as closed loops gain. Symbols of a box with
    continuous inputs also move between the candidates. Other starts choose among what was found,
    and yet others judge it, beside evenly spread and random alphabets of the same size.

    Parameters
    ----------
    problem : Problem
        The problem. Its own alphabet says what the inputs are, and is one of those judged if its
        symbols are candidates.
    candidates : Alphabet, (K, m) or (K,) numbers, or Box
        The candidates [input units], at most 4,096. A `Box` of continuous inputs becomes a grid.
        `capsyn.actuator_combinations` makes the combinations of on/off actuators.
    count : int, or several, optional
        The most symbols that the alphabet may have. An alphabet has fewer if more gain nothing. Of
        several numbers, the one with the least objective is chosen. Default: 2 to 8.
    objective : mapping of name to float, or a name, optional
        What to make least: a sum of figures of a closed loop with weights >= 0. The figures are
        ``cost``, ``effort`` (the integral of ``u^T u``), ``fuel`` (the integral of the sum of
        ``|u|``), ``time`` until a loop arrives (all of it if the loop fails), ``switches``, and
        ``failures`` (1 if a loop does not succeed, as in `capsyn.monte_carlo`). Default: the cost.
    steps : int or m ints, optional
        Levels of each input of a box. Default: 11, 5 or 3 for one, two or more inputs.
    keep, exclude : sequences of names or values
        Symbols that the alphabet must have, and candidates that it must not have. Where candidates
        of a box are excluded, symbols do not move away from the grid.
    prices : mapping of name to float, optional
        Prices of symbols, such as what their hardware costs, in the unit of the objective. They are
        added to the objective.
    own : sequence of alphabets
        Further alphabets to start from and to judge, each a list of names or values.
    cost : callable ``x -> scalar``, or ``(x, w)``, optional
        The cost that loops gather [cost / time unit]. Default: the running cost of the problem.
    starts : int
        Number of random starts of the search.
    fresh : int
        Number of fresh starts that judge.
    policies : bool
        Whether to synthesize the policy of each alphabet that is judged, for its size.
    synthesis : mapping, optional
        Arguments of `capsyn.synthesize`, such as ``{"max_solves": 60_000}``.
    storage : path, optional
        An SQLite file that keeps what the search finds. A search that was killed goes on from it.
    seed : int
        Seed of all random numbers.
    backend, threads
        The arguments of the same names of `capsyn.synthesize`.
    progress : callable, optional
        A function that is called with a text about what comes next.
    **loops
        How loops run: arguments of `capsyn.monte_carlo`, such as ``duration``, ``rate``,
        ``initial``, ``target``, ``within`` and ``hold``.

    Returns
    -------
    AlphabetStudy
        The alphabet, the table of all that were judged, and its picture.

    Raises
    ------
    ProblemError
        An argument that cannot be used, or a storage of another search.
    """
    if not isinstance(problem, Problem):
        raise ProblemError(f"`problem` must be a Problem; got {describe(problem)}")
    weights, counts = Objective.of(objective), _counts(count)
    _check_numbers(starts, fresh, seed, policies, progress)
    if "trials" in loops:
        raise ProblemError("there is no argument `trials` here: `starts` and `fresh` say how many")
    plan = TrialOptions.of(
        without=NOT_ASKED, trials=starts, backend=backend, threads=threads, **loops
    )
    say = progress or (lambda text: None)
    asked = Asked.of(problem, candidates, steps, keep, exclude, prices, own, weights.weights)
    _check(asked, counts, weights, plan)
    check_arguments("synthesis", synthesis or {})
    program = None if cost is None else _cost(problem, cost)
    search, searched = _search(asked, weights, plan, program, storage, seed, say)
    found = search.best(counts)
    chosen = {n: asked.named(values) for n, values in found.items()}
    synthesis = dict(synthesis or {}) if policies else None
    judge = Judge(problem, search.scores.loops, weights, asked.pool, fresh, seed, synthesis)
    table = judge.table(chosen, asked.own, progress)
    rows = [row for row in table if row.kind == "chosen"]
    best = min(rows, key=lambda row: (row.objective, len(row.alphabet)))
    return AlphabetStudy(
        problem=problem.name,
        objective=dict(weights.weights),
        count=best.count,
        alphabet=best.alphabet,
        table=table,
        candidates=asked.pool.candidates,
        searched=searched(),
        fresh=fresh,
        prices=dict(prices or {}),
        time_unit=problem.time_unit,
    )


def _counts(count: Any) -> list[int]:
    """Return the numbers of symbols that are asked for, ascending."""
    if count is None:
        return list(range(2, MOST_COUNT + 1))
    several = list(count) if np.iterable(count) and not isinstance(count, str) else [count]
    if not several:
        raise ProblemError("`count` must be a whole number >= 1, or several; got none")
    return sorted({whole_number("count", one, least=1, most=MAX_SYMBOLS) for one in several})


def _check_numbers(starts: Any, fresh: Any, seed: Any, policies: Any, progress: Any) -> None:
    """Raise unless arguments that need nothing else can be used."""
    if progress is not None and not callable(progress):
        raise ProblemError(f"`progress` must be a function of a text; got {describe(progress)}")
    whole_number("starts", starts, least=1)
    whole_number("seed", seed, least=0)
    whole_number("fresh", fresh, least=2)
    true_or_false("policies", policies)


def _check(asked: Asked, counts: list[int], weights: Objective, plan: TrialOptions) -> None:
    """Raise where numbers of symbols or the objective do not fit the other arguments."""
    kept = len(asked.pool.keep)
    if counts[0] < kept:
        raise ProblemError(
            f"`count` must be at least the {kept} symbols that are kept; got {counts[0]}"
        )
    if plan.loop.target is None and asked.problem.target is None:
        for name in ("time", "failures"):
            if weights.weights.get(name):
                raise ProblemError(f"`objective` must have no {name} without a target; got one")


def _cost(problem: Problem, cost: Any) -> Program:
    """Return the program of a cost that loops gather."""
    if not callable(cost):
        raise ProblemError(f"`cost` must be a function of x; got {describe(cost)}")
    return cost_program(problem, cost)


def _search(
    asked: Asked,
    weights: Objective,
    plan: TrialOptions,
    cost: Program | None,
    storage: Any,
    seed: int,
    say: Callable[[str], None],
) -> tuple[Search, Callable[[], int]]:
    """Return the search, and what tells how many alphabets it has tried."""
    problem, pool = asked.problem, asked.pool
    say("compiling closed loops")
    backend, threads = plan.loop.backend, plan.loop.threads
    searched = _seeded(plan, plan.trials, seed, SEARCHED)
    loops = AlphabetLoops.of(problem, pool.candidates, searched, cost, backend, threads)
    facts = {
        "problem": digest(problem_facts(problem)),
        "candidates": digest([pool.candidates.values, list(pool.keep)]),
        "number of starts": str(plan.trials),
        "loops": digest([loop_facts(loops.test), loops.cost.to_json()]),
        "objective": f"{weights} ({digest(dict(weights.weights))})",
        "seed": str(seed),
    }
    kept = Storage(storage, facts)
    scores = Scores(loops, weights, pool.price_of(pool.candidates.values), kept, plan.trials)
    more = _seeded(plan, MORE * plan.trials, seed, CHOSEN)
    fresh = dataclasses.replace(
        scores, loops=loops.over(pool.candidates, more), starts=more.trials, part="chosen "
    )
    movable = None
    if asked.box is not None:
        movable = (Movable(scores, asked.box, pool), Movable(fresh, asked.box, pool))
    say("a first look by gradients")
    starts = Starts.of(problem, pool, asked.own_members, backend, seed)
    return Search(scores, fresh, starts, movable, seed, say), lambda: len(scores.met)


def _seeded(plan: TrialOptions, trials: int, seed: int, purpose: int) -> TrialOptions:
    """Return a plan with so many starts, of a purpose."""
    loop = dataclasses.replace(plan.loop, seed=derived_seed(seed, purpose))
    return dataclasses.replace(plan, loop=loop, trials=trials)
