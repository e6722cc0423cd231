"""Boxes, their lattice, and balls."""

import json
import math
import pickle
import re

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from capsyn import Alphabet, Ball, Box, subdivide
from capsyn.errors import ProblemError
from capsyn.modelling.exogenous import check_exogenous
from capsyn.modelling.grid import MAX_COUNT
from capsyn.modelling.targets import check_target, describe_target

NAN, INF = float("nan"), float("inf")

REFUSED = [
    ((0, 1), {}, "`lower` must be a list of numbers; got 0"),
    (([0], ["one"]), {}, "`upper` must be numbers; got ['one']"),
    (([0], [NAN]), {}, "`upper` must be finite; got [nan]"),
    (([-INF], [0]), {}, "`lower` must be finite; got [-inf]"),
    (([0], [None]), {}, "`upper` must be finite; got [None]"),
    (([], []), {}, "`lower` and `upper` must have one entry per state; got 0 and 0"),
    (([0, 0], [1]), {}, "`lower` and `upper` must have one entry per state; got 2 and 1"),
    (([0, 1], [1, 0]), {}, "`upper` must be at least `lower` on axis 'x2'; got [1.0, 0.0]"),
    (
        ([2], [1]),
        {"names": ["v"]},
        "`upper` must be at least `lower` on axis 'v'; got [2.0, 1.0]",
    ),
    (
        ([-1.7e308], [1.7e308]),
        {},
        "`lower` and `upper` must be within +-1e+290 on axis 'x1'; got [-1.7e+308, 1.7e+308]",
    ),
    (
        ([-2e290], [0]),
        {"names": ["v"], "periodic": [True]},
        "`lower` and `upper` must be within +-1e+290 on axis 'v'; got [-2e+290, 0.0]",
    ),
    (([0], [1]), {"names": "a"}, "`names` must be 1 printable string(s); got 'a'"),
    (
        ([0, 0], [1, 1]),
        {"names": ["a", "a"]},
        "`names` must be non-empty and distinct; got ('a', 'a')",
    ),
    (([0], [1]), {"units": [1]}, "`units` must be 1 printable string(s); got [1]"),
    (([0], [1]), {"periodic": True}, "`periodic` must be 1 boolean(s); got True"),
    (([0], [1]), {"periodic": [1]}, "`periodic` must be 1 boolean(s); got [1]"),
    (([0], [1]), {"periodic": [True, False]}, "`periodic` must be 1 boolean(s); got [True, False]"),
    (([0], [1]), {"periodic": np.array(True)}, "`periodic` must be 1 boolean(s); got array(True)"),
]


def test_a_box_may_fix_a_state_but_no_domain_does():
    start = Box([0, 1], [2, 1], names=["x", "v"])
    assert (start.sample(9)[:, 1] == 1).all() and np.ptp(start.sample(9)[:, 0]) > 0
    assert describe_target(start, start) == "x in [0, 2], v = 1"
    message = "`upper` must be greater than `lower` on axis 'v' of `{}`; got [1.0, 1.0]"
    for name, make in {
        "domain": lambda: subdivide(lambda x: x[:, 0], start, 2),
        "exogenous": lambda: check_exogenous(start, Box([0], [1]), Alphabet([0, 1])),
        "target": lambda: check_target(start, start),
    }.items():
        with pytest.raises(ProblemError, match=re.escape(message.format(name))):
            make()


@pytest.mark.parametrize(("arguments", "options", "message"), REFUSED)
@pytest.mark.filterwarnings("error")
def test_box_refusals(arguments, options, message):
    with pytest.raises(ProblemError) as caught:
        Box(*arguments, **options)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("center", "radius", "message"),
    [
        (0.0, 1.0, "`center` must be a list of numbers; got 0.0"),
        ([NAN], 1.0, "`center` must be finite; got [nan]"),
        ([0.0], 0.0, "`radius` must be a finite number > 0; got 0.0"),
        ([0.0], INF, "`radius` must be a finite number > 0; got inf"),
        ([0.0], "wide", "`radius` must be a number > 0; got 'wide'"),
        ([], 1.0, "`center` must have one entry per state; got none"),
    ],
)
def test_ball_refusals(center, radius, message):
    with pytest.raises(ProblemError) as caught:
        Ball(center, radius)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a"], "`names` must be 2 printable string(s); got ['a']"),
        ("ab", "`names` must be 2 printable string(s); got 'ab'"),
        (["a", 1], "`names` must be 2 printable string(s); got ['a', 1]"),
        (["a", "a"], "`names` must be non-empty and distinct; got ('a', 'a')"),
        (["a", ""], "`names` must be non-empty and distinct; got ('a', '')"),
    ],
)
def test_names_of_a_ball_are_checked(names, message):
    with pytest.raises(ProblemError) as caught:
        Ball([0, 0], 1, names=names)
    assert str(caught.value) == message


