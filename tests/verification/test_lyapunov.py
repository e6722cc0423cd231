"""Lyapunov evidence: systems whose sign of dV/dt is known, the pendulum, what is refused."""

import dataclasses
import json
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capsyn import Box, Policy, Problem, problems, subdivide, synthesize
from capsyn.errors import ProblemError
from capsyn.modelling.transcription import transcribe
from capsyn.problems.cart_pendulum import energy
from capsyn.verification import lyapunov as module
from capsyn.verification.bisection import bisect
from capsyn.verification.loop_derivative import LoopDerivative
from capsyn.verification.lyapunov import lyapunov, lyapunov_grid
from support.relays import hysteresis, relay


def loop(dynamics, box, label=None, alphabet=(1.0, -1.0), default=0.0, **options):
    """Return a policy with a model; `label` gives symbols of states (B, n), -1 the default."""
    n = box.n
    problem = Problem(
        "loop", dynamics, box, list(alphabet), default, 1.0, running_cost=lambda x: ca.sumsqr(x)
    )
    policy = subdivide(
        label or (lambda x: np.zeros(len(x), dtype=int)),
        box,
        len(problem.alphabet),
        **{"partitions": 4, "max_level": 2, **options},
    )
    return dataclasses.replace(
        policy,
        alphabet=problem.alphabet,
        default=np.array([default]),
        model=transcribe(problem),
        domain=Box([*box.lower], [*box.upper], periodic=[False] * n),
    )


def line(dynamics, low=-1.0, high=2.0, **options):
    return loop(lambda x, u: [dynamics(x[0])], Box([low], [high]), **options)


def square(x):
    return ca.sumsqr(x)


def shares(proof):
    return proof.proved, proof.negative, proof.violated, proof.undecided


def check(proof):
    """Check what holds for every proof, and that it is JSON."""
    assert proof.proved + proof.violated + proof.undecided == pytest.approx(1, abs=1e-12)
    assert 0 <= proof.negative <= proof.proved
    assert proof.negative_cells <= proof.proved_cells
    violated, undecided = proof.violated_cells, proof.undecided_cells
    assert proof.proved_cells + len(violated) + len(undecided) == proof.cells
    entries = np.concatenate([violated.entries, undecided.entries])
    assert len(np.unique(entries)) == len(entries)
    assert (violated.values > 0).all() and not (undecided.values <= 0).any()
    for found in (violated, undecided):
        assert ((found.lower <= found.states) & (found.states <= found.upper)).all()
    data = json.loads(json.dumps(proof.to_json(), allow_nan=False))
    assert data["violated_cell_count"] == len(violated)
    assert len(data["violated_cells"]) == min(len(violated), 100)
    return proof


@pytest.fixture(scope="module")
def pendulum():
    return synthesize(problems.plain("cart-pendulum"))


@pytest.fixture(scope="module")
def pendulum_proof(pendulum):
    return check(lyapunov(pendulum, lambda x: ca.fabs(energy(x))))


def test_a_stable_system_is_proved_everywhere():
    proof = check(lyapunov(line(lambda x: -x), square))
    assert proof.proved == 1.0 and proof.proved_cells == proof.cells
    # only the origin is not strict: of its cell all but a sliver is
    assert proof.negative_cells == proof.cells - 1
    assert 1 - 1e-3 < proof.negative < 1


def test_an_unstable_system_is_violated_everywhere():
    proof = check(lyapunov(line(lambda x: x), square))
    assert proof.proved == 0 and proof.negative == 0 and proof.proved_cells == 0
    assert 1 - 1e-3 < proof.violated < 1
    found = proof.violated_cells
    assert len(found) == proof.cells
    np.testing.assert_allclose(found.values, 2 * found.states[:, 0] ** 2, rtol=1e-14)


