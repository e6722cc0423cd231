"""Alphabets judged on fresh loops, and by their policies."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from capsyn import Alphabet, Ball, Box, Problem, synthesize
from capsyn.alphabets.candidates import with_alphabet
from capsyn.alphabets.judge import Judge
from capsyn.alphabets.loops.alphabet_loops import AlphabetLoops
from capsyn.alphabets.search.objective import Objective
from capsyn.alphabets.spread import Pool
from capsyn.compression.trees import tree_of
from capsyn.errors import CapsynWarning, ProblemError
from capsyn.exports.c.target import written_bytes
from capsyn.exports.plan import Plan
from capsyn.statistics import clopper_pearson, mean_interval
from capsyn.verification.trials import TrialOptions

CANDIDATES = Alphabet(np.linspace(-2, 2, 9))
SMALL = {"partitions": 3, "max_level": 1}
CHOSEN = Alphabet([-1.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def problem():
    return Problem(
        name="cart",
        dynamics=lambda x, u: [x[1], u[0]],
        domain=Box([-1, -1], [1, 1]),
        alphabet=[-2, 0, 2],
        default=0,
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        target=Ball([0, 0], 0.2),
        outside="nearest",
    )


PRICED = Pool(CANDIDATES, prices=[0.25 * (name == "1") for name in CANDIDATES.names])


@pytest.fixture(scope="module")
def loops(problem):
    plan = TrialOptions.of(trials=10, duration=4, rate=10)
    return AlphabetLoops.of(problem, CANDIDATES, plan)


@pytest.fixture
def judge(problem, loops):
    objective = Objective({"cost": 1.0, "failures": 2.0})
    return Judge(problem, loops, objective, PRICED, 60, 5, None)


def test_rows_are_means_over_fresh_loops_with_their_intervals(judge, problem):
    said = []
    rows = judge.table({3: CHOSEN}, [Alphabet([-2.0, 2.0])], said.append)
    assert [(row.count, row.kind) for row in rows] == [
        (2, "own"), (3, "chosen"), (3, "uniform"), (3, "random"),
    ]  # fmt: skip
    row = rows[1]
    plan = dataclasses.replace(judge.loops.test.options, trials=60)
    again = judge.loops.over(CHOSEN, plan)
    same = again.run([[0, 1, 2]]).figures
    assert row.figures["cost"] != pytest.approx(same["cost"].mean())  # other starts
    assert row.figures["cost"] == pytest.approx(same["cost"].mean(), rel=0.5)  # of as many
    assert row.low < row.objective < row.high
    assert row.objective == pytest.approx(row.figures["cost"] + 2 * (1 - row.success) + 0.25)
    bare = dataclasses.replace(judge, pool=Pool(CANDIDATES)).table({3: CHOSEN}, [])
    assert bare[0].objective == pytest.approx(row.objective - 0.25)
    assert bare[0].high == pytest.approx(row.high - 0.25)
    successes = round(60 * row.success)
    assert (row.success_low, row.success_high) == clopper_pearson(successes, 60)
    assert 0 < row.figures["switches"] <= 10 and row.figures["fuel"] > 0
    assert rows[3].tried == 5 and rows[2].tried == 1
    assert (row.cells, row.solves, row.nodes, row.bytes) == (None,) * 4
    assert said[0] == "judging on fresh starts own 2 symbols: 1 of 4" and len(said) == 4


def test_what_is_chosen_for_several_numbers_is_told_once(judge):
    two = Alphabet([-1.0, 1.0])
    rows = judge.table({4: two, 2: two, 3: CHOSEN}, [], randoms=1)
    assert [row.count for row in rows if row.kind == "chosen"] == [2, 3] and len(rows) == 6


def test_intervals_are_those_of_the_mean_of_each_loop(judge):
    class Known:
        def values(self, found):
            return np.tile(np.arange(60.0), (len(found.lost), 1))

    (row, *_) = dataclasses.replace(judge, objective=Known()).table({3: CHOSEN}, [])
    low, high = mean_interval(np.arange(60.0), 0.95)
    assert (row.objective, row.low, row.high) == (29.75, low + 0.25, high + 0.25)


def test_the_best_of_random_alphabets_is_told(judge):
    five, one = (judge.table({3: CHOSEN}, [], randoms=k)[-1] for k in (5, 1))
    assert five.kind == one.kind == "random" and five.objective <= one.objective
    assert (five.tried, one.tried) == (5, 1)


def test_policies_tell_cells_solves_nodes_and_bytes(judge, problem):
    judge, said = dataclasses.replace(judge, synthesis=SMALL), []
    rows = judge.table({3: CHOSEN}, [], said.append, randoms=1)
    policy = synthesize(with_alphabet(problem, CHOSEN), **SMALL)
    row = rows[0]
    assert (row.cells, row.solves) == (policy.cells.leaf_count, policy.statistics["solves"])
    assert row.nodes == tree_of(policy).node_count
    assert row.bytes == written_bytes(Plan.of(policy))
    assert said[3] == "policy of chosen 3 symbols: 1 of 3" and len(said) == 6


def test_a_policy_that_cannot_be_made_is_told_and_left_out(judge):
    judge = dataclasses.replace(judge, synthesis=SMALL | {"memory_limit": "1kB"})
    with pytest.warns(CapsynWarning) as record:
        rows = judge.table({3: CHOSEN}, [], randoms=1)
    (told,) = (str(one.message) for one in record)
    assert told.startswith("chosen 3 symbols, uniform 3 symbols, random 3 symbols: no cells, ")
    assert "solves, nodes, bytes, since `max_level` 1 may take" in told
    assert rows[0].cells is None and math.isfinite(rows[0].objective)


def test_lost_loops_make_the_objective_infinite_and_are_told(problem):
    strict = problem.replace(outside="error")
    loops = AlphabetLoops.of(strict, CANDIDATES, TrialOptions.of(trials=10, duration=4, rate=10))
    judge = Judge(strict, loops, Objective({"cost": 1.0}), Pool(CANDIDATES), 60, 5, None)
    row = judge.table({3: CHOSEN}, [])[0]
    assert row.objective == row.low == row.high == math.inf
    assert 0 < row.lost < 60 and row.success <= 1 - row.lost / 60
    assert 0 < row.figures["cost"] < math.inf  # of those that are not


def test_alphabets_that_the_rules_say_nothing_of_are_not_compared_with(judge, problem):
    fixed = problem.replace(outside=0)  # -2, which is not in this pool
    pool = Pool(Alphabet([-1.0, 0.0, 1.0, 3.0]))
    judge = dataclasses.replace(judge, problem=fixed, pool=pool)
    with pytest.warns(CapsynWarning) as record:
        rows = judge.table({1: Alphabet([-2.0])}, [], randoms=1)
    told = [str(one.message) for one in record]
    assert [text.partition(": ")[0] for text in told] == [
        "uniform 1 symbols cannot be compared with", "random 1 symbols cannot be compared with",
    ]  # fmt: skip
    assert [row.kind for row in rows] == ["chosen"]
    with pytest.raises(ProblemError, match="`alphabet` must have the symbol"):
        judge.table({3: CHOSEN}, [])
    with pytest.raises(ProblemError, match="`fresh` must be a whole number >= 2"):
        dataclasses.replace(judge, fresh=1)
