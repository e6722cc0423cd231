"""Evidence of policies that are told exogenous inputs: it is for all of their values."""

import json

import casadi as ca
import numpy as np
import pytest

from capsyn import Box, Policy, Problem, Switching, agreement, compress, lyapunov, synthesize
from capsyn.errors import ProblemError
from capsyn.policies.evidence import is_evidence
from capsyn.verification.lyapunov import lyapunov_grid
from capsyn.verification.sentences import headlines
from capsyn.verification.switching_curve import switching_curve, switching_point
from support.relays import relay

LINE = Box([-1.0], [1.0])
SETPOINT = Box([-0.5], [0.5], names=["setpoint"])
BAND = 0.0625
"""Twice the width of a finest cell: what cells cannot tell apart around the setpoint."""


def away(z):
    """Return which way an integrator is to go: 0 (u = 1) below the setpoint, 1 (u = -1) above."""
    return (z[:, 0] > z[:, 1]).astype(int)


def integrator(label=away, **options):
    """Return a policy that brings the state of xdot = u to a setpoint, on 64 by 32 cells."""
    grid = {"partitions": [4, 2], "max_level": 4, "exogenous": SETPOINT}
    return relay(lambda x, u, w: [u[0]], LINE, label, **(grid | options))


def distance(x, w):
    return ca.fmax((x[0] - w[0]) ** 2, BAND**2)


def test_an_integrator_is_proved_to_come_to_every_setpoint():
    proof = lyapunov(integrator(), distance)
    assert (proof.proved, proof.violated, proof.undecided) == (1.0, 0.0, 0.0)
    assert proof.proved_cells == proof.cells and proof.exogenous == "setpoint in [-0.5, 0.5]"
    # it falls outside the band, |x - w| > BAND: on what is left of 2 times 1
    outside = 1 - ((1 + BAND) ** 2 - (1 - BAND) ** 2) / 2 / 2
    assert outside - 0.01 < proof.negative <= outside


def test_without_a_band_exactly_the_cells_of_the_diagonal_are_not_proved():
    policy = integrator()
    proof = lyapunov(policy, lambda x, w: (x[0] - w[0]) ** 2)
    left = np.concatenate([proof.violated_cells.lower, proof.undecided_cells.lower])
    right = np.concatenate([proof.violated_cells.upper, proof.undecided_cells.upper])
    assert len(left) and (left[:, 0] <= right[:, 1]).all() and (left[:, 1] <= right[:, 0]).all()
    assert proof.violated_cells.boundary.all()
    x, w = proof.violated_cells.states.T
    direction = np.where(proof.violated_cells.symbols == 0, 1.0, -1.0)
    np.testing.assert_allclose(proof.violated_cells.values, 2 * (x - w) * direction)


@pytest.mark.parametrize(("low", "high"), [(0.25, 0.5), (-0.5, -0.375), (0.0, 0.03125)])
def test_a_policy_that_is_wrong_for_some_setpoints_only_is_not_proved_there(low, high):
    def wrong(z):
        there = (low <= z[:, 1]) & (z[:, 1] <= high)
        return np.where(there, 1 - away(z), away(z))

    uniform = {"partitions": [64, 32], "max_level": 0}
    proof = lyapunov(integrator(wrong, **uniform), distance)
    right = lyapunov(integrator(**uniform), distance)
    assert right.proved == 1.0 and proof.proved < 1
    assert proof.violated == pytest.approx((high - low) * right.negative, rel=0.1)
    for cells in (proof.violated_cells, proof.undecided_cells):
        assert (cells.upper[:, 1] >= low).all() and (cells.lower[:, 1] <= high).all()
    assert (np.abs(proof.violated_cells.states[:, 0] - proof.violated_cells.states[:, 1])).min() > 0


def test_a_setpoint_at_a_face_of_its_box_is_no_gap_in_the_proof():
    def only_outer(z):  # wrong at the very ends, in cells that reach them
        return np.where(np.abs(z[:, 1]) > 0.498, 1 - away(z), away(z))

    fine = integrator(only_outer, partitions=[64, 400], max_level=0)
    proof = lyapunov(fine, distance)
    assert proof.violated > 0
    lower, upper = proof.violated_cells.lower, proof.violated_cells.upper
    assert set(np.where(lower[:, 1] < 0, lower[:, 1], upper[:, 1])) == {-0.5, 0.5}


def test_what_moves_only_with_the_setpoint_is_no_decrease_of_V():
    """V falls along -w, which does not move: only the state counts."""
    policy = relay(
        lambda x, u, w: [0 * x[0]], LINE, lambda z: np.zeros(len(z), dtype=int), exogenous=SETPOINT
    )
    proof = lyapunov(policy, lambda x, w: x[0] ** 2 + 100 * w[0])
    assert (proof.proved, proof.negative, proof.violated) == (1.0, 0.0, 0.0)