def test_a_spiral_is_proved_without_bisection():
    def dynamics(x, u):
        return [5 * x[1] - x[0], -5 * x[0] - x[1]]

    proof = check(lyapunov(loop(dynamics, Box([-1, -1], [1, 1])), square, depth=0))
    assert proof.proved == 1.0, "the terms of the rotation cancel"
    center = check(
        lyapunov(loop(lambda x, u: [x[1], -x[0]], Box([-1, -1], [1, 1])), square, depth=0)
    )
    assert shares(center) == (1.0, 0.0, 0.0, 0.0)


def test_weak_instability_of_a_spiral_is_seen():
    def dynamics(x, u):
        return [5 * x[1] + 1e-9 * x[0], -5 * x[0] + 1e-9 * x[1]]

    proof = check(lyapunov(loop(dynamics, Box([1, 1], [2, 3])), square))
    assert shares(proof) == (0.0, 0.0, 1.0, 0.0)


@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_double_integrator(offset):
    # dV/dt = x2 (u + sign(x1)) is positive where u, sign(x1) and sign(x2) are the same: nowhere
    # under the time-optimal law, in two areas if its switching curve is off
    def label(x):
        return (x[:, 0] + x[:, 1] * np.abs(x[:, 1]) / 2 > offset).astype(int)

    policy = loop(lambda x, u: [x[1], u[0]], Box([-1, -1], [1, 1]), label)
    proof = check(lyapunov(policy, lambda x: 0.5 * x[1] ** 2 + ca.fabs(x[0])))
    states = policy.domain.sample(200_000, seed=1)
    values = states[:, 1] * (policy.control(states)[:, 0] + np.sign(states[:, 0]))
    truth = np.mean(values > 0)
    assert proof.violated == pytest.approx(truth, abs=2e-3) and (truth > 0.03) == (offset > 0)
    assert proof.proved == pytest.approx(1 - truth, abs=2e-3)
    assert proof.negative == pytest.approx(np.mean(values < 0), abs=2e-3)
    cells = policy.cells.find(policy.domain.locate(states[values > 0], policy.cells.counts))
    assert set(proof.violated_cells.entries) == set(cells)
    # all that is left are slivers at x1 = 0, where V has a kink
    left = proof.undecided_cells
    assert proof.undecided < 1e-3 and ((left.lower <= 0) & (0 <= left.upper)).all(axis=1).any()
    assert ((left.lower[:, 0] == 0) | (left.upper[:, 0] == 0)).all()


def test_each_cell_has_its_own_control_and_the_default_counts():
    # u is x1's speed: +1 (symbol 0), -1 (symbol 1), or the default 3
    def label(x):
        return np.where(x[:, 0] < 0, 0, np.where(x[:, 0] < 1, 1, -1))

    policy = loop(lambda x, u: [u[0]], Box([-1.0], [3.0]), label, default=3.0, max_level=0)
    proof = check(lyapunov(policy, lambda x: x[0] ** 2))
    assert shares(proof) == (0.5, pytest.approx(0.5, abs=1e-3), 0.5, 0.0)
    found = proof.violated_cells
    assert (found.lower >= 1).all() and (found.symbols == -1).all()
    np.testing.assert_allclose(found.values, 6 * found.states[:, 0])
    np.testing.assert_array_equal(policy(found.states), found.symbols)
    assert found.boundary.sum() == 1 and found.lower[found.boundary] == 1.0


def test_each_symbol_that_may_be_in_force_counts():
    # u is x1's speed; in the middle third either symbol stays, and one of them leads away
    policy = relay(lambda x, u: [u[0]], Box([-1.0], [1.0]), hysteresis, partitions=6, in_force=True)
    proof = check(lyapunov(policy, square))
    assert shares(proof) == pytest.approx((2 / 3, 2 / 3, 1 / 3, 0), abs=1e-3)
    found = proof.violated_cells
    assert (np.abs(found.states) < 1 / 3).all() and found.boundary.all()
    assert found.symbols.tolist() == [1, 0]  # left of 0 the one to the left
    np.testing.assert_allclose(found.values, 2 * np.abs(found.states[:, 0]))
    for state, symbol in zip(found.states, found.symbols):
        assert policy(state, current=symbol) == symbol
    grid = lyapunov_grid(policy, square, 1 / 16)
    inside = np.abs(grid.axes[0]) < 1 / 3
    assert np.array_equal(grid.signs > 0, inside & (grid.axes[0] != 0))
    # a symbol that never follows is not in force
    away = relay(
        lambda x, u: [u[0]],
        Box([-1.0], [1.0]),
        lambda x: np.tile([0, 1, 1], (len(x), 1)),
        in_force=True,
    )
    assert shares(lyapunov(away, lambda x: x[0])) == (1.0, 1.0, 0.0, 0.0)


