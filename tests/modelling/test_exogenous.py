"""What is told beside the state: its box, its functions, and readings of both."""

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Ball, Box, SsacSettings, synthesize
from capsyn.errors import OutsideDomainError, ProblemError
from capsyn.modelling.exogenous import exogenous_array, joined, readings
from capsyn.modelling.problem import Problem
from capsyn.modelling.transcription import transcribe, transcribe_target
from support.told import ROOMS, STATES, TOLD, rates


def refused(build, *words):
    """Assert that something is refused in one line that begins and goes on with words."""
    with pytest.raises(ProblemError) as error:
        build()
    text = str(error.value)
    assert "\n" not in text and text.startswith(words[0])
    for word in words[1:]:
        assert word in text, text


@pytest.mark.parametrize(
    ("value", "got"),
    [
        (Ball([0, 0], 1.0), "Ball"),
        ([20, 25], "[20, 25]"),
        (([20], [25]), "([20], [25])"),
        ("setpoint", "'setpoint'"),
        (2, "2"),
    ],
)
def test_something_else_than_a_box(value, got):
    refused(lambda: ROOMS.replace(exogenous=value), "`exogenous` must be a capsyn.Box; got ", got)


def test_names_that_states_have():
    box = Box([20, 20], [25, 38], names=["setpoint", "T2"])
    refused(
        lambda: ROOMS.replace(exogenous=box),
        "`exogenous` must have names that no state has; 'T2' is a state, too",
    )
    unnamed = ROOMS.replace(exogenous=Box([20, 20], [25, 38]))
    assert unnamed.exogenous.names == ("w1", "w2") and unnamed.space.names[2:] == ("w1", "w2")
    states = Box([18, 18], [28, 28], names=["w2", "T"])
    refused(
        lambda: unnamed.replace(domain=states),
        "`exogenous` must have names",
        "'w2' is a state, too",
    )


def test_names_that_control_inputs_have():
    alphabet = Alphabet(ROOMS.alphabet.values, inputs=["stage", "valve"])
    box = Box([20, 20], [25, 38], names=["setpoint", "valve"])
    text = "`exogenous` must have names that no control input has; '{0}' is a control input, too"
    refused(lambda: ROOMS.replace(alphabet=alphabet, exogenous=box), text.format("valve"))
    unnamed = Box([20, 20], [25, 38], names=["setpoint", "u2"])
    refused(lambda: ROOMS.replace(exogenous=unnamed), text.format("u2"))


@pytest.mark.parametrize("name", ["trial", "time", "cost", "symbol"])
def test_names_that_columns_of_trajectories_have(name):
    box = Box([20, 20], [25, 38], names=["setpoint", name])
    refused(
        lambda: ROOMS.replace(exogenous=box),
        f"`exogenous` must have names that no column of trajectories has; got '{name}'",
    )


WRONG = {
    "dynamics": (lambda x, u: rates(x, u, [22, 30]), "(x: 2, u: 2, w: 2)", "x and u and w"),
    "running_cost": (lambda x: x[0] ** 2, "(x: 2, w: 2)", "x and w"),
    "terminal_cost": (lambda x: x[0] ** 2, "(x: 2, w: 2)", "x and w"),
    "target": (lambda x: x[0] < 20, "(x: 2, w: 2)", "x and w"),
    "default": (lambda x: [x[0], 0], "(x: 2, w: 2)", "x and w"),
}


@pytest.mark.parametrize("name", WRONG)
def test_functions_with_other_arguments(name):
    function, sizes, arguments = WRONG[name]
    text = f"`{name}` failed on symbols with sizes {sizes}: it must be a function of {arguments}"
    refused(lambda: ROOMS.replace(**{name: function}), text)
    with_more = {"dynamics": lambda x, u, w, p: x, "default": lambda x, u, w: u}
    wrong = with_more.get(name, lambda x, u, w: x[0])
    refused(lambda: ROOMS.replace(**{name: wrong}), text)


@pytest.mark.parametrize("name", WRONG)
def test_functions_of_w_where_nothing_is_told(name):
    changes = {
        "dynamics": lambda x, u: rates(x, u, [22, 30]),
        "running_cost": lambda x: x[0] ** 2,
    }
    problem = ROOMS.replace(exogenous=None, partitions=3, refinement=2, **changes)
    wrong = (lambda x, u, w: x) if name == "dynamics" else (lambda x, w: x[0])
    text = "and of w where there is `exogenous`"
    refused(lambda: problem.replace(**{name: wrong}), f"`{name}` failed", "function of x", text)


