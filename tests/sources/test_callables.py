"""Callables and trained agents as labelling functions."""

import warnings

import numpy as np
import pytest

from capsyn import Alphabet, Box, Problem, Switching, compress, subdivide
from capsyn.errors import ProblemError
from capsyn.sources.callables import labels_of, problem_policy

BOX = Box([-1, -1], [1, 1])
ALPHABET = Alphabet([[-1, 0], [0, 0], [1, 0.1]])


def law(x):
    return (x[..., 0] > 0.3).astype(int) + (x[..., 1] > 0)


class Agent:
    """What trained agents look like: `predict` of one or many observations gives a pair."""

    def predict(self, observation, state=None, deterministic=False):
        assert deterministic
        return law(np.asarray(observation)), state


class Plain:
    def predict(self, observation):
        return law(np.asarray(observation))[..., None]


@pytest.mark.parametrize(
    "controller, options",
    [
        (law, {}),
        (lambda x: law(x).astype(float), {}),
        (Agent(), {}),
        (Plain(), {}),
        (Agent(), {"batched": False}),
        (lambda x: int(law(x)), {"batched": False}),
        (lambda x: ALPHABET.values[law(x)], {"actions": "controls"}),
        (lambda x: ALPHABET.values[law(x)].astype(np.float32), {"actions": "controls"}),
        (lambda x: ALPHABET.values[law(x)], {"actions": "controls", "batched": False}),
        (lambda o: law(o[..., ::-1] / 2), {"observation": lambda x: 2 * x[:, ::-1]}),
    ],
)
def test_every_kind_gives_the_law(controller, options):
    label, states = labels_of(controller, ALPHABET, **options), BOX.sample(300, 1)
    np.testing.assert_array_equal(label(states), law(states))


def test_policies_and_trees_come_from_them():
    label = labels_of(Agent(), ALPHABET)
    policy = subdivide(label, BOX, ALPHABET, max_level=3)
    states = BOX.sample(5000, 2)
    assert (policy(states) == law(states)).mean() > 0.97
    tree = compress(policy, "linear", controller=label, agreement=0.97, states=5000)
    assert tree.guarantee.controller == "function" and tree.guarantee.reached


@pytest.mark.parametrize(
    "controller, options, words",
    [
        (lambda x: np.full(len(x), 3), {},
         r"`controller` must return symbols from -1 to 2; got 3 at state \[0.5, -0.5\]"),
        (lambda x: np.array([0, 5]), {}, r"got 5 at state \[0.25, 0.75\]"),
        (lambda x: np.array([0, 0.5]), {}, r"got 0.5 at state \[0.25, 0.75\]"),
        (lambda x: np.array([0, np.nan]), {}, r"got nan at state \[0.25, 0.75\]"),
        (lambda x: ALPHABET.values[[0, 1]] + 0.01, {"actions": "controls"},
         r"controls of the alphabet \(\(-1, 0\), .*\); got \[-0.99, 0.01\] at state \[0.5, -0.5\]"),
        (lambda x: np.zeros(3, int), {}, r"actions of shape \(2,\); got int64 of shape \(3,\)"),
        (lambda x: ["a", "b"], {}, "actions of shape"),
        (lambda x: [[1, 2], [3]], {}, "`controller` failed at 2 states, .*ValueError"),
        (lambda x: [1] * round(4 * x[0]), {"batched": False}, "actions of shape .* from 2 calls"),
        (lambda x: None, {"batched": False}, "from 2 calls"),
        (lambda x: np.zeros(2), {"actions": "controls"}, r"actions of shape \(2, 2\)"),
        (lambda x: 1 / 0, {}, r"`controller` failed at 2 states, the first \[0.5, -0.5\]: "
         "ZeroDivisionError: division by zero"),
        (lambda x: {0.5: 0}[x[0]], {"batched": False},
         r"`controller` failed at state \[0.25, 0.75\]: KeyError: "),
        (law, {"observation": lambda x: x[:1]}, "`observation` must return 2 observations; got 1"),
        (law, {"observation": lambda x: None}, "must return 2 observations; got None"),
        (law, {"observation": lambda x: np.array(3)}, "must return 2 observations; got array"),
        (law, {"observation": lambda x: x[5]},
         r"`observation` failed at 2 states, the first \[0.5, -0.5\]: IndexError"),
    ],
)  # fmt: skip
def test_wrong_actions_are_named_with_their_state(controller, options, words):
    with pytest.raises(ProblemError, match=words) as error:
        labels_of(controller, ALPHABET, **options)(np.array([[0.5, -0.5], [0.25, 0.75]]))
    assert ("failed" in str(error.value)) == (error.value.__cause__ is not None)