@settings(max_examples=40)
@given(
    center=st.floats(-0.85, 1.85),
    height=st.sampled_from([1e-30, 1e-12, 1e-6, 1e-2]),
    depth=st.integers(0, 16),
)
def test_a_small_hill_is_never_proved(center, height, depth):
    # dV/dt = height - (x - center)^2 is positive only within sqrt(height) of the centre
    policy = line(lambda x: height - (x - center) ** 2)
    proof = check(lyapunov(policy, lambda x: x[0], depth=depth))
    radius = np.sqrt(height)
    assert proof.proved <= 1 - 2 * radius / 3 * (1 - 1e-9)
    assert proof.proved_cells < proof.cells
    (entry,) = policy.cells.find(policy.domain.locate(np.array([[center]]), policy.cells.counts))
    assert entry in np.r_[proof.violated_cells.entries, proof.undecided_cells.entries]
    assert (np.abs(proof.violated_cells.states - center) < radius).all()


@settings(max_examples=25)
@given(st.data())
def test_no_part_is_proved_against_exact_arithmetic(data):
    numbers = st.floats(-2, 2, allow_subnormal=False).map(lambda v: round(v, 3))
    c = data.draw(st.lists(numbers, min_size=8, max_size=8))

    def field(x, y):
        return [
            c[0] * x + c[1] * y + c[2] * x * y - x * x * x,
            c[3] * x + c[4] * y + c[5] * x * x + c[6] * y * y * y + c[7],
        ]

    policy = loop(lambda x, u: field(x[0], x[1]), Box([-1, -1], [1, 1]), max_level=0)
    derivative = LoopDerivative(policy, lambda x: x[0] ** 2 + 0.5 * x[1] ** 2 + 0.25 * x[0] * x[1])
    corners = np.array(np.meshgrid([-1, -0.5, 0, 0.5], [-1, -0.5, 0, 0.5])).reshape(2, -1)
    symbols = np.zeros(16, dtype=int)
    boxes = bisect(
        lambda low, high, cells: derivative.bounds(low, high, symbols[cells]),
        corners,
        corners + 0.5,
        np.full(16, 1 / 16),
        8,
        2000,
    )
    c = [Fraction(v) for v in c]
    seed = data.draw(st.integers(0, 100))
    rng = np.random.default_rng(seed)
    for k in rng.choice(len(boxes.cells), 60):
        share = rng.choice([0.0, 0.25, 1.0], 2)
        state = boxes.lower[:, k] + share * (boxes.upper - boxes.lower)[:, k]
        x, y = map(Fraction, state)
        xdot, ydot = field(x, y)
        value = (2 * x + y / 4) * xdot + (y + x / 4) * ydot
        assert not (boxes.proved[k] and value > 0)
        assert not (boxes.negative[k] and value >= 0)
        assert not (boxes.violated[k] and value <= 0)