def test_inputs_that_there_are_not():
    refused(
        lambda: ROOMS.replace(running_cost=lambda x, w: x[0] + w[2]),
        "`running_cost` failed on symbols with sizes (x: 2, w: 2): an index is out of range",
    )
    refused(
        lambda: ROOMS.replace(dynamics=lambda x, u, w: [x[2], w[0]]),
        "`dynamics` failed",
        "an index is out of range",
    )
    refused(
        lambda: ROOMS.replace(dynamics=lambda x, u, w: [*rates(x, u, w), 0, 0]),
        "`dynamics` must return 2 component(s), one per state; got shape (4, 1)",
    )


def test_grids_have_an_entry_for_each_axis():
    problem = ROOMS.replace(partitions=(4, 4, 2, 3), refinement=(2, 3, 2, 2))
    assert problem.grid.counts == (8, 12, 4, 6)
    policy = synthesize(problem)
    assert policy.cells.counts == (8, 12, 4, 6) and policy.space.n == 4
    assert ROOMS.replace(partitions=5).partitions == (5,) * 4
    refused(lambda: ROOMS.replace(partitions=(3, 3)), "`partitions` must be", "4 of them")
    refused(lambda: ROOMS.replace(refinement=(3, 3)), "`refinement` must be", "4 of them")


def test_the_space_is_the_domain_and_after_it_what_is_told():
    assert ROOMS.space.names == (*STATES.names, *TOLD.names)
    assert ROOMS.space.units == ("degC",) * 4 and ROOMS.domain == STATES
    assert ROOMS.space.lower.tolist() == [18, 18, 20, 20]
    turning = joined(
        Box([0], [1], periodic=[True]), Box([0, 0], [1, 1], ["v", "w"], periodic=[False, True])
    )
    assert turning.periodic == (True, False, True)
    assert joined(STATES, None) is STATES


@pytest.mark.parametrize("box", [Ball([22, 22], 1.0), Box([20, 20], [23, 24])])
def test_targets_without_names_are_about_the_states_alone(box):
    problem = ROOMS.replace(target=box)
    assert problem.target.names == STATES.names
    assert transcribe_target(problem) == problem.target
    assert problem.replace(horizon=10.0).target.names == STATES.names


def test_targets_with_names_and_functions():
    named = Box([20, 21], [23, 24], names=["outdoor", "T1"])
    assert ROOMS.replace(target=named).target.names == ("outdoor", "T1")
    program = transcribe_target(ROOMS.replace(target=lambda x, w: ca.fabs(x[0] - w[0]) < 0.5))
    assert program.inputs == (("x", 4),)
    z = np.array([[22, 20, 22.4, 30], [22, 20, 22.6, 30]]).T
    assert program.evaluate(z)[0][0].tolist() == [1, 0]
    refused(lambda: ROOMS.replace(target=Ball([22], 1.0)), "`target` must have 4 dimension(s)")
    refused(lambda: ROOMS.replace(target=Box([0], [1], names=["T3"])), "`target` must name", "'T3'")


def test_replaced_problems_are_checked_anew():
    wider = ROOMS.replace(exogenous=Box([15, 10], [25, 38], names=["setpoint", "outdoor"]))
    assert wider.space.lower.tolist() == [18, 18, 15, 10] and ROOMS.space.lower[2] == 20
    refused(lambda: ROOMS.replace(exogenous=None), "`")
    refused(lambda: ROOMS.replace(exogenous=Box([20], [25])), "`dynamics` failed on symbols")


def test_default_laws_are_checked():
    law = ROOMS.replace(default=lambda x, w: [x[0] - w[0], 0.5])
    assert law.has_law and law.default_control.tolist() == [23 - 22.5, 0.5]
    assert not ROOMS.has_law and ROOMS.default_control.tolist() == [0.5, 0.5]
    text = "`on_no_descent` must be 'best' where `default` is a law"
    to_default = SsacSettings(on_no_descent="default")
    refused(lambda: law.replace(settings=to_default), text)
    refused(lambda: synthesize(law, settings=to_default), text)
    refused(lambda: ROOMS.replace(default=lambda x, w: x[0]), "`default` must return 2 components")
    refused(lambda: ROOMS.replace(default=lambda x, w: ca.SX.sym("q", 2)), "`default`", "'q")
    endless = ROOMS.replace(default=lambda x, w: [1 / (w[0] - 22.5), 0])
    refused(lambda: endless.default_control, "`default` must be finite at the middle")
    with pytest.raises(ProblemError, match="^`default` contains the constant NaN"):
        transcribe(ROOMS.replace(default=lambda x, w: [float("nan"), x[0]]))


