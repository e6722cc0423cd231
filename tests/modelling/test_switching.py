"""Prices, least times and forbidden transitions, as a user states them."""

import numpy as np
import pytest

from capsyn import Alphabet, Problem, SsacSettings, Switching
from capsyn.errors import ProblemError
from capsyn.modelling.switching import SwitchRules
from support.closed_loops import relay_problem

ALPHABET = Alphabet([0, 2, -2], names=["off", "heat", "cool"])
DEFAULT = np.array([0.6])
INF = np.inf


def test_a_number_is_the_price_of_all_but_of_leaving_the_default():
    prices = Switching(price=0.5).prices(ALPHABET, DEFAULT)
    assert prices.tolist() == [[0, 0.5, 0.5, 0.5], [0.5, 0, 0.5, 0.5], [0.5, 0.5, 0, 0.5], [0] * 4]


def test_a_matrix_is_by_symbol_in_force_and_next():
    matrix = [[0, 1, 2], [3, 0, 4], [5, 6, 0]]
    prices = Switching(price=matrix).prices(ALPHABET, DEFAULT)
    assert prices[:3, :3].tolist() == matrix
    assert not prices[3].any() and not prices[:, 3].any()


def test_prices_and_times_of_inputs():
    alphabet = Alphabet([[0, 0], [1, 0], [2, 1]], inputs=["compressor", "valve"])
    switching = Switching(price={"compressor": 2, "valve": 0.5}, hold={"compressor": 5})
    prices = switching.prices(alphabet, np.array([0.5, 0]))
    assert prices[0].tolist() == [0, 2, 4.5, 1] and prices[1, 2] == 2.5
    assert switching.input_holds(alphabet).tolist() == [5, 0]
    assert not switching.holds(alphabet, np.zeros(2)).any()


def test_forbidden_transitions_are_infinite():
    switching = Switching(forbidden=[("heat", "cool"), ("default", "heat")])
    prices = switching.prices(ALPHABET, DEFAULT)
    assert np.argwhere(np.isinf(prices)).tolist() == [[1, 2], [3, 1]]


def test_shares_become_numbers():
    share = Switching(price="1.5%")
    assert share.has_share and share.with_spread(200.0).price == 3.0
    mixed = Switching(price={"a": "2%", "b": 7}).with_spread(50.0)
    assert mixed.price == {"a": 1.0, "b": 7.0} and not mixed.has_share


@pytest.mark.parametrize(
    ("hold", "default", "expected"),
    [
        (3, 0.6, [3, 3, 3, 3]),
        ([1, 2, 3], 0.6, [1, 2, 3, 0]),
        ([1, 2, 3], 2, [1, 2, 3, 2]),  # the default control is that of heat
        ({"heat": 10, "off": 5}, 0.6, [5, 10, 0, 0]),
        ({"heat": 10, "default": 4}, 2, [0, 10, 0, 4]),
    ],
)
def test_times_of_symbols(hold, default, expected):
    holds = Switching(hold=hold).holds(ALPHABET, np.array([default]))
    assert holds.tolist() == expected


def test_symbols_of_one_control_are_one_unless_they_cost_something():
    zeros = Alphabet([[0.0], [1.0], [0.0]], names=["low", "on", "high"])
    free = relay_problem(alphabet=zeros)
    assert SwitchRules.of(free).kinds.tolist() == [0, 1, 0, 0]
    matrix = [[0, 1, 3], [1, 0, 2], [3, 2, 0]]
    dear = free.replace(switching=Switching(price=matrix))
    assert SwitchRules.of(dear).kinds.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"price": -1}, r"`price` must be a finite number >= 0; got -1"),
        ({"price": np.nan}, r"`price` must be a finite number >= 0; got nan"),
        ({"price": "1"}, r"`price` must be a number >= 0 or a share such as \"1%\"; got '1'"),
        ({"price": "-1%"}, "must be a number >= 0 or a share"),
        ({"price": {"u1": -1}}, "`price of u1` must be a finite number >= 0"),
        ({"price": {"u2": 1}}, r"`price` must name inputs \(u1\); got 'u2'"),
        ({"price": [[0, -1], [0, 0]]}, "`price` must be >= 0 and finite everywhere"),
        ({"price": [[0, np.nan], [0, 0]]}, "`price` must be >= 0 and finite everywhere"),
        ({"price": [[1, 1], [0, 0]]}, "`price` must be 0 on its diagonal"),
        ({"price": [[0, 1, 1]]}, r"a matrix \(N, N\); got shape \(1, 3\)"),
        ({"price": np.zeros((3, 3))}, r"must be a matrix of shape \(2, 2\); got \(3, 3\)"),
        ({"hold": -1}, "`hold` must be a finite number >= 0; got -1"),
        ({"hold": [1, 2, 3]}, "one for each symbol; got 3"),
        ({"hold": {"up": 1}}, r"`hold` must name symbols and inputs \(1, -1, u1, default\)"),
        ({"forbidden": [("1", "down")]}, r"`forbidden` must name symbols .*; got 'down'"),
        ({"forbidden": ["1:-1"]}, "`forbidden` must be pairs of names"),
        ({"forbidden": [("1", "1")]}, "pairs of two names; got '1' twice"),
        ({"forbidden": [("1", "-1")]}, "must leave each symbol an exit; '1' has none"),
        ({"forbidden": [("default", "1"), ("default", "-1")]}, "must leave the start a symbol"),
    ],
)
def test_bad_input_is_told_in_one_line(changes, message):
    with pytest.raises(ProblemError, match=message) as told:
        relay_problem(switching=Switching(**changes))
    assert "\n" not in str(told.value)


def three(**changes) -> Problem:
    return relay_problem(alphabet=ALPHABET, settings=SsacSettings(steps=4), **changes)


def test_what_does_not_fit_a_problem():
    forbid = Switching(forbidden=[("heat", "cool")])
    with pytest.raises(ProblemError, match="got 'heat' to 'cool'"):
        three(switching=forbid, outside="cool")
    with pytest.raises(
        ProblemError, match="`min_dwell` must not be given together with the `hold`"
    ):
        three(switching=Switching(hold=1), min_dwell=1)
    with pytest.raises(ProblemError, match="`switching` must be a capsyn.Switching; got 3"):
        three(switching=3)
    with pytest.raises(ProblemError, match="`delay` must be a finite number >= 0; got -1"):
        three(delay=-1)
    both = Alphabet([0, 1], names=["a", "b"], inputs=["a"])
    with pytest.raises(ProblemError, match="'a' is the name of both"):
        relay_problem(alphabet=both, switching=Switching(hold={"a": 1}))