def test_undefined_dynamics_are_not_proved():
    root = line(lambda x: -ca.sqrt(x) - 1, -1.0, 1.0)
    proof = check(lyapunov(root, lambda x: x[0]))
    assert shares(proof) == (0.5, 0.5, 0.0, 0.5)
    assert np.isnan(proof.undecided_cells.values).all()
    # gone from dV/dt, by cancelling and by a factor 0, but not defined all the same
    box = Box([-1.0, -1.0], [1.0, 1.0])
    cancelling = loop(lambda x, u: [ca.sqrt(x[0]) - 1, ca.sqrt(x[0])], box)
    proof = check(lyapunov(cancelling, lambda x: x[0] - x[1]))
    assert shares(proof) == (0.5, 0.5, 0.0, 0.5)
    grid = lyapunov_grid(cancelling, lambda x: x[0] - x[1], 1.0)
    assert grid.signs[0].tolist() == [2, 2, 2] and grid.signs[1:].tolist() == [[-1] * 3] * 2
    hidden = loop(lambda x, u: [-x[0], ca.log(x[1])], box)
    proof = check(lyapunov(hidden, lambda x: x[0] ** 2))
    grid = lyapunov_grid(hidden, lambda x: x[0] ** 2, 1.0)
    assert grid.signs.tolist() == [[2, 2, -1], [2, 2, 0], [2, 2, -1]]
    assert proof.proved <= 0.5 and proof.undecided >= 0.5 and proof.proved > 0.49
    # the gradient 1 / x of log(x) is defined where log(x) is not
    value = line(lambda x: -(x**2), -0.05, 1.0, partitions=21)
    proof = check(lyapunov(value, lambda x: ca.log(x[0])))
    assert 0.99 * 20 / 21 < proof.proved < 20 / 21


def test_a_branch_that_is_not_taken_may_be_undefined():
    policy = line(lambda x: ca.if_else(x > 1, -ca.sqrt(x - 1), -x))
    proof = check(lyapunov(policy, square))
    assert proof.proved > 1 - 1e-3 and proof.violated == 0
    opposite = line(lambda x: ca.if_else(x > 1, ca.sqrt(x - 1), x))
    proof = check(lyapunov(opposite, square))
    assert proof.violated > 1 - 1e-3 and proof.proved == 0


def test_a_kink_counts_with_both_gradients():
    # V = |x - 0.1|: left of the kink x must grow, right of it shrink
    policy = loop(lambda x, u: [u[0]], Box([-1.0], [1.0]), lambda x: (x[:, 0] > 0).astype(int))
    proof = check(lyapunov(policy, lambda x: ca.fabs(x[0] - 0.1)))
    assert proof.violated == pytest.approx(0.05, abs=1e-3)
    assert (proof.violated_cells.lower >= 0).all()
    assert (proof.violated_cells.upper <= 0.25).all()
    smooth = check(lyapunov(policy, lambda x: ca.fmax(x[0] - 0.1, 0.1 - x[0])))
    assert shares(smooth) == shares(proof)


def test_the_kinks_of_a_largest_value_are_proved():
    policy = loop(lambda x, u: [-x[0], -2 * x[1]], Box([-1, -1], [1, 1]))
    proof = check(lyapunov(policy, lambda x: ca.fmax(ca.fabs(x[0]), ca.fabs(x[1])), depth=0))
    assert proof.proved == 1.0


def test_the_pendulum_is_proved(pendulum, pendulum_proof):
    proof = pendulum_proof
    assert proof.proved >= 0.99 and proof.undecided <= 0.001
    assert proof.proved - 0.001 < proof.negative < proof.proved
    states = pendulum.domain.sample(400_000, seed=2)
    E = 2 * states[:, 1] ** 2 + 19.62 * (np.cos(states[:, 0]) - 1)
    u = pendulum.control(states)[:, 0]
    values = np.sign(E) * 2 * states[:, 1] * np.cos(states[:, 0]) * u
    truth = np.mean(values > 0)
    assert 0.004 < truth < 0.006
    assert proof.violated <= truth + 2e-4 and proof.violated + proof.undecided >= truth - 2e-4
    tree = pendulum.cells
    positive = np.unique(tree.find(pendulum.domain.locate(states[values > 0], tree.counts)))
    found = proof.violated_cells
    assert set(positive) <= set(found.entries) | set(proof.undecided_cells.entries)
    assert len(set(positive) - set(found.entries)) <= 12, "grazed by E = 0"


