"""Candidates: their values and names, and problems with alphabets chosen among them."""

from __future__ import annotations

import itertools

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Box, Problem, Switching, problems
from capsyn.alphabets.candidates import (
    actuator_combinations,
    candidates_of,
    with_alphabet,
    without_dominated,
)
from capsyn.errors import ProblemError


def motor(**changes) -> Problem:
    """Return a problem of one input with three symbols."""
    options = {
        "name": "motor",
        "dynamics": lambda x, u: [x[1], u[0] - 0.1 * x[1]],
        "domain": Box([-2, -2], [2, 2]),
        "alphabet": Alphabet([-1.0, 0.0, 1.0], names=["back", "off", "ahead"]),
        "default": 0.0,
        "horizon": 0.5,
        "running_cost": lambda x: x[0] ** 2 + x[1] ** 2,
    }
    return Problem(**options | changes)


def test_the_rules_of_a_problem_follow_its_symbols_by_value():
    rules = Switching(
        price=[[0, 1, 2], [3, 0, 4], [5, 6, 0]],
        hold={"back": 0.2, "ahead": 0.3, "default": 0.1},
        forbidden=[("back", "ahead"), ("ahead", "back"), ("default", "ahead")],
    )
    problem = motor(switching=rules, outside="off")
    found = with_alphabet(problem, Alphabet([1.0, 0.0], names=["full", "off"]))
    assert found.switching.price == ((0, 6), (4, 0))
    assert found.switching.hold == {"full": 0.3, "default": 0.1}
    assert found.switching.forbidden == (("default", "full"),)
    assert found.outside == 1 and found.alphabet.names == ("full", "off")
    whole = with_alphabet(problem, problem.alphabet)
    assert whole.switching == rules and whole.outside == problem.outside


def test_prices_by_inputs_and_one_number_hold_for_any_symbols():
    for price in (0.5, "1%", {"u1": 2.0}):
        rules = Switching(price=price, hold={"u1": 0.2, "off": 0.1})
        found = with_alphabet(motor(switching=rules), Alphabet([0.5, 2.0]))
        assert found.switching.price == price and found.switching.hold == {"u1": 0.2}


@pytest.mark.parametrize(
    ("changes", "symbols", "message"),
    [
        ({"switching": Switching(price=[[0, 1, 2], [3, 0, 4], [5, 6, 0]])}, [0.0, 0.5],
         "`price` of the switching must be given by inputs, or as one number, where symbols are "
         "new; it says nothing of '0.5'"),
        ({"switching": Switching(hold=[1, 2, 3])}, [0.0, 0.5],
         "`hold` of the switching must be given by inputs, or as one number, where symbols are "
         "new; it says nothing of '0.5'"),
        ({"outside": "ahead"}, [0.0, -1.0],
         "`alphabet` must have the symbol that the problem gives outside its domain, 'ahead'; got "
         "2 others"),
        ({"switching": Switching(forbidden=[("back", "ahead")])}, [-1.0, 1.0],
         "`forbidden` must leave each symbol an exit; '-1' has none"),
    ],
)  # fmt: skip
def test_an_alphabet_that_the_rules_do_not_fit_is_named(changes, symbols, message):
    with pytest.raises(ProblemError) as caught:
        with_alphabet(motor(**changes), Alphabet(symbols))
    assert str(caught.value) == message


def test_other_inputs_are_refused():
    with pytest.raises(ProblemError, match=r"`alphabet` must have the inputs of the problem \(u1"):
        with_alphabet(motor(), Alphabet([[0.0, 1.0]]))


def test_a_riccati_tail_is_the_same_for_all_alphabets():
    problem = motor(tail="riccati", horizon=None)
    fewer = with_alphabet(problem, Alphabet([0.0, 1.0]))
    assert fewer.terminal is problem.terminal and fewer.horizon == problem.horizon


def test_equal_symbols_are_told_apart_by_their_names():
    own = Alphabet([0.0, 1.0, 1.0], names=["off", "left", "right"])
    rules = Switching(hold={"left": 1.0, "right": 2.0})
    chosen = Alphabet([0.0, 1.0], names=["off", "right"])
    found = with_alphabet(motor(alphabet=own, switching=rules), chosen)
    assert found.switching.hold == {"right": 2.0}
    with_alphabet(problems.get("docking"), problems.get("docking").alphabet)


def pushed(m=3, **changes) -> Problem:
    """Return a problem of two states and `m` inputs, affine in them."""
    options = {
        "name": "pushed",
        "dynamics": lambda x, u: [x[1] + u[0], sum((k + 1) * u[k] for k in range(m)) - x[0]],
        "domain": Box([-1, -1], [1, 1]),
        "alphabet": Alphabet(np.eye(m), names=[f"only {k}" for k in range(m)]),
        "default": np.zeros(m),
        "horizon": 0.5,
        "running_cost": lambda x: x[0] ** 2,
    }
    return Problem(**options | changes)


