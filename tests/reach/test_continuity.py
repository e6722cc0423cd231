"""Where programs may jump, beside searches for jumps; bounds of smoothed roots, compiled."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsyn.modelling.transcription import program_from_casadi
from capsyn.native.bounds import box_bounds
from capsyn.programs.continuity import jump_conditions
from capsyn.programs.intervals import evaluate_intervals
from capsyn.programs.patterns import smoothed_root
from support.random_programs import random_program


def program_of(function, n=2):
    x = ca.SX.sym("x", n)
    return program_from_casadi(
        "f", ca.Function("f", [x], [ca.SX(function(x))]), (("x", n),), (("y", 1),)
    )


CONTINUOUS = {
    "abs": lambda x: ca.if_else(x[0] > 0, x[0], -x[0]),
    "slanted": lambda x: ca.if_else(2 * x[0] + x[1] < 1, 3 * x[1], 6 * x[1] + 6 * x[0] - 3),
    "bend": lambda x: ca.if_else(x[0] >= 0.5, 2 * x[0] - 0.5, x[0]),
    "of another": lambda x: ca.if_else(x[1] > x[0] ** 2, x[1], x[0] ** 2),
    "fmax": lambda x: ca.fmax(x[0], x[1] ** 2),
    "fabs": lambda x: ca.fabs(x[0]) * x[1],
    "none": lambda x: ca.sin(x[0]) * x[1],
    "the same": lambda x: ca.if_else(x[0] > 0, x[1], x[1]),
}
NOT_SEEN = {
    "dead zone": lambda x: ca.if_else(x[0] >= 0.5, x[0] - 0.5, 0),
    "nested": lambda x: ca.if_else(x[0] > 1, 1, ca.if_else(x[0] < -1, -1, x[0])),
}
"""Continuous, and yet taken for jumping: it costs proofs, and no truth."""
JUMPING = {
    "relay": lambda x: ca.if_else(x[0] > 0, 1, -1),
    "sign": lambda x: ca.sign(x[0]),
    "floor": lambda x: ca.floor(3 * x[0]),
    "ceil": lambda x: ca.ceil(x[1]),
    "shifted": lambda x: ca.if_else(x[0] > 0.1, x[0], -x[0]),
    "half": lambda x: ca.if_else(x[0] > 0, x[0], x[1]),
    "square": lambda x: ca.if_else(x[0] > 1, x[0] ** 2, x[0] + 1),
    "number": lambda x: (x[0] > x[1]) * x[0],
    "angle": lambda x: ca.atan2(x[0], x[1]),
    "remainder": lambda x: ca.fmod(x[0], 0.7),
    "copysign": lambda x: ca.copysign(x[1], x[0]),
    "and": lambda x: ca.if_else(ca.logic_and(x[0] > 0, x[1] > 0), x[0], 0),
}


def may_jump(program, low, high):
    """Return whether jumps are not ruled out over a box (n,) to (n,)."""
    conditions = jump_conditions(program)
    ends = [np.array(end, dtype=float)[:, None] for end in (low, high)]
    (lower, upper), *_ = evaluate_intervals(conditions, tuple(ends))
    return bool((lower != upper).any() or np.isnan(lower).any())


@pytest.mark.parametrize("name", CONTINUOUS)
def test_what_meets_is_continuous(name):
    assert not may_jump(program_of(CONTINUOUS[name]), [-2, -2], [2, 2])


@pytest.mark.parametrize("name", NOT_SEEN)
def test_what_is_not_seen_to_meet_may_jump(name):
    program = program_of(NOT_SEEN[name])
    assert may_jump(program, [-2, -2], [2, 2])
    assert not len(jumps(program, np.random.default_rng(1)))


@pytest.mark.parametrize("name", JUMPING)
def test_what_jumps_may_jump(name):
    """Over all of a box, and over one around each place where values are found to differ."""
    program = program_of(JUMPING[name])
    assert may_jump(program, [-2, -2], [2, 2])
    places = jumps(program, np.random.default_rng(1))
    assert len(places)
    for place in places[:20]:
        assert may_jump(program, place - 1e-6, place + 1e-6)


def jumps(program, rng, pairs=4000, rounds=60):
    """Return states (J, n) at which values jump, by halving segments whose ends differ most."""
    n = program.input_count
    one, two = rng.uniform(-2, 2, (2, n, pairs))
    for _ in range(rounds):
        middle = (one + two) / 2
        with np.errstate(all="ignore"):
            a, m, b = (program.evaluate(x)[0].max(axis=0) for x in (one, middle, two))
        left = np.abs(m - a) >= np.abs(b - m)
        one, two = np.where(left, one, middle), np.where(left, middle, two)
    with np.errstate(all="ignore"):
        a, b = (program.evaluate(x)[0] for x in (one, two))
    far = (np.abs(a - b) > 1e-3).any(axis=0) & np.isfinite(a).all(axis=0) & np.isfinite(b).all(0)
    return ((one + two) / 2)[:, far].T


STEADY = (
    "add sub mul neg lt le eq ne not and or select floor sign fabs fmin fmax sin copysign"
).split()


@given(program=random_program(tuple(STEADY)), seed=st.integers(0, 1 << 30))
def test_random_programs_jump_only_where_told(program, seed):
    """Where a search finds a jump, not a pole, the conditions are not constant around it."""
    finite = [operands for name, *operands in program.instructions if name == "const"]
    if any(not np.isfinite(value) or abs(value) > 1e6 for (value,) in finite):
        return
    for place in jumps(program, np.random.default_rng(seed), 100)[:3]:
        reach = 1e-9 * (1 + np.abs(place))
        ends = (place - reach)[:, None], (place + reach)[:, None]
        bounds = np.array(evaluate_intervals(program, ends)[0])
        assert may_jump(program, place - reach, place + reach) or not np.isfinite(bounds).all()


def test_a_smoothed_root_is_found():
    program = program_of(lambda x: x[0] / ca.sqrt(ca.sqrt(x[0] * x[0] + 0.01)))
    name, z, divisor = program.instructions[-1]
    assert name == "div" and smoothed_root(program, z, divisor) == (0.01, 2)


@pytest.mark.parametrize(
    "other",
    [
        lambda x: x[0] / ca.sqrt(x[0] * x[0] - 0.01),
        lambda x: x[1] / ca.sqrt(x[0] * x[0] + 0.01),
        lambda x: x[0] / (x[0] * x[0] + 0.01),
        lambda x: x[0] / ca.sqrt(x[0] * x[0] + x[1]),
    ],
)
def test_other_quotients_are_none(other):
    program = program_of(other)
    name, z, divisor = program.instructions[-1]
    assert name == "div" and smoothed_root(program, z, divisor) is None


@pytest.mark.parametrize("roots", [1, 2, 3])
def test_bounds_of_smoothed_roots(roots):
    """Compiled they are as wide as by NumPy or wider, and tight; values are in both."""

    def smoothed(x):
        root = x[0] * x[0] + 0.02
        for _ in range(roots):
            root = ca.sqrt(root)
        return x[0] / root

    program = program_of(smoothed, 1)
    rng = np.random.default_rng(roots)
    middle = rng.normal(size=(1, 2000)) * 10.0 ** rng.uniform(-9, 3, 2000)
    half = np.abs(middle) * rng.random(2000) + 10.0 ** rng.uniform(-12, 1, 2000)
    low, high = middle - half, middle + half
    (one_low, one_high), (two_low, two_high) = (
        bound((low, high))[0]
        for bound in (lambda ends: evaluate_intervals(program, ends), box_bounds(program))
    )
    assert (two_low <= one_low).all() and (two_high >= one_high).all()
    exact = [np.array([program.evaluate(end)[0][0]]) for end in (low, high)]
    assert (one_low <= exact[0]).all() and (one_high >= exact[1]).all()
    for t in (0.1, 0.5, 0.77):
        values = program.evaluate(low + t * (high - low))[0]
        assert (one_low <= values).all() and (values <= one_high).all()
    size = 1e-13 * (np.abs(exact[0]) + np.abs(exact[1]))
    assert (two_low >= exact[0] - size).all() and (two_high <= exact[1] + size).all()