def test_violated_cells_of_the_pendulum_are_finest_boundary_cells(pendulum, pendulum_proof):
    found = pendulum_proof.violated_cells
    assert 500 < len(found) < 560
    assert (found.levels == 4).all() and found.boundary.all()
    np.testing.assert_array_equal(pendulum(found.states), found.symbols)
    located = pendulum.domain.locate(found.states, pendulum.cells.counts)
    np.testing.assert_array_equal(pendulum.cells.find(located), found.entries)
    theta, omega = found.states.T
    E = 2 * omega**2 + 19.62 * (np.cos(theta) - 1)
    u = pendulum.control(found.states)[:, 0]
    np.testing.assert_allclose(found.values, np.sign(E) * 2 * omega * np.cos(theta) * u, rtol=1e-9)


def test_no_proved_part_of_the_pendulum_has_a_positive_state(pendulum):
    cells = module._Cells(pendulum)
    derivative = LoopDerivative(pendulum, lambda x: ca.fabs(energy(x)))
    boxes = bisect(
        lambda low, high, k: derivative.bounds(low, high, cells.rows[k]),
        cells.lower.T,
        cells.upper.T,
        cells.levels * 0.0,
        6,
        10**5,
    )
    u = np.vstack([pendulum.alphabet.values, pendulum.default])[cells.rows[boxes.cells], 0]
    for seed in range(5):
        share = np.random.default_rng(seed).choice([0, 1e-9, 0.3, 0.7, 1], boxes.lower.shape)
        theta, omega = boxes.lower + share * (boxes.upper - boxes.lower)
        theta, omega = theta.astype(np.longdouble), omega.astype(np.longdouble)
        E = 2 * omega**2 + 19.62 * (np.cos(theta) - 1)
        values = np.where(np.abs(E) < 1e-12, 0, np.sign(E)) * omega * np.cos(theta) * u
        assert boxes.proved.sum() > 1000 and boxes.violated.sum() > 100
        assert (values[boxes.proved] <= 0).all()
        assert (values[boxes.violated] > 0).all()


def test_more_depth_decides_more_and_proves_what_was_proved(pendulum):
    def V(x):
        return ca.fabs(energy(x))

    proofs = [check(lyapunov(pendulum, V, depth=k)) for k in (0, 2, 6)]
    assert proofs[0].violated == 0 and 0.9 < proofs[0].proved < 0.93
    for less, more in zip(proofs, proofs[1:]):
        assert less.proved < more.proved and less.violated < more.violated
        assert len(less.violated_cells) < len(more.violated_cells)
    few = check(lyapunov(pendulum, V, max_boxes=100))
    assert proofs[0].proved < few.proved < proofs[2].proved
    assert few.to_json()["max_boxes"] == 100


def test_a_policy_file_is_enough_and_the_result_is_always_the_same(pendulum, tmp_path):
    pendulum.save(tmp_path / "p.cap")
    loaded = Policy.load(tmp_path / "p.cap")

    def V(x):
        return ca.fabs(energy(x))

    first, second = (lyapunov(p, V, depth=4).to_json() for p in (pendulum, loaded))
    assert first == second
    grids = [lyapunov_grid(p, V, 0.1).signs for p in (pendulum, loaded)]
    np.testing.assert_array_equal(*grids)


def test_periodic_axes_have_neighbours_across_the_seam():
    policy = loop(
        lambda x, u: [u[0]], Box([0.0], [4.0]), lambda x: (x[:, 0] >= 2).astype(int), max_level=0
    )
    domain = Box([0.0], [4.0], periodic=[True])
    seam = dataclasses.replace(policy, domain=domain)

    def V(x):
        return 4 - (x[0] - 2) ** 2

    assert lyapunov(policy, V).violated_cells.boundary.tolist() == [False, True, True, False]
    assert lyapunov(seam, V).violated_cells.boundary.tolist() == [True] * 4