def test_a_box_is_a_grid_with_its_vertices_and_levels_that_read_well():
    found = candidates_of(motor(), Box([-5], [5]))
    assert found.values[:, 0].tolist() == list(range(-5, 6))
    assert found.names == ("-5", "-4", "-3", "-2", "back", "off", "ahead", "2", "3", "4", "5")
    grid = candidates_of(pushed(2), Box([0, -0.3], [1, 0.3], names=["u1", "u2"]))
    levels = [0, 0.25, 0.5, 0.75, 1], [-0.3, -0.15, 0, 0.15, 0.3]
    assert grid.values.tolist() == [list(each) for each in itertools.product(*levels)]
    assert "(0.25, -0.15)" in grid.names and "only 0" in grid.names
    assert len(candidates_of(pushed(3), Box([0] * 3, [1] * 3))) == 27
    uneven = candidates_of(pushed(2), Box([0, 2], [1, 2]), steps=[3, 4])
    assert uneven.values.tolist() == [[0, 2], [0.5, 2], [1, 2]], "a fixed input has one level"
    around = Box([-180], [180], periodic=[True])
    assert candidates_of(motor(), around, 4).values[:, 0].tolist() == [-180, -90, 0, 90]
    thirds = candidates_of(motor(), Box([0], [1]), 4)
    assert thirds.names == ("off", "0.333333", "0.666667", "ahead")


def test_a_grid_too_large_is_vertices_and_a_cross_where_the_model_is_affine():
    problem = pushed(3, default=[0.5, 0, 0])
    found = candidates_of(problem, Box([-1] * 3, [1] * 3), steps=21)
    vertices = np.array(list(itertools.product([-1, 1], repeat=3)))
    assert (found.values[:8] == vertices).all()
    cross = found.values[8:]
    assert len(cross) == 3 * 20 + 1 and (cross[0] == [0.5, 0, 0]).all()
    assert (np.count_nonzero(cross != [0.5, 0, 0], axis=1) <= 1).all()
    assert set(np.unique(cross[:, 2])) == set(np.round(np.linspace(-1, 1, 21), 12) + 0.0)
    curved = pushed(3, dynamics=lambda x, u: [x[1] + u[0] ** 2, u[1] * ca.fmax(u[2], 0)])
    with pytest.raises(ProblemError) as caught:
        candidates_of(curved, Box([-1] * 3, [1] * 3), steps=21)
    assert str(caught.value) == (
        "`candidates` must be a grid of at most 4096 symbols; got 21 x 21 x 21 = 9261: "
        "lower `steps`"
    )
    with pytest.raises(ProblemError, match="at most 4096 symbols; got 3 x 3 .* = 1594323: lower"):
        candidates_of(pushed(13), Box([-1] * 13, [1] * 13))


def test_of_equal_candidates_the_first_stays():
    given = Alphabet([2.0, -1.0, 2.0, 0.5], names=["fast", "slow", "again", "off"])
    found = candidates_of(motor(), given)
    assert found.values[:, 0].tolist() == [2.0, -1.0, 0.5]
    assert found.names == ("fast", "slow", "off") and found.inputs == ("u1",)
    assert candidates_of(motor(), [0.0, -0.0, 3.0]).names == ("off", "3")
    taken = candidates_of(motor(), Alphabet([5.0, 0.0], names=["off", "rest"]))
    assert taken.names == ("off", "rest"), "the names that are given stay"
    near = candidates_of(motor(), [0.1, 0.1000000001])
    assert near.names == ("0.1", "0.1000000001")


@pytest.mark.parametrize(
    ("given", "steps", "message"),
    [
        ([[1.0, 2.0]], None, "`candidates` must have shape (K, 1), one column for each input of "
         "the problem; got (1, 2)"),
        ([], None, "`candidates` must have shape (K, 1), one column for each input of the problem; "
         "got none"),
        ([0.0, np.nan], None, "`candidates` must be finite; got array([[ 0.], [nan]])"),
        ("all", None, "`candidates` must be numbers; got 'all'"),
        (3.0, None, "`candidates` must be a matrix of numbers; got array(3.)"),
        (np.arange(5000.0), None, "`candidates` must be at most 4096; got 5000"),
        ([0.0], 5, "`steps` must be left out where `candidates` is no box; got 5"),
        (Box([0], [1], names=["torque"]), None,
         "`candidates` must be of the inputs of the problem (u1); got torque"),
        (Box([0, 0], [1, 1]), None,
         "`candidates` must be of the inputs of the problem (u1); got x1, x2"),
        (Alphabet([0.0], inputs=["brake"]), None,
         "`candidates` must be of the inputs of the problem (u1); got brake"),
        (Alphabet([[0.0, 1.0]]), None,
         "`candidates` must be of the inputs of the problem (u1); got u1, u2"),
        (Box([0], [1]), 1, "`steps` must be a whole number >= 2; got 1"),
        (Box([0], [1]), [5, 5],
         "`steps` must be a whole number or 1 of them, one per axis; got [5, 5]"),
        (Box([0], [1]), 5000, "`steps` must be at most 4096; got 5000"),
    ],
)  # fmt: skip
def test_candidates_that_cannot_be_used_are_named(given, steps, message):
    with pytest.raises(ProblemError) as caught:
        candidates_of(motor(), given, steps)
    assert str(caught.value) == message