def test_a_law_of_the_state_alone_where_nothing_is_told():
    problem = Problem(
        name="one",
        dynamics=lambda x, u: u - x,
        domain=Box([-1], [1]),
        alphabet=[-1, 1],
        default=lambda x: -x[0],
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2,
    )
    assert problem.has_law and problem.default_control.tolist() == [0.0]
    (u,) = transcribe(problem).prediction.law.evaluate(np.array([[0.25, -1.0]]))
    assert u.tolist() == [[-0.25, 1.0]]


def test_states_and_inputs_are_broadcast():
    rng = np.random.default_rng(0)
    for x_shape, w_shape, shape in [
        ((), (), ()),
        ((5,), (), (5,)),
        ((), (5,), (5,)),
        ((3, 1), (4,), (3, 4)),
        ((0,), (), (0,)),
    ]:
        x, w = rng.normal(size=(*x_shape, 2)), rng.normal(size=(*w_shape, 2))
        z = readings(x, w, STATES, TOLD)
        assert z.shape == (*shape, 4)
        assert np.array_equal(z[..., :2], np.broadcast_to(x, (*shape, 2)))
        assert np.array_equal(z[..., 2:], np.broadcast_to(w, (*shape, 2)))
        assert np.array_equal(readings(z, None, STATES, TOLD), z)
    assert readings([[1, 2]], None, STATES, None).tolist() == [[1, 2]]
    one = Box([0], [1], names=["d"])
    assert readings([[1, 2], [3, 4]], 5, STATES, one).tolist() == [[1, 2, 5], [3, 4, 5]]
    assert exogenous_array([5, 6], Box([0, 0], [1, 1])).tolist() == [5, 6]


def test_inputs_by_name_are_broadcast_too():
    z = readings([20, 21], {"outdoor": [30, 31, 32], "setpoint": 22}, STATES, TOLD)
    assert z.tolist() == [[20, 21, 22, t] for t in (30, 31, 32)]


@pytest.mark.parametrize(
    ("x", "w", "message"),
    [
        ([20, 21], None, "must be given: setpoint, outdoor (or readings of 4 numbers, the states"),
        ([20, 21, 22], None, "must be given: setpoint, outdoor"),
        (3.0, None, "must be given: setpoint, outdoor"),
        ([20, 21], [22], "must be numbers of shape (..., 2): setpoint, outdoor; got shape (1,)"),
        ([20, 21], 22, "must be numbers of shape (..., 2)"),
        ([[20, 21]] * 3, [[22, 30]] * 2, "must fit states of shape (3, 2); got shape (2, 2)"),
        ([20, 21], {"setpoint": 22}, "must give setpoint, outdoor; got setpoint"),
        ([20, 21], {"setpoint": 22, 3: 4}, "must give setpoint, outdoor; got setpoint, 3"),
        ([20, 21], ["a", "b"], "must be numbers"),
        ([20, 21], {"setpoint": "a", "outdoor": 1}, "must be numbers"),
        (
            [20, 21],
            {"setpoint": [1, 2], "outdoor": [1, 2, 3]},
            "must be numbers of shapes that fit each other; got (2,) and (3,)",
        ),
    ],
)
def test_readings_that_are_none(x, w, message):
    refused(lambda: readings(x, w, STATES, TOLD), f"`exogenous` {message}")


def test_inputs_where_nothing_is_told():
    refused(lambda: readings([1, 2], [3], STATES, None), "`exogenous` must be left out: nothing is")
    refused(lambda: readings([1, 2, 3], None, STATES, None), "`states` must")


def test_inputs_outside_their_box_follow_the_rule():
    policy = synthesize(ROOMS, partitions=2, max_level=0)
    x = policy.domain.sample(100)
    assert np.array_equal(policy(x, [30, 30]), policy(x, [25, 30]))
    assert (policy(x, [30, 30], outside=1) == 1).all() and not policy.covers(x, [30, 30]).any()
    for w in ([30, 30], [22, float("nan")]):
        with pytest.raises(OutsideDomainError, match="^reading 0 must "):
            policy(x, w, outside="error")
    with pytest.raises(OutsideDomainError, match="^reading 0 must be finite"):
        policy(x, [22, float("inf")])
    refused(lambda: policy(x), "`exogenous` must be given: setpoint, outdoor")
    refused(lambda: policy(x, "nearest"), "`exogenous` must be numbers")