@pytest.mark.parametrize(
    ("V", "jump"),
    [
        (lambda x: ca.atan2(x[1], x[0]), "6.28"),
        (lambda x: 10 * (x[0] < 0) + x[0], "10"),
        (lambda x: ca.if_else(x[0] < x[1], x[0] + 10, x[0]), "10"),
        (lambda x: ca.if_else(x[0] < 0, x[0] ** 2, 1e-3 + x[1] ** 2), ""),
    ],
)
def test_a_V_that_jumps_is_refused(V, jump):
    policy = loop(
        lambda x, u: [-1.0, -1.0],
        Box([-1.0] * 2, [1.0] * 2),
        lambda x: np.zeros(len(x), int),
        max_level=0,
    )
    with pytest.raises(ProblemError, match=rf"^`V` must be continuous; it jumps by {jump}"):
        lyapunov(policy, V)


def test_a_V_that_jumps_at_the_seam_of_an_angle_is_refused():
    policy = loop(
        lambda x, u: [-1.0], Box([0.0], [4.0]), lambda x: np.zeros(len(x), int), max_level=0
    )
    assert lyapunov(policy, lambda x: x[0]).proved == 1
    seam = dataclasses.replace(policy, domain=Box([0.0], [4.0], periodic=[True]))
    with pytest.raises(ProblemError, match=r"^`V` must be continuous; it jumps by 4 at \(0\)"):
        lyapunov(seam, lambda x: x[0])
    lyapunov(seam, lambda x: (x[0] - 2) ** 2)


def test_kinks_steep_slopes_and_holes_are_no_jumps():
    policy = loop(
        lambda x, u: [-1.0, -1.0],
        Box([-1.0] * 2, [1.0] * 2),
        lambda x: np.zeros(len(x), int),
        max_level=0,
    )
    for V in (
        lambda x: ca.fmax(x[0], x[1]) ** 2,
        lambda x: ca.sqrt(ca.fabs(x[0])),
        lambda x: ca.if_else(x[0] < 0, -x[0], x[0] ** 2),
        lambda x: ca.exp(30 * x[0]),
    ):
        lyapunov(policy, V, depth=2)


def test_a_finest_cell_whose_test_points_disagree_is_a_boundary_cell():
    # the island of symbol 1 holds a centre alone: no cell has this label, one is mixed
    policy = loop(
        lambda x, u: [1.0], Box([0.0], [4.0]), lambda x: (x[:, 0] == 1.5).astype(int), max_level=0
    )
    found = lyapunov(policy, lambda x: x[0]).violated_cells
    assert (found.symbols == 0).all()
    assert found.boundary.tolist() == [False, True, False, False]


def test_only_finest_cells_are_boundary_cells():
    # the uniform cell [0, 2) has a neighbour of another symbol, but is not finest
    policy = loop(
        lambda x, u: [1.0],
        Box([0.0], [4.0]),
        lambda x: ((x[:, 0] > 2) & (x[:, 0] < 3.2)).astype(int),
        partitions=2,
        max_level=1,
    )
    found = lyapunov(policy, lambda x: x[0]).violated_cells
    assert found.lower[:, 0].tolist() == [0.0, 2.0, 3.0]
    assert found.boundary.tolist() == [False, True, True]


def test_mixed_cells_of_adaptive_splits_are_boundary_cells():
    # finest along the first axis, along which labels vary, and never split along the second
    policy = loop(
        lambda x, u: [1.0, 0.0],
        Box([0.0, 0.0], [4.0, 4.0]),
        lambda x: (x[:, 0] > 2.7).astype(int),
        partitions=1,
        max_level=2,
        refine="adaptive",
    )
    found = lyapunov(policy, lambda x: x[0]).violated_cells
    assert found.lower[:, 0].tolist() == [0.0, 2.0, 3.0]
    assert (found.upper - found.lower)[:, 1].tolist() == [4.0] * 3
    assert found.boundary.tolist() == [False, True, True]


