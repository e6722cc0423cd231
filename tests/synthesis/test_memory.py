"""Policies that remember the symbol in force, against argmins of scores plus prices."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from capsyn import Alphabet, Box, Policy, Problem, SsacSettings, Switching, problems, synthesize
from capsyn.cells.masks import holds, members
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import CapsynWarning, PolicyFormatError, ProblemError
from capsyn.subdivision.cell_points import CellPoints
from support.policy_files import assert_equal, rewrite

PENDULUM = problems.plain("cart-pendulum").replace(switching=None, max_level=2)
TANK = problems.plain("double-tank-a").replace(switching=None, max_level=2)


def priced(problem, price, **changes):
    return problem.replace(switching=Switching(price=price, **changes))


def test_points(policy):
    """Return the test points (C, P, n) of the constant cells that are not mixed, and their rows."""
    cells, boxes = policy.cells, policy.cells.boxes()
    pure = ~np.isin(boxes.places, cells.mixed_cells)
    offsets = CellPoints().offsets(cells.n) / 2
    lower, size = boxes.lower[pure], (boxes.upper - boxes.lower)[pure]
    places = (lower[:, None] + offsets * size[:, None]) / np.array(cells.counts)
    states = policy.domain.lower + places * policy.domain.widths
    return states, policy.transitions[boxes.labels[pure]]


test_points.__test__ = False


@pytest.mark.parametrize(
    ("problem", "switching"),
    [
        (PENDULUM, Switching(price="1%")),
        (TANK, Switching(price="2%")),
        (
            TANK,
            Switching(price="0.5%", forbidden=[(TANK.alphabet.names[0], TANK.alphabet.names[7])]),
        ),
        (
            TANK.replace(settings=SsacSettings(rule="steepest", on_no_descent="default")),
            Switching(price=np.arange(64.0).reshape(8, 8) * (1 - np.eye(8)) / 200),
        ),
    ],
    ids=["pendulum", "tank", "forbidden", "matrix"],
)
def test_rows_are_argmins_of_scores_plus_prices(problem, switching):
    policy = synthesize(problem.replace(switching=switching))
    states, rows = test_points(policy)
    controller, count = policy_controller(policy), len(policy.alphabet)
    flat = states.reshape(-1, policy.domain.n)
    solution = controller.solve(flat)
    scores = -controller.smooth_scores(solution)[:, 0]  # with the default's where it competes
    prices = policy.rules.prices[:, : scores.shape[1]]
    total = scores[:, None, :] + prices
    best, least = total.argmin(axis=2), np.sort(total, axis=2)
    clear = least[:, :, 1] - least[:, :, 0] > 1e-3 * np.ptp(scores, axis=1)[:, None]
    wanted = np.repeat(rows, states.shape[1], axis=0)
    assert clear.mean() > 0.8 and len(policy.transitions) > count + 1
    assert (best == wanted)[clear].all()
    assert not np.isinf(policy.rules.prices[np.arange(count + 1), rows]).any()


@pytest.mark.parametrize("problem", [PENDULUM, TANK], ids=["pendulum", "tank"])
def test_without_a_price_ties_alone_are_kept(problem):
    plain, kept = synthesize(problem), synthesize(priced(problem, 0.0))
    assert np.array_equal(kept.cells.entries >= 0, plain.cells.entries >= 0)
    states = problem.domain.sample(20_000, 1)
    masks = policy_controller(plain).masks(states)
    clear = members(masks, len(problem.alphabet) + 1).sum(axis=1) == 1
    in_mixed = np.isin(plain.cells.find(plain.domain.locate(states, plain.cells.counts)),
                       plain.cells.mixed_cells)  # fmt: skip
    for current in range(-1, len(problem.alphabet)):
        same = kept(states, current=current) == plain(states)
        assert same[clear & ~in_mixed].all()


def test_at_a_great_price_nothing_switches():
    for leaves in ("constant", "affine"):
        policy = synthesize(priced(PENDULUM, 1e12), leaves=leaves)
        states = policy.domain.sample(5000)
        for current in range(2):
            assert (policy(states, current=current) == current).all()
        assert set(policy(states)) == {0, 1}  # the first is free


def test_a_share_is_of_the_median_spread_of_scores():
    policy = synthesize(priced(PENDULUM, "2%"))
    controller = policy_controller(policy)
    scores = controller.smooth_scores(controller.solve(policy.domain.sample(2048, 1)))[:, 0]
    assert policy.switching.price == pytest.approx(0.02 * np.median(np.ptp(scores, axis=1)))


def test_affine_leaves_pay_prices():
    policy = synthesize(priced(TANK, "1%"), leaves="affine")
    assert policy.cells.affine.prices.min() > 0
    states = policy.domain.sample(20_000, 3)
    masks = policy_controller(policy).masks(states)
    for current in range(-1, 8):
        own = policy(states, current=current)
        assert np.array_equal(own, policy(states, current=current, backend="c"))
        assert holds(masks[:, current], own % 9).mean() > 0.94


def oscillator(**changes):
    """Return a linear oscillator, whose flows are matrix exponentials."""
    fields = {
        "name": "oscillator",
        "dynamics": lambda x, u: [x[1], -4 * x[0] - 0.3 * x[1] + u[0]],
        "domain": Box([-1, -2], [1, 2]),
        "alphabet": Alphabet([1.0, -1.0, 0.2]),
        "default": 0.0,
        "horizon": 0.8,
        "running_cost": lambda x: x[0] ** 2 + 0.1 * x[1] ** 2,
        "settings": SsacSettings(rule="steepest", control_weight=0.01, sample_time=0.05),
        "outside": "nearest",
        "max_level": 2,
    }
    return Problem(**fields | changes)


def flow(states, control, time):
    matrix = expm(np.array([[0, 1, 0], [-4, -0.3, control], [0, 0, 0]]) * time)
    return states @ matrix[:2, :2].T + matrix[:2, 2]


@pytest.mark.parametrize("switching", [None, Switching(price="1%")])
def test_a_delay_is_compensated_by_the_flow_under_the_symbol_in_force(switching):
    now = synthesize(oscillator(switching=switching))
    later = synthesize(oscillator(switching=switching, delay=0.1))
    ahead, behind = policy_controller(now), policy_controller(later)
    states = later.domain.sample(3000, 2)
    masks = behind.masks(states)
    for current, control in enumerate([1.0, -1.0, 0.2, 0.0]):
        there = ahead.masks(flow(states, control, 0.1))
        there = there if switching is None else there[:, current]
        assert (masks[:, current] == there).mean() > 0.999
    points, rows = test_points(later)
    sets = behind.masks(points.reshape(-1, 2))
    assert holds(sets, np.repeat(rows, points.shape[1], axis=0)).all()


def test_files_hold_what_is_remembered(tmp_path):
    switching = Switching(price="1%", hold={"5": 0.02}, forbidden=[("default", "-5")])
    for leaves in ("constant", "affine"):
        policy = synthesize(PENDULUM.replace(switching=switching), leaves=leaves)
        policy.save(tmp_path / "p.cap")
        loaded = Policy.load(tmp_path / "p.cap")
        assert_equal(loaded, policy)
        loaded.save(tmp_path / "q.cap")
        assert (tmp_path / "q.cap").read_bytes() == (tmp_path / "p.cap").read_bytes()
        assert (loaded(policy.domain.sample(2000)) != 1).all()  # not at the start


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d, a: a.update(transitions=a["transitions"] + 3), "must be labels 0 to 2"),
        (lambda d, a: a.update(transitions=a["transitions"][::-1].copy()), "must ascend"),
        (lambda d, a: a.update(transitions=a["transitions"][:, :2].copy()), "none of its symbols"),
        (lambda d, a: a.update(transitions=a["transitions"] * 0), "must ascend|constant"),
        (lambda d, a: a.update(mixed_places=a["mixed_places"] + 99), "are not there"),
        (lambda d, a: a.pop("mixed_sets"), "does not hold the arrays"),
        (lambda d, a: d["policy"]["switching"].update(price="1%"), "price in numbers"),
        (lambda d, a: d["policy"]["switching"].update(price=-1), "finite number >= 0"),
        (lambda d, a: d["policy"]["switching"].update(forbidden=[["5", "-5"]]), "an exit"),
        (lambda d, a: d["policy"].update(delay=0), "keys are not those"),
        (lambda d, a: d.update(version=8), "keys are not those"),
    ],
)
def test_damaged_memories_are_refused(tmp_path, damage, message):
    path = tmp_path / "p.cap"
    synthesize(priced(PENDULUM, "1%")).save(path)
    rewrite(path, damage)
    with pytest.raises(PolicyFormatError, match=message) as told:
        Policy.load(path)
    assert "\n" not in str(told.value)


def test_what_a_policy_is_asked_with():
    policy = synthesize(priced(PENDULUM, "1%"))
    state = policy.domain.sample(4).reshape(2, 2, 2)
    assert policy(state, current="5").shape == (2, 2)
    assert np.array_equal(policy(state, current=[[0, 1], [-1, 2]]).shape, (2, 2))
    assert policy.control(state, current=1).shape == (2, 2, 1)
    assert policy.rows(state).shape == (2, 2) and policy.rows([0.0, 9.0]) < 0
    for current, message in (
        (3, "-1 to 1; got 3"),
        ("up", r"a symbol \(5, -5, default\)"),
        (0.5, "must be symbols"),
        ([0, 1, 0], r"of shape \(2, 2\)"),
    ):
        with pytest.raises(ProblemError, match=message):
            policy(state, current=current)


def test_a_synthesis_goes_on_and_does_not_depend_on_threads(tmp_path):
    problem = priced(PENDULUM, "1%")
    one = synthesize(problem, threads=1)
    assert_equal(dataclasses.replace(synthesize(problem, threads=2), timings={}), one)
    assert_equal(synthesize(problem, checkpoint=tmp_path / "c"), one)
    assert_equal(synthesize(problem, checkpoint=tmp_path / "c"), one)
    with pytest.raises(ProblemError):  # another price
        synthesize(priced(PENDULUM, "2%"), checkpoint=tmp_path / "c")
    with pytest.raises(ProblemError, match="`leaves` must be constant for a problem with a delay"):
        synthesize(problem.replace(delay=0.1), leaves="affine")


def room(**changes):
    """Return a room whose default control, off, is a symbol, and wins where no other descends."""
    fields = {
        "name": "room",
        "dynamics": lambda x, u: [u[0] - 0.3 * x[0], x[0] - 0.5 * x[1]],
        "domain": Box([-1, -1], [1, 1]),
        "alphabet": Alphabet([-1.0, 0.0, 1.0], names=["cool", "off", "heat"]),
        "default": 0.0,
        "horizon": 0.8,
        "running_cost": lambda x: x[0] ** 2 + x[1] ** 2,
        "settings": SsacSettings(
            steps=6, rule="steepest", on_no_descent="default", control_weight=0.3
        ),
        "max_level": 2,
    }
    return Problem(**fields | changes)


@pytest.mark.parametrize("rule", ["steepest", "schedule"])
def test_the_default_competes_as_the_symbol_of_its_control(rule):
    settings = dataclasses.replace(room().settings, rule=rule)
    plain = synthesize(room(settings=settings))
    states = plain.domain.sample(10_000, 1)
    wanted = plain.control(states)[:, 0]
    inside = ~np.isin(
        plain.cells.find(plain.domain.locate(states, plain.cells.counts)), plain.cells.mixed_cells
    )
    kept = synthesize(room(settings=settings, switching=Switching(hold=0.1)))
    assert (kept.control(states)[:, 0] == wanted)[inside].mean() > 0.999
    affine = synthesize(room(settings=settings, switching=Switching()), leaves="affine")
    assert (affine.control(states)[:, 0] == wanted)[inside].mean() > 0.97
    assert set(kept(states)) <= {0, 1, 2}  # never the default's label
    dear = synthesize(room(settings=settings, switching=Switching(price=1e9)))
    for current in range(3):
        assert (dear(states, current=current) == current).all()


def test_the_default_pays_and_is_forbidden_as_the_symbol_of_its_control():
    forbid = Switching(price=[[0, 1, 5], [2, 0, 3], [9, 4, 0]], forbidden=[("heat", "off")])
    policy = synthesize(room(switching=forbid))
    prices = policy.rules.prices
    assert prices[:3, 3].tolist() == [1, 0, np.inf] and not prices[3].any()
    assert policy.rules.kinds.tolist() == [0, 1, 2, 1]
    states = policy.domain.sample(5000)
    assert (policy.control(states, current="heat") != 0).all()


def test_states_without_an_answer_keep_what_may_not_go_to_the_default():
    wild = {
        "dynamics": lambda x, u: [u[0] - 0.3 * x[0], x[0] / (x[1] - 0.5)],
        "switching": Switching(forbidden=[("heat", "default")]),
        "default": 0.1,
        "domain": Box([-1, -1], [1, 1.5]),
        "settings": SsacSettings(steps=1, rule="steepest"),
        "partitions": [4, 150],
        "max_level": 0,
    }
    with pytest.warns(CapsynWarning, match="gave no finite result"):
        policy = synthesize(room(**wild))
    assert policy.statistics["not_finite_points"] > 0
    states = policy.domain.sample(20_000)
    assert (policy(states, current="heat") >= 0).all() and (
        policy(states, current="cool") < 3
    ).all()
