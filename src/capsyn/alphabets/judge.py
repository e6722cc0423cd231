"""Alphabets judged on fresh closed loops and by their policies, beside others of the same size."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.alphabets.candidates import with_alphabet
from capsyn.alphabets.judged import Judged
from capsyn.alphabets.loops.alphabet_loops import AlphabetLoops, LoopFigures
from capsyn.alphabets.pace import Pace
from capsyn.alphabets.search.objective import Objective
from capsyn.alphabets.spread import Pool, random_sets, uniform_set
from capsyn.errors import ProblemError, SynthesisError, warn
from capsyn.exports.c.target import written_bytes
from capsyn.exports.plan import Plan
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.problem import Problem
from capsyn.policies.checks import KINDS, SIZES
from capsyn.random_streams import derived_seed
from capsyn.statistics import clopper_pearson, mean_interval
from capsyn.synthesis.synthesize import synthesize
from capsyn.validation import whole_number

JUDGING = 31
"""Purpose of the seed of the starts."""
CONFIDENCE = 0.95
"""Of the intervals."""
RANDOMS = 5
"""Random alphabets of a size, of which the best is told."""

Say = Callable[[str], None] | None


@dataclass(frozen=True, eq=False)
class Judge:
    """Judges alphabets on starts that no search saw, the same for all of them.

    Parameters
    ----------
    problem : Problem
        The problem as it was given, with its own alphabet.
    loops : AlphabetLoops
        Closed loops of the search; those that judge run like them, from other starts.
    objective : Objective
        What is made of a loop.
    pool : Pool
        The candidates, of which the other alphabets are made; their prices are added to the
        objective.
    fresh : int
        Number of starts, two or more.
    seed : int
        Seed of the study; the starts and the random alphabets have seeds of their own.
    synthesis : dict, optional
        Arguments of `capsyn.synthesize`, with which policies are made; None for no policies.
    """

    problem: Problem
    loops: AlphabetLoops
    objective: Objective
    pool: Pool
    fresh: int
    seed: int
    synthesis: Mapping[str, Any] | None

    def __post_init__(self) -> None:
        whole_number("fresh", self.fresh, least=2)

    def table(
        self,
        chosen: Mapping[int, Alphabet],
        own: Sequence[Alphabet],
        progress: Say = None,
        *,
        randoms: int = RANDOMS,
    ) -> tuple[Judged, ...]:
        """Return the table of a study: each alphabet, and others of the size of those chosen.

        Parameters
        ----------
        chosen : mapping of count to Alphabet
            What the search chose for each number of symbols. What it chose for a smaller number,
            too, is told once.
        own : sequence of Alphabet
            Alphabets of the user.
        progress : callable, optional
            A function that is called with a text about what comes next.
        randoms : int
            Random alphabets of each size; the one of the least objective is told.
        """
        groups = [("own", len(alphabet), [alphabet]) for alphabet in own]
        known = set[bytes]()
        for count, alphabet in sorted(chosen.items(), key=lambda one: one[0]):
            size, key = len(alphabet), alphabet.values.tobytes()
            if key in known:
                continue
            known.add(key)
            uniform = uniform_set(self.pool, size, self.problem.default_control)
            some = random_sets(self.pool, size, randoms, self.seed)
            groups += [("chosen", count, [alphabet]), ("uniform", count, [uniform])]
            groups += [("random", count, some)]
        rows = self._judged([group for group in map(self._usable, groups) if group[2]], progress)
        rows.sort(key=lambda row: (row.count, KINDS.index(row.kind)))
        if self.synthesis is None:
            return tuple(rows)
        pace, sized = Pace(progress, "policy of", len(rows)), dict[bytes, Sized]()
        missing: dict[str, list[str]] = {}
        for k, row in enumerate(rows):
            name, key = _name(row.kind, row.alphabet), row.alphabet.values.tobytes()
            pace.next(name)
            if key not in sized:
                sized[key] = self._sizes(row.alphabet)
            sizes, why = sized[key]
            if why:
                missing.setdefault(why, []).append(name)
            rows[k] = dataclasses.replace(row, **sizes)
        for why, names in missing.items():
            warn(f"{', '.join(names)}: {why}")
        return tuple(rows)

    def _usable(self, group: Group) -> Group:
        """Return a group without alphabets that the problem's rules say nothing of."""
        kind, count, alphabets = group
        fit = []
        for alphabet in alphabets:
            try:
                with_alphabet(self.problem, alphabet)
            except ProblemError as error:
                if kind in ("chosen", "own"):
                    raise
                warn(f"{_name(kind, alphabet)} cannot be compared with: {error}")
            else:
                fit.append(alphabet)
        return kind, count, fit

    def _judged(self, groups: Sequence[Group], progress: Say) -> list[Judged]:
        """Return what fresh loops say of each group: of several alphabets, of the best."""
        given = self.loops.test.options
        loop = dataclasses.replace(given.loop, seed=derived_seed(self.seed, JUDGING))
        plan = dataclasses.replace(given, loop=loop, trials=self.fresh)
        values = [alphabet.values for _, _, some in groups for alphabet in some]
        like, symbols = self.problem.alphabet, np.unique(np.vstack(values), axis=0)
        union = Alphabet(symbols, inputs=like.inputs, units=like.units)
        loops = dataclasses.replace(self.loops, problem=self.problem).over(union, plan)
        pace, rows = Pace(progress, "judging on fresh starts", len(groups)), []
        for kind, count, alphabets in groups:
            pace.next(_name(kind, alphabets[0]))
            found = loops.run([_places(symbols, alphabet.values) for alphabet in alphabets])
            totals = self.objective.values(found)
            each = [
                self._row((kind, count, alphabets[k]), totals[k], found, k)
                for k in range(len(alphabets))
            ]
            best = min(each, key=lambda row: row.objective)
            rows.append(dataclasses.replace(best, tried=len(each)))
        return rows

    def _row(
        self, named: tuple[str, int, Alphabet], values: np.ndarray, found: LoopFigures, k: int
    ) -> Judged:
        """Return what loops say of alphabet `k` of those that ran, of its objectives (S,)."""
        kind, count, alphabet = named
        price = float(self.pool.price_of(alphabet.values).sum())
        lost = ~np.isfinite(values)  # it is NaN for those
        objective = low = high = math.inf
        if not lost.any():
            objective = float(values.mean()) + price
            ends = mean_interval(values, CONFIDENCE)
            assert ends is not None  # of two starts or more
            low, high = (end + price for end in ends)
        return Judged(
            count, kind, alphabet, objective, low, high,
            **self._success(found.figures["failures"][k]),
            figures=self._figures(found.figures, ~lost, k),
            lost=int(lost.sum()),
        )  # fmt: skip

    def _figures(self, figures: Mapping[str, np.ndarray], kept: np.ndarray, k: int) -> Figures:
        """Return the means of figures over the loops that are kept, switches per time unit."""
        if not kept.any():
            return {}
        options = self.loops.test.options
        means = {
            name: float(of[k][kept].mean()) for name, of in figures.items() if name != "failures"
        }
        time = options.loop.duration if options.hold else means["time"]  # else a loop ends there
        means["switches"] = means["switches"] / time if time else 0.0
        return {name: mean for name, mean in means.items() if math.isfinite(mean)}

    def _success(self, failures: np.ndarray) -> dict[str, Any]:
        """Return the share of loops that succeed, with its interval, where there is a target."""
        if self.loops.test.experiment.target is None:
            return {}
        count, of = int((failures == 0).sum()), len(failures)
        low, high = clopper_pearson(count, of, CONFIDENCE)
        return {"success": count / of, "success_low": low, "success_high": high}

    def _sizes(self, alphabet: Alphabet) -> Sized:
        """Return what the policy of an alphabet takes, and why some of that is not known."""
        sizes: dict[str, int | None] = dict.fromkeys(SIZES)
        assert self.synthesis is not None
        try:
            policy = synthesize(with_alphabet(self.problem, alphabet), **self.synthesis)
            sizes |= {"cells": policy.cells.leaf_count, "solves": policy.statistics.get("solves")}
            plan = Plan.of(policy)
            sizes["bytes"] = written_bytes(plan)
            sizes["nodes"] = plan.tree.node_count
        except (ProblemError, SynthesisError) as error:
            missing = ", ".join(name for name, value in sizes.items() if value is None)
            return sizes, f"no {missing}, since {error}"
        return sizes, ""


Group = tuple[str, int, list[Alphabet]]
Figures = dict[str, float]
Sized = tuple[dict[str, Any], str]


def _name(kind: str, alphabet: Alphabet) -> str:
    return f"{kind} {len(alphabet)} symbols"


def _places(symbols: np.ndarray, values: np.ndarray) -> list[int]:
    """Return where values (N, m) are among distinct symbols (K, m)."""
    return [int((symbols == value).all(axis=1).argmax()) for value in values]