def test_combinations_of_actuators_leave_their_rest():
    own = Alphabet([[1, 0, 5], [1, 2, 5], [1, 3, 7], [0, 0, 5]], inputs=["valve", "fan", "lamp"])
    problem = pushed(3, alphabet=own, default=[1, 0, 5])
    found = actuator_combinations(problem, 2)
    expected = {
        "off": [1, 0, 5], "valve": [0, 0, 5], "fan=2": [1, 2, 5], "fan=3": [1, 3, 5],
        "lamp": [1, 0, 7], "valve+fan=2": [0, 2, 5], "valve+fan=3": [0, 3, 5],
        "valve+lamp": [0, 0, 7], "fan=2+lamp": [1, 2, 7], "fan=3+lamp": [1, 3, 7],
    }  # fmt: skip
    assert dict(zip(found.names, found.values.tolist())) == expected
    assert found.inputs == own.inputs
    law = pushed(3, alphabet=own, default=lambda x: [x[0], 0, 0])
    assert actuator_combinations(law, 1).names == (
        "off", "valve", "fan=2", "fan=3", "lamp"
    )  # fmt: skip
    mean = pushed(3, alphabet=own, default=[0.6, 1, 6])  # which no actuator can be at
    assert actuator_combinations(mean, 1).values[0].tolist() == [0, 0, 5]


def test_combinations_that_cannot_be_made_are_named():
    problem = pushed(16)
    with pytest.raises(ProblemError) as caught:
        actuator_combinations(problem, 7)
    assert str(caught.value) == (
        "`most` must make at most 4096 combinations, which 4 does; got 7, which makes 26333"
    )
    with pytest.raises(ProblemError, match="`most` must be a whole number >= 1 and <= 3; got 4"):
        actuator_combinations(pushed(3), 4)
    with pytest.raises(ProblemError, match="`problem` must be a capsyn.Problem; got 'tank'"):
        actuator_combinations("tank", 1)
    with pytest.raises(ProblemError, match="`problem` must have an alphabet in which inputs leave"):
        actuator_combinations(motor(alphabet=[0.0]), 1)


def test_of_163_combinations_of_thrusters_the_fewest_for_each_wrench_stay():
    problem = problems.get("docking")
    found = actuator_combinations(problem, 4)
    kept, instead = without_dominated(problem, found)
    assert (len(found), len(kept), len(instead)) == (163, 65, 98)
    from capsyn.problems.docking import wrench

    fewest: dict[tuple[float, ...], float] = {}
    for value in found.values.tolist():
        fewest.setdefault(tuple(wrench(value)), sum(value))
    stay = {tuple(wrench(v)): sum(v) for v in found.values[kept].tolist()}
    assert stay == fewest and len(stay) == len(kept)
    for gone, other in instead.items():
        assert other in kept and wrench(found.values[gone]) == wrench(found.values[other])


def doubled(**changes) -> Problem:
    """Return a problem whose second input does nothing."""
    return pushed(2, dynamics=lambda x, u: [x[1], u[0] - x[0] + 0 * u[1]], **changes)


def test_a_cheaper_candidate_of_more_effort_stays_and_so_do_those_to_keep():
    values = [[1, 0], [1, 1], [1, 2], [0, 1], [0, 0]]
    given = Alphabet(values, names=["plain", "warm", "hot", "idle", "off"])
    settings = {"settings": doubled().settings.__class__(control_weight=1.0)}
    problem = doubled(**settings)
    kept, instead = without_dominated(problem, given)
    assert kept.tolist() == [0, 4] and instead == {1: 0, 2: 0, 3: 4}
    kept, instead = without_dominated(problem, given, {"plain": 3, "warm": 1, "hot": 1})
    assert kept.tolist() == [0, 1, 4] and instead == {2: 1, 3: 4}
    kept, instead = without_dominated(problem, given, keep=[2, 3])
    assert kept.tolist() == [0, 2, 3, 4] and instead == {1: 0}
    kept, _ = without_dominated(doubled(), given, keep=[2])
    assert kept.tolist() == [2, 4], "without R all have the same effort, and one is to stay anyway"


def test_effects_that_rounding_hides_are_the_same_and_others_are_not():
    large = motor(dynamics=lambda x, u: [x[1] + 1e6, u[0] * 1e-7 + x[0]])
    near = Alphabet([0.1, 0.1 + 1e-15, 0.2])
    assert without_dominated(large, near)[0].tolist() == [0, 2]
    undefined = motor(dynamics=lambda x, u: [x[1], ca.sqrt(u[0]) + x[0]])
    kept, instead = without_dominated(undefined, Alphabet([-1.0, 0.0, 1.0, -2.0]))
    assert kept.tolist() == [0, 1, 2] and instead == {3: 0}, "neither has an effect"
