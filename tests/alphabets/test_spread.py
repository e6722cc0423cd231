"""Alphabets to compare with: evenly spread, and random."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from capsyn.alphabets.pace import Pace, duration
from capsyn.alphabets.spread import Pool, random_sets, uniform_set
from capsyn.modelling.alphabet import Alphabet

LEVELS = Alphabet(np.linspace(-5, 5, 11), inputs=["volt"], units=["V"])


def values(alphabet):
    return alphabet.values[:, 0].tolist()


def test_levels_of_a_box_are_evenly_spaced_whatever_its_grid():
    pool, rest = Pool(LEVELS, continuous=True), np.zeros(1)
    four = uniform_set(pool, 4, rest)
    assert values(four) == pytest.approx([-5, -5 / 3, 5 / 3, 5])
    assert four.names == ("-5", "-1.667", "1.667", "5") and four.inputs == ("volt",)
    assert values(uniform_set(pool, 1, np.array([0.4]))) == [0.0]
    kept = Pool(LEVELS, keep=(5, 6), continuous=True)  # 0 and 1
    assert values(uniform_set(kept, 4, rest)) == [-5, 0, 1, 5]


def test_levels_of_a_list_are_on_it_and_as_many_as_can_be():
    gears = Alphabet([0.0, 1.0, 2.0, 10.0], ["off", "one", "two", "ten"])
    assert uniform_set(Pool(gears), 3, np.zeros(1)).names == ("off", "two", "ten")
    assert len(uniform_set(Pool(gears), 4, np.zeros(1))) == 4
    assert len(uniform_set(Pool(gears), 9, np.zeros(1))) == 4
    assert "one" in uniform_set(Pool(gears, keep=(1,)), 2, np.zeros(1)).names


def test_candidates_of_several_inputs_stand_as_far_apart_as_can_be():
    grid = Alphabet(list(itertools.product((-1.0, 0.0, 1.0), (-100.0, 0.0, 100.0))))
    five = uniform_set(Pool(grid), 5, np.array([0.1, 8.0]))
    corners = list(itertools.product((-1.0, 1.0), (-100.0, 100.0)))
    assert set(map(tuple, five.values)) == {(0.0, 0.0), *corners}  # inputs count by their range
    kept = uniform_set(Pool(grid, keep=(1,)), 3, np.zeros(2))
    assert (-1.0, 0.0) in set(map(tuple, kept.values)) and (0.0, 0.0) in set(
        map(tuple, kept.values)
    )
    assert uniform_set(Pool(grid), 5, np.zeros(2)) == five


def test_random_alphabets_are_different_and_have_what_is_kept():
    pool = Pool(LEVELS, keep=(10, 5))
    sets = random_sets(pool, 4, 20, 7)
    assert len({one.values.tobytes() for one in sets}) == len(sets) > 10
    assert all(len(one) == 4 and {"0", "5"} <= set(one.names) for one in sets)
    assert [one.names for one in random_sets(pool, 4, 20, 7)] == [one.names for one in sets]
    assert sets != random_sets(pool, 4, 20, 8)
    assert [one.names for one in random_sets(pool, 11, 20, 7)] == [LEVELS.names]  # there is one
    assert [values(one) for one in random_sets(pool, 2, 5, 0)] == [[0.0, 5.0]]


def test_what_is_left_is_told_after_the_first_part():
    said = []
    pace = Pace(said.append, "judging", 3)
    pace.next("one")
    pace.start -= 100
    pace.next()
    assert said == ["judging one: 1 of 3", "judging: 2 of 3, about 3 min left"]
    Pace(None, "nothing", 1).next()
    assert [duration(s) for s in (0.4, 100, 121, 8000)] == [
        "about 0 s", "about 100 s", "about 2 min", "about 2 h",
    ]  # fmt: skip
