"""Candidates: their values and names, and problems with alphabets chosen among them."""

from __future__ import annotations

import pytest

from capsyn import Alphabet, Box, Problem, Switching, problems
from capsyn.alphabets.candidates import with_alphabet
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
         "`price` must be given by inputs, or as one number, where symbols are new; it says nothing"
         " of '0.5'"),
        ({"switching": Switching(hold=[1, 2, 3])}, [0.0, 0.5],
         "`hold` must be given by inputs, or as one number, where symbols are new; it says nothing "
         "of '0.5'"),
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