def test_grid_of_the_paper(pendulum):
    grid = lyapunov_grid(pendulum, lambda x: ca.fabs(energy(x)), 0.01)
    assert grid.signs.shape == (630, 1001) and grid.signs.dtype == np.int8
    for axis, low, high in zip(grid.axes, pendulum.domain.lower, pendulum.domain.upper):
        assert axis[0] == low and axis[-1] == high
        assert (np.diff(axis) > 0).all() and np.diff(axis).max() <= 0.01 * (1 + 1e-9)
    assert 0.993 < grid.shares["negative"] < 0.996
    assert 0.004 < grid.shares["positive"] < 0.006
    assert grid.counts["undefined"] == 0 and sum(grid.counts.values()) == grid.signs.size
    assert (grid.signs[:, 500] == 0).all() and grid.counts["zero"] < 1000
    states = np.stack(np.meshgrid(*grid.axes, indexing="ij"), axis=-1)
    E = 2 * states[..., 1] ** 2 + 19.62 * (np.cos(states[..., 0]) - 1)
    values = np.sign(E) * states[..., 1] * np.cos(states[..., 0])
    values *= 2 * pendulum.control(states)[..., 0]
    clear = (np.abs(values) > 1e-6) & (np.abs(E) > 1e-9)
    np.testing.assert_array_equal(grid.signs[clear], np.sign(values[clear]))
    assert json.loads(json.dumps(grid.to_json()))["states"] == [630, 1001]


def test_grid_counts_zero_and_undefined_states():
    policy = line(lambda x: ca.sqrt(x) * (x - 1), -1.0, 2.0)
    grid = lyapunov_grid(policy, lambda x: x[0], 0.25)
    assert grid.counts == {"negative": 3, "zero": 2, "positive": 4, "undefined": 4}
    assert grid.signs.tolist() == [2, 2, 2, 2, 0, -1, -1, -1, 0, 1, 1, 1, 1]
    wide = lyapunov_grid(policy, lambda x: x[0], 0.25, zero=0.5)
    assert wide.counts["zero"] > 2 and wide.tolerance == pytest.approx(np.sqrt(2) / 2)
    none = lyapunov_grid(line(lambda x: 0 * x), square, 0.3)
    assert none.shares == {"negative": 0.0, "zero": 1.0, "positive": 0.0, "undefined": 0.0}


def test_grid_spacing_per_axis_and_chunks(monkeypatch):
    policy = loop(lambda x, u: [-x[0], 0.7 - x[1]], Box([-1, 0], [1, 1]))
    grid = lyapunov_grid(policy, square, [0.5, 0.2])
    assert grid.signs.shape == (5, 6)
    monkeypatch.setattr(module, "CHUNK", 7)
    np.testing.assert_array_equal(lyapunov_grid(policy, square, [0.5, 0.2]).signs, grid.signs)
    assert lyapunov_grid(policy, square, 100.0).signs.shape == (2, 2)


def test_large_numbers_of_boxes_are_evaluated_in_parts(monkeypatch, pendulum):
    from capsyn.verification import loop_derivative

    def V(x):
        return ca.fabs(energy(x))

    whole = lyapunov(pendulum, V, depth=2).to_json()
    monkeypatch.setattr(loop_derivative, "CHUNK", 100)
    assert lyapunov(pendulum, V, depth=2).to_json() == whole