def test_names_of_a_ball_are_part_of_it():
    ball = Ball([0, 1], 2, names=["a", "b"])
    assert ball.names == ("a", "b") and ball.n == 2 and Ball([0, 1], 2).names is None
    assert ball == Ball([0, 1], 2, names=("a", "b"))
    assert ball != Ball([0, 1], 2) != Ball([0, 1], 2, names=["b", "a"]) != ball
    assert "names" not in Ball([0, 1], 2).to_json()


def test_box_defaults_and_widths():
    box = Box([0, -5], [2, 5], periodic=np.array([True, False]))
    assert box.n == 2 and box.names == ("x1", "x2") and box.units == ("", "")
    assert box.periodic == (True, False) and all(type(p) is bool for p in box.periodic)
    assert box.widths.tolist() == [2.0, 10.0]


def test_bounds_are_read_only_copies():
    lower = np.zeros(1)
    box, ball = Box(lower, [1]), Ball(lower, 1)
    lower[0] = 0.5
    assert box.lower[0] == 0.0 and ball.center[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        box.lower[0] = 0.5
    with pytest.raises(ValueError, match="read-only"):
        ball.center[0] = 0.5


def test_box_equality_needs_every_field():
    options = {"names": ["a"], "units": ["m"], "periodic": [False]}
    base = Box([0], [1], **options)
    others = [
        Box([0.5], [1], **options),
        Box([0], [2], **options),
        Box([0], [1], **{**options, "names": ["b"]}),
        Box([0], [1], **{**options, "units": ["s"]}),
        Box([0], [1], **{**options, "periodic": [True]}),
    ]
    assert all(base != other for other in others) and base != Ball([0], 1)
    assert base == Box((0.0,), np.array([1]), **options)
    assert Ball([0], 1) == Ball([0.0], 1.0) != Ball([0], 2) and Ball([0], 1) != Ball([1], 1)


@pytest.mark.parametrize(
    "region",
    [
        Box([0, -1 / 3], [2 * math.pi, 1e290], ["θ", "v"], ["rad", "m/s"], [True, False]),
        Ball([0.1, -1e-300], 1 / 3),
        Ball([0.1, -1e-300], 1 / 3, names=["θ", "v"]),
    ],
)
def test_json_and_pickle_round_trips_are_equality(region):
    again = type(region)(**json.loads(json.dumps(region.to_json(), allow_nan=False)))
    assert again == region and hash(again) == hash(region)
    assert pickle.loads(pickle.dumps(region)) == region


@st.composite
def axes(draw, periodic=None):
    """Boxes of one axis of any scale, with a count of steps that floating point can tell apart."""
    scale = 10.0 ** draw(st.sampled_from([-285, -30, -3, 0, 0, 0, 3, 30, 285]))
    lower = draw(st.floats(-10, 10)) * scale
    width = draw(st.floats(1e-6, 1e3)) * scale
    assume(lower < lower + width)
    count = draw(st.one_of(st.integers(1, 100), st.integers(1, MAX_COUNT)))
    box = Box(
        [lower], [lower + width], periodic=[draw(st.booleans()) if periodic is None else periodic]
    )
    try:
        box.check_resolution([count])
    except ProblemError:
        assume(False)
    return box, count


@given(axes(), st.data())
def test_a_face_belongs_to_the_step_above_it(axis, data):
    box, count = axis
    some = data.draw(st.lists(st.integers(0, count - 1), min_size=1, max_size=20))
    k = np.array([0, count - 1, *some])
    faces = box.faces(0, k, count)
    above = box.faces(0, k + 1, count)
    last = np.nextafter(above, -INF)
    assert (faces < last).all()
    for states in (faces, np.nextafter(faces, INF), last, faces + (above - faces) / 2):
        assert np.array_equal(box.locate(states[:, None], [count])[:, 0], k)


@given(axes())
@example((Box([-3.6], [2.7]), 7))  # lower + (upper - lower) is rounded to more than upper
@example((Box([-9.6], [0.2], periodic=[True]), 7))  # and here to less
def test_the_lattice_ends_at_the_bounds(axis):
    box, count = axis
    low, high = box.lower[0], box.upper[0]
    assert box.faces(0, np.array([0, count]), count).tolist() == [low, high]
    top = 0 if box.periodic[0] else count - 1
    found = box.locate(np.array([[low], [np.nextafter(high, -INF)], [high]]), [count])
    assert found[:, 0].tolist() == [0, count - 1, top]


@given(axes(False), st.floats(0, 1e6))
def test_beyond_an_ordinary_axis_the_nearest_step_answers(axis, distance):
    box, count = axis
    low, high = box.lower[0], box.upper[0]
    states = np.array([[low - distance * (high - low)], [high + distance * (high - low)]])
    states = np.vstack([states, [[-INF], [INF]]])
    assert box.locate(states, [count])[:, 0].tolist() == [0, count - 1] * 2


@given(axes(True), st.floats(allow_nan=False, allow_infinity=False))
@example((Box([0], [2 * math.pi], periodic=[True]), 9), -1e-20)
@example((Box([0], [2 * math.pi], periodic=[True]), 9), -5e-324)
@example((Box([-1], [1], periodic=[True]), 9), 1.7976931348623157e308)
@example((Box([-3], [0.1], periodic=[True]), 9), -1.7976931348623157e308)
@example((Box([-1e290], [1e290], periodic=[True]), 9), 1.7976931348623157e308)
@example((Box([0], [1e290], periodic=[True]), 9), -1.7976931348623157e308)
def test_wrapping_ends_inside_and_is_done_once(axis, state):
    box, count = axis
    states = np.array([[state]])
    wrapped = box.wrap(states)
    assert states[0, 0] == state, "the input must stay as it is"
    assert box.lower[0] <= wrapped[0, 0] < box.upper[0]
    assert np.array_equal(box.wrap(wrapped), wrapped)
    k = box.locate(states, [count])
    assert 0 <= k[0, 0] < count and np.array_equal(box.locate(wrapped, [count]), k)


@given(axes(True), st.floats(0, 1, exclude_max=True))
def test_a_state_inside_is_not_moved_by_wrapping(axis, share):
    box, _ = axis
    state = box.lower + share * box.widths
    assume(state[0] < box.upper[0])
    assert np.array_equal(box.wrap(state[None])[0], state)


def test_a_wrapped_state_that_rounds_to_upper_becomes_lower():
    box = Box([0, -math.pi], [2 * math.pi, math.pi], periodic=[True, True])
    tiny = np.array([[-1e-20, 0.0], [np.nextafter(0, -1), math.pi], [2 * math.pi, -3 * math.pi]])
    assert box.wrap(tiny).tolist() == [[0.0, 0.0], [0.0, -math.pi], [0.0, -math.pi]]
    assert box.locate(tiny, [9, 4]).tolist() == [[0, 2], [0, 0], [0, 0]]


@given(st.integers(-(2**20), 2**20), st.integers(0, 63))
def test_whole_turns_change_nothing(turns, k):
    box = Box([-2], [6], periodic=[True])  # all exact in floating point
    state = -2 + 8 * (k / 64) + 8 * turns
    assert box.locate(np.array([[state]]), [64])[0, 0] == k


def test_locate_against_a_search_among_all_faces():
    rng = np.random.default_rng(3)
    box = Box([-1.3, 0.1, 1e6], [0.7, 0.3, 1e6 + 1])
    counts = (7, 48, 1000)
    states = box.sample(20_000, seed=4)
    near = [box.faces(i, rng.integers(0, counts[i] + 1, 5000), counts[i]) for i in range(3)]
    near = np.stack(near, axis=1)
    states = np.vstack([states, near, np.nextafter(near, -INF), np.nextafter(near, INF)])
    found = box.locate(states, counts)
    for i, count in enumerate(counts):
        faces = box.faces(i, np.arange(count + 1), count)
        wanted = np.searchsorted(faces, states[:, i], side="right") - 1
        assert np.array_equal(found[:, i], np.clip(wanted, 0, count - 1))


def test_locate_takes_no_states():
    box = Box([0, 0], [1, 1], periodic=[True, False])
    assert box.locate(np.empty((0, 2)), [3, 3]).shape == (0, 2)


def test_points_are_faces_on_every_axis():
    box = Box([0, -1], [1, 2])
    points = box.points(np.array([[0, 0], [4, 3], [1, 2]]), (4, 3))
    assert points.tolist() == [[0, -1], [1, 2], [0.25, 1.0]]


def test_contains_bounds_and_refuses_what_is_not_finite():
    box = Box([0, 0], [1, 1], periodic=[True, False])
    states = [
        [[0, 0], True],
        [[1, 1], True],
        [[1e9, 0.5], True],
        [[-1e300, 0.5], True],
        [[0.5, np.nextafter(1, 2)], False],
        [[0.5, -5e-324], False],
        [[0.5, NAN], False],
        [[NAN, 0.5], False],
        [[INF, 0.5], False],
        [[0.5, -INF], False],
    ]
    found = box.contains(np.array([s for s, _ in states], dtype=float))
    assert found.tolist() == [wanted for _, wanted in states]


@pytest.mark.parametrize(
    ("box", "counts", "fits"),
    [
        (Box([0], [1]), [2**31 - 1], True),
        (Box([1e6], [1e6 + 1]), [1_000_000], True),
        (Box([1e9], [1e9 + 1]), [1_000_000], True),
        (Box([1e9], [1e9 + 1]), [8_000_000], False),
        (Box([-1e9, 0], [1 - 1e9, 1]), [1, 9], True),
        (Box([0, 1e15], [1, 1e15 + 1]), [9, 2], False),
        (Box([0], [1e-290]), [100], True),
        (Box([0], [1e-320]), [9], False),
        (Box([-1e290], [1e290]), [2**31 - 1], True),
    ],
)
@pytest.mark.filterwarnings("error")
def test_check_resolution(box, counts, fits):
    if fits:
        box.check_resolution(counts)
        for i, count in enumerate(counts):
            faces = box.faces(i, np.arange(min(count, 1000)), count)
            assert (np.diff(faces) > 0).all()
    else:
        with pytest.raises(ProblemError, match="`max_level` is too high: axis 'x[12]' would be"):
            box.check_resolution(counts)


def test_samples_are_seeded_and_inside():
    box = Box([-1, 5], [1, 9])
    states = box.sample(1000, seed=1)
    assert states.shape == (1000, 2) and box.contains(states).all()
    assert np.array_equal(states, box.sample(1000, seed=1))
    assert not np.array_equal(states, box.sample(1000, seed=2))
    assert np.allclose(states.mean(axis=0), [0, 7], atol=0.2)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_samples_of_a_ball_are_even_in_it(n):
    center = np.arange(n) + 0.5
    ball = Ball(center, 2.0)
    points = ball.sample(4000, seed=3)
    off = np.linalg.norm(points - center, axis=1)
    assert points.shape == (4000, n) and (off <= 2.0).all()
    np.testing.assert_allclose(points.mean(axis=0), center, atol=0.1)
    # the share within a radius goes with its n-th power
    for radius in (0.8, 1.5, 1.9):
        assert (off <= radius).mean() == pytest.approx((radius / 2) ** n, abs=0.03)


@pytest.mark.parametrize("region", [Ball([0, 1, 2], 3), Box([0, 0, 0], [1, 2, 3])])
@pytest.mark.parametrize("seed", [0, 7, [3, 0], [3, 0, 1]])
def test_the_first_samples_do_not_depend_on_how_many_there_are(region, seed):
    many = region.sample(100, seed)
    assert np.array_equal(region.sample(100, seed), many)
    for count in (0, 1, 37):
        assert np.array_equal(region.sample(count, seed), many[:count])
    assert not np.isin(region.sample(100, [3, 5]), many).any()