def test_the_gradient_along_an_exogenous_input_may_be_undefined():
    policy = relay(
        lambda x, u, w: [-x[0] * w[0]],
        LINE,
        lambda z: np.zeros(len(z), dtype=int),
        exogenous=Box([0.0], [1.0]),
    )
    proof = lyapunov(policy, lambda x, w: x[0] ** 2 + ca.sqrt(w[0]))  # slope 1/0 at w = 0
    assert proof.proved == 1.0 and proof.proved_cells == proof.cells
    for V in (lambda x, w: x[0] ** 2 + ca.log(w[0]), lambda x, w: ca.sqrt(w[0]) * x[0] ** 2):
        found = lyapunov(policy, V)  # undefined at w = 0; and defined there
        assert (found.proved == 1.0) == (V(np.ones(1), np.zeros(1)) == 0)


def test_dynamics_that_depend_on_the_exogenous_input_are_taken_at_all_of_its_values():
    """x' = w x falls for w < 0 only."""
    policy = relay(
        lambda x, u, w: [w[0] * x[0]],
        LINE,
        lambda z: np.zeros(len(z), dtype=int),
        exogenous=Box([-1.0], [0.25]),
    )
    proof = lyapunov(policy, lambda x, w: x[0] ** 2, depth=16)
    assert proof.proved == pytest.approx(0.8, abs=1e-3) and proof.proved <= 0.8 + 1e-12
    assert proof.violated == pytest.approx(0.2, abs=1e-3) and proof.violated <= 0.2 + 1e-12


def test_no_cut_shows_growth_where_the_whole_is_proved():
    """Proofs at single setpoints find nothing that the proof for all has not."""
    rng = np.random.default_rng(4)
    table = rng.integers(0, 2, (16, 8))

    def random(z):
        i = np.clip((z[:, 0] + 1) * 8, 0, 15).astype(int)
        return table[i, np.clip((z[:, 1] + 0.5) * 8, 0, 7).astype(int)]

    policy = relay(
        lambda x, u, w: [u[0] - 0.3 * ca.sin(3 * w[0] + x[0])],
        LINE,
        random,
        partitions=[16, 8],
        exogenous=SETPOINT,
    )

    def V(x, w):
        return ca.fabs(x[0] - w[0]) * (1 + w[0] ** 2)

    proof = lyapunov(policy, V)
    cells = policy.cells
    open_cells = np.concatenate([proof.violated_cells.entries, proof.undecided_cells.entries])
    assert 0 < len(open_cells) < proof.cells
    grown = 0
    for w in [-0.5, 0.5, *rng.uniform(-0.5, 0.5, 8)]:
        cut = lyapunov(policy.at(w), lambda x, w=w: V(x, [w]))
        states = np.column_stack([cut.violated_cells.states, np.full(len(cut.violated_cells), w)])
        entries = cells.find(policy.space.locate(states, cells.counts))
        assert np.isin(entries, open_cells).all()
        grown += len(states)
    assert grown > 20


def test_V_may_jump_between_exogenous_inputs_but_not_along_the_state():
    policy = integrator()
    jumping = lyapunov(policy, lambda x, w: distance(x, w) * ca.if_else(w[0] > 0.1, 2.0, 1.0))
    assert jumping.proved == 1.0
    with pytest.raises(ProblemError, match="it jumps by"):
        lyapunov(policy, lambda x, w: ca.if_else(x[0] > w[0], 1.0, (x[0] - w[0]) ** 2))


def test_the_seam_of_an_exogenous_angle_is_no_jump():
    heading = Box([0.0], [2 * np.pi], names=["heading"], periodic=[True])
    policy = relay(
        lambda x, u, w: [-x[0]], LINE, lambda z: np.zeros(len(z), dtype=int), exogenous=heading
    )
    assert lyapunov(policy, lambda x, w: (1 + w[0]) * x[0] ** 2).proved == 1.0


@pytest.mark.parametrize(
    ("V", "message"),
    [
        (lambda x: x[0] ** 2, "it must be a function of x and w"),
        (lambda x, w: w[0] ** 2, "must depend on the state"),
        (lambda x, w: x[1] ** 2 + w[0], "sizes \\(x: 1, w: 1\\)"),
    ],
)
def test_what_is_no_function_of_states_and_exogenous_inputs_is_refused(V, message):
    with pytest.raises(ProblemError, match=message):
        lyapunov(integrator(), V)


def test_a_symbol_in_force_counts_at_every_setpoint():
    def late(z):  # symbol 0 stays a quarter too long where the setpoint is above 0
        up = z[:, 0] > z[:, 1] + 0.25 * (z[:, 1] > 0)
        return np.stack([up, away(z), away(z)], axis=1).astype(int)

    proof = lyapunov(integrator(late, in_force=True), distance)
    grows = proof.violated_cells
    assert proof.violated == pytest.approx((0.25 - BAND) * 0.5 / 2, abs=0.02)
    assert (grows.symbols == 0).all() and (grows.upper[:, 1] > 0).all()