REFUSED = {
    "two values": (lambda x: x, "`V` must return a scalar; got shape"),
    "not a function": (3.0, "`V` must be a function; got 3.0"),
    "too many arguments": (lambda x, u: x[0], "`V` failed on symbols"),
    "another state": (lambda x: x[2], "`V` failed on symbols with sizes .x: 2.: an index is out"),
    "constant": (lambda x: 3.0, "`V` must depend on the state"),
    "floor": (lambda x: ca.floor(x[0]) + x[1], "`V` must be continuous; its operation 'floor'"),
    "sign": (lambda x: ca.sign(x[0]) * x[0], "`V` must be continuous; its operation 'sign'"),
    "fmod": (lambda x: ca.fmod(x[0], 2), "`V` must be continuous; its operation 'fmod'"),
    "comparison": (lambda x: (x[0] > 0) + x[1], "`V` must be continuous; its operation 'lt'"),
    "root": (lambda x: ca.sqrt(x[0] - 0.5) + x[1], "`V` must have a finite value and gradient"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_lyapunov_function_is_refused_in_one_line(case):
    V, message = REFUSED[case]
    policy = loop(lambda x, u: [-x[0], -x[1]], Box([-1, -1], [1, 1]))
    for function in (lyapunov, lambda policy, V: lyapunov_grid(policy, V, 0.5)):
        with pytest.raises(ProblemError, match=message) as error:
            function(policy, V)
        assert "\n" not in str(error.value)


def test_kinks_and_branches_are_allowed():
    policy = loop(lambda x, u: [-x[0], -x[1]], Box([-1, -1], [1, 1]))
    for V in (
        lambda x: ca.fmax(ca.fabs(x[0]), ca.fabs(x[1])),
        lambda x: ca.if_else(x[0] > 0, x[0] ** 2, 3 * x[0] ** 2) + x[1] ** 2,
        lambda x: ca.if_else(ca.floor(x[0]) >= 0, x[0], -x[0]) + ca.fabs(x[1]),
        lambda x: ca.norm_2(x),
        lambda x: ca.sqrt(ca.fabs(x[0])) + x[1] ** 2,
    ):
        proof = check(lyapunov(policy, V, depth=8))
        assert proof.proved > 0.95 and proof.violated == 0


@pytest.mark.parametrize(
    "options, message",
    [
        ({"depth": -1}, "`depth` must be a whole number >= 0; got -1"),
        ({"depth": 2.0}, "`depth` must be a whole number >= 0; got 2.0"),
        ({"max_boxes": 1}, "`max_boxes` must be a whole number >= 2; got 1"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ProblemError, match=message):
        lyapunov(line(lambda x: -x), square, **options)


@pytest.mark.parametrize(
    "spacing, zero, message",
    [
        (0.0, 0.0, "`spacing` must be a finite number > 0"),
        ([0.1, 0.1], 0.0, "`spacing` must be a number > 0"),
        (1e-9, 0.0, "`spacing` must give at most 50000000 states; 1e-09 gives 3000000001"),
        (1e-320, 0.0, "`spacing`"),
        (0.1, -1.0, "`zero` must be a finite number >= 0"),
    ],
)
def test_wrong_grids_are_refused(spacing, zero, message):
    with pytest.raises(ProblemError, match=message):
        lyapunov_grid(line(lambda x: -x), square, spacing, zero)


def test_a_policy_without_a_model_is_refused():
    policy = subdivide(lambda x: (x[:, 0] > 0).astype(int), Box([-1], [1]), 2, max_level=1)
    for run in (lambda: lyapunov(policy, square), lambda: lyapunov_grid(policy, square, 0.5)):
        with pytest.raises(ProblemError, match="`policy` must have a model to follow"):
            run()


def test_what_is_no_policy_is_refused():
    for run in (lambda: lyapunov("a.cap", square), lambda: lyapunov_grid("a.cap", square, 0.5)):
        with pytest.raises(ProblemError, match="`policy` must be a Policy; got 'a.cap'"):
            run()


def test_a_proof_of_everything_is_no_share_above_one():
    # the shares of these 354 cells summed to 1.0000000000000002, which no file takes as evidence
    box = Box([-0.2] * 2, [0.2] * 2)
    policy = loop(
        lambda x, u: [-x[0], -x[1]], box, lambda x: (x.sum(1) > 0).astype(int), partitions=12
    )
    proof = lyapunov(policy, square)
    assert proof.proved == 1.0
    assert policy.with_evidence(lyapunov=proof.to_json()).evidence["lyapunov"]["proved"] == 1.0