@pytest.mark.parametrize(
    "arguments, options, words",
    [
        ((3, ALPHABET), {}, "`controller` must be a function of states or have a method predict"),
        ((law, [0, 1]), {}, "`alphabet` must be a capsyn.Alphabet"),
        ((law, ALPHABET), {"actions": "angles"}, "`actions` must be one of"),
        ((law, ALPHABET), {"observation": 3}, "`observation` must be a function"),
    ],
)
def test_bad_arguments_are_named(arguments, options, words):
    with pytest.raises(ProblemError, match=words):
        labels_of(*arguments, **options)


def test_problem_policy_wants_a_problem():
    with pytest.raises(ProblemError, match="`problem` must be a capsyn.Problem"):
        problem_policy(law, BOX)


def test_whole_numbers_are_no_controls_between_them():
    states = np.zeros((3, 1))
    for value, controls in ((0, [-0.5, 0.5]), (1, [-1.7, 1.7])):
        label = labels_of(
            lambda x, v=value: np.full(len(x), v), Alphabet(controls), actions="controls"
        )
        with pytest.raises(ProblemError, match="must return controls of the alphabet"):
            label(states)


def test_actions_the_other_way_round_are_refused():
    alphabet = Alphabet([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    label = labels_of(
        lambda x: np.array([[1.0] * len(x), [-1.0] * len(x)]), alphabet, actions="controls"
    )
    with pytest.raises(ProblemError, match=r"actions of shape \(3, 2\)"):
        label(np.zeros((3, 1)))


def test_controllers_that_work_in_place_move_nothing():
    def controller(x):
        x -= 0.2
        return (x[:, 0] > 0).astype(int)

    states = np.array([[0.1], [0.3]])
    assert labels_of(controller, Alphabet([0, 1]))(states).tolist() == [0, 1]
    assert states.tolist() == [[0.1], [0.3]]


def test_only_predict_gives_a_pair():
    class Pair:
        def __init__(self, found):
            self.found = found

        def predict(self, observation):
            return self.found

    states = np.zeros((2, 1))
    alphabet = Alphabet([0, 1, 2])
    assert labels_of(Pair((np.array([2, 1]), None)), alphabet)(states).tolist() == [2, 1]
    assert labels_of(lambda x: (2, 1), alphabet)(states).tolist() == [2, 1]
    with pytest.raises(ProblemError, match=r"actions of shape \(2,\); got float64 of shape \(0,\)"):
        labels_of(Pair(()), alphabet)(states)


def test_controls_beyond_half_precision_are_no_symbols():
    label = labels_of(
        lambda x: np.full(len(x), np.inf, np.float16), Alphabet([1e6, 2e6]), actions="controls"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ProblemError, match="controls of the alphabet .* got \\[inf\\]"):
            label(np.zeros((1, 1)))


def thermostat(**changes):
    """Return a problem of one state that the symbols move by -1, 0 and 1 a second."""
    return Problem(
        name="thermostat", dynamics=lambda x, u: [u[0]], domain=Box([-1], [1]),
        alphabet=Alphabet([-1, 0, 1], names=["cool", "off", "heat"]), default=0.0, horizon=1.0,
        terminal_cost=lambda x: x[0] ** 2, partitions=16, max_level=2, **changes,
    )  # fmt: skip


def band(x):
    """Return what follows each symbol: cool until 0, heat until 0, off within 0.5."""
    warm, cold = x[:, 0] > 0.5, x[:, 0] < -0.5
    rest = np.where(warm, 0, np.where(cold, 2, 1))
    return np.stack([np.where(x[:, 0] > 0, 0, 1), rest, np.where(x[:, 0] < 0, 2, 1), rest], axis=1)


@pytest.mark.parametrize("returns", ["symbols", "masks"])
def test_labels_for_each_symbol_in_force_make_rows(returns):
    forbidden = [("heat", "cool"), ("cool", "heat")]
    problem = thermostat(switching=Switching(price=3.0, hold=0.1, forbidden=forbidden))
    label = band if returns == "symbols" else lambda x: np.uint64(1) << band(x).astype(np.uint64)
    policy = problem_policy(label, problem, in_force=True, returns=returns)
    states = problem.domain.sample(2000, 1)
    for current in (-1, 0, 1, 2):
        agree = policy(states, current=current) == band(states)[:, current]
        assert agree[np.abs(states % 0.5)[:, 0] > 0.01].mean() > 0.99
    assert policy.remembers and policy.switching == problem.switching


def test_a_function_is_asked_where_its_decision_takes_effect():
    seen = []

    def sign(x):
        seen.append(x)
        return np.where(x[:, 0] > 0, 0, 2)

    policy = problem_policy(sign, thermostat(delay=0.2))
    at = [policy([x], current=c) for x, c in ((0.1, "cool"), (0.1, "heat"), (-0.1, "cool"),
          (-0.1, "heat"), (0.3, "cool"), (0.1, -1))]  # fmt: skip
    assert at == [2, 0, 2, 0, 0, 0] and max(x.max() for x in seen) > 1.19
    held = problem_policy(band, thermostat(delay=0.2), in_force=True)
    assert held([0.1], current="cool") == 1 and held([0.4], current="off") == 1
    assert held([0.3], current="cool") == 0


@pytest.mark.parametrize(
    "label, switching, options, words",
    [
        (law, Switching(price=1.0), {}, "`label` must be a FiniteControlSet of the problem, or"),
        (law, Switching(price="1%"), {}, "`label` must be a FiniteControlSet of the problem, or"),
        (law, Switching(forbidden=[("cool", "heat")]), {}, "`label` must be a FiniteControlSet"),
        (band, Switching(price="1%"), {"in_force": True}, "`switching` must have a price in numb"),
        (band, Switching(forbidden=[("off", "heat")]), {"in_force": True}, "must not take a forb"),
        (band, None, {"in_force": True, "returns": "scores"}, "`returns` must be symbols or masks"),
        (band, None, {"in_force": 1}, "`in_force` must be True or False; got 1"),
        (band, None, {"in_force": True, "leaves": "affine"}, "`leaves` must be constant where lab"),
        (lambda x: band(x)[:, :2], None, {"in_force": True}, r"return \(\d+, 4\) integers; got"),
        (lambda x: band(x) + 7, None, {"in_force": True}, "`label` must return symbols from -1 to"),
    ],
)
def test_labels_that_cannot_keep_the_switching_are_refused(label, switching, options, words):
    with pytest.raises(ProblemError, match=words) as error:
        problem_policy(label, thermostat(switching=switching), **options)
    assert "\n" not in str(error.value)


def test_holds_alone_are_for_closed_loops():
    problem = thermostat(switching=Switching(hold={"heat": 0.2}))
    policy = problem_policy(lambda x: np.where(x[:, 0] > 0, 0, 2), problem)
    assert not policy.remembers and policy.switching == problem.switching
    with pytest.raises(ProblemError, match="labels for 4 symbols in force, the default's last"):
        problem_policy(lambda x: band(x)[:, :2], thermostat(delay=0.1), in_force=True)