def test_a_grid_has_the_exogenous_inputs_as_last_axes():
    grid = lyapunov_grid(integrator(), distance, [0.1, 0.25])
    assert grid.signs.shape == (21, 5) and len(grid.axes) == 2
    np.testing.assert_allclose(grid.axes[1], np.linspace(-0.5, 0.5, 5))
    apart = np.abs(grid.axes[0][:, None] - grid.axes[1])
    assert (grid.signs[apart > 1.01 * BAND] == -1).all()
    assert (grid.signs[apart < 0.99 * BAND] == 0).all()


def problem(**options):
    """Return an integrator that is told where to go, and a load that it may not see."""
    return Problem(
        "told",
        lambda x, u, w: [u[0] + w[1]],
        LINE,
        [-1.0, 0.0, 1.0],
        0.0,
        0.5,
        running_cost=lambda x, w: (x[0] - w[0]) ** 2,
        exogenous=Box([-0.5, -0.2], [0.5, 0.2], names=["setpoint", "load"]),
        target=lambda x, w: ca.fabs(x[0] - w[0]) < 0.25,
        partitions=4,
        max_level=2,
        outside="nearest",
        **options,
    )


@pytest.fixture(scope="module")
def policy():
    return synthesize(problem())


def test_agreement_is_counted_at_readings(policy):
    tree = compress(policy, "freedom", states=20_000)
    for controller in (policy, lambda z: policy(z[:, :1], z[:, 1:])):
        found = agreement(tree, 20_000, controller=controller, seed=3)
        readings = tree.space.sample(20_000, 3)
        own, other = tree(readings), policy(readings)
        assert found.agreeing == int((own == other).sum()) < 20_000
        np.testing.assert_array_equal(found.disagreeing_states, readings[own != other])
    assert found.exogenous == "setpoint in [-0.5, 0.5], load in [-0.2, 0.2]"


def test_agreement_sees_what_is_wrong_for_some_exogenous_inputs_only(policy):
    own = agreement(policy, 20_000)
    assert own.share > 0.9

    def wrong(z):
        return np.where(z[:, 2] > 0.15, (policy(z) + 1) % 3, policy(z))

    found = agreement(policy, 20_000, controller=wrong)
    assert found.share == pytest.approx(1 - 0.05 / 0.4, abs=0.01)
    assert (found.disagreeing_states[:, 2] > 0.15).all()


def test_agreement_with_each_symbol_in_force_is_at_readings():
    policy = synthesize(problem(switching=Switching(price="5%")))
    assert policy.remembers
    found = agreement(policy, 5_000)
    readings = policy.space.sample(5_000, 0)
    assert found.in_force_agreeing.shape == (4,) and found.share > 0.9
    assert np.isin(found.disagreeing_states, readings).all()
    again = agreement(policy, 5_000, controller=policy)
    assert again.share == 1.0


def test_sentences_say_what_evidence_quantifies_over(policy, tmp_path):
    steady = integrator()
    whole, part = lyapunov(steady, distance), lyapunov(steady, lambda x, w: (x[0] - w[0]) ** 2)
    found = agreement(policy, 1_000)
    for proof, words in (
        (whole, "for V = distance and every constant setpoint in [-0.5, 0.5]"),
        (part, "; the volume is that of states and setpoint in [-0.5, 0.5]"),
    ):
        data = json.loads(json.dumps(proof.to_json()))
        assert is_evidence("lyapunov", data)
        assert headlines({"lyapunov": data})["lyapunov"].endswith(words)
        steady.with_evidence(lyapunov=data).save(tmp_path / "steady.cap")
        assert Policy.load(tmp_path / "steady.cap").evidence["lyapunov"] == data
    data = found.to_json()
    text = headlines({"agreement": data})["agreement"]
    assert text.endswith("), setpoint in [-0.5, 0.5], load in [-0.2, 0.2] drawn with them")


def test_evidence_without_exogenous_inputs_says_nothing_of_them(policy):
    alone = policy.at([0.1, 0.0])
    proof = lyapunov(alone, lambda x: ca.fmax((x[0] - 0.1) ** 2, 0.01))
    assert (
        "exogenous" not in proof.to_json()
        and "exogenous" not in agreement(alone, 100, controller=alone).to_json()
    )


def test_loops_that_switch_are_told_constant_inputs(policy):
    point = switching_point(policy, trials=64, duration=2.0, rate=50.0)
    assert point.success is not None and point.success > 0.9 and point.switches > 0
    points = switching_curve(policy, (0.0, "10%"), trials=64, duration=2.0, rate=50.0)
    assert points[0].to_json() | {"recommended": False} == point.to_json() | {"price": "0"}
    assert points[1].switches < points[0].switches
