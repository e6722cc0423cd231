"""The largest set of cells from which limits are kept: known ones, and what mutants would say."""

import dataclasses

import numpy as np
import pytest

import capsyn.limits.invariant as invariant
from capsyn import Box, KeepLimits, SsacSettings, synthesize
from capsyn.errors import CapsynWarning
from capsyn.limits.asked import limited_loop
from capsyn.limits.invariant import viable
from support.proofs.limits import PERIOD, double_integrator, worst_limit


def braking(x):
    """Return how far beyond a limit full braking stops, (B,): > 0 where it cannot be kept."""
    up, down = np.maximum(x[:, 1], 0) ** 2 / 2, np.minimum(x[:, 1], 0) ** 2 / 2
    return np.maximum(x[:, 0] + up - 1, -1.8 - x[:, 0] + down)


@pytest.fixture(scope="module")
def kept():
    return synthesize(double_integrator(), keep_limits=KeepLimits(cells=(400, 300)))


def test_the_set_lies_in_the_known_one_and_fills_it(kept):
    states = kept.domain.sample(20_000, 1)
    inside = kept.keeps_limits(states)
    known = (braking(states) <= 0) & (np.abs(states[:, 1]) <= 1.4)
    assert not (inside & ~known).any()
    assert inside.sum() > 0.93 * known.sum()
    figures = kept.statistics["limits"]
    assert figures["of_domain"] == pytest.approx(inside.mean(), abs=0.01)
    assert figures["of_domain"] == pytest.approx(figures["share"] * figures["within"])
    assert figures["sample_time"] == PERIOD and figures["cells"] == [400, 300]
    assert figures["from"]["position"][1] <= 1.0 and figures["lost"]["speed"][1] == 1.4


def test_finer_cells_keep_more_of_it():
    shares = []
    for cells in (60, 120, 240):
        policy = synthesize(double_integrator(), keep_limits=KeepLimits(cells=cells))
        shares.append(policy.statistics["limits"]["share"])
    assert shares == sorted(shares) and 0 < shares[0] < shares[-1]


def test_one_state_by_hand():
    """x' = u in {-1, 1}, x <= 1: of cells of width 1/4, all are kept whose lower end moves left."""
    problem = double_integrator(
        dynamics=lambda x, u: [u[0]],
        domain=Box([0.0], [2.0]),
        alphabet=[-1.0, 1.0],
        running_cost=lambda x: (x[0] - 2) ** 2,
        limits=lambda x: [x[0] - 1.01, 0.29 - x[0]],
        settings=SsacSettings(rule="steepest", steps=8, sample_time=0.3),
        partitions=8,
        max_level=0,
    )
    with pytest.warns(CapsynWarning, match="limits cannot be kept from any cell"):
        policy = synthesize(problem, keep_limits=KeepLimits(cells=8))
    # cells [0.5, 0.75) and [0.75, 1) are within; from the first, left leads to 0.2, below 0.29;
    # right leads to 0.8 .. 1.05: above 1. From the second, left leads to 0.45 .. 0.7
    assert not policy.keeps_limits([[0.6], [0.9]]).any()
    policy = synthesize(problem, keep_limits=KeepLimits(cells=40))
    states = np.linspace(0.305, 0.995, 70)[:, None]
    inside = policy.keeps_limits(states)
    assert inside.all()  # anywhere in [0.3, 1] a step of 0.3 one way stays in it
    assert not policy.keeps_limits([[0.2], [0.295], [1.005], [1.2], [5.0]]).any()
    assert set(policy.kept.rows.ravel()) == {False, True}


def loop_of(policy, **cells):
    return limited_loop(policy, KeepLimits(**cells))


def test_moves_lead_where_the_flow_ends(kept):
    """Every allowed label leads from random states of its cells to states that are kept."""
    loop = loop_of(kept, cells=(400, 300))
    found = viable(loop)
    rng = np.random.default_rng(2)
    for label in range(3):
        cells = rng.choice(np.flatnonzero(found.allowed[0, label]), 5000)
        lower, upper = loop.boxes(cells)
        x = lower + rng.random(lower.shape) * (upper - lower)
        u = kept.controls[label, 0]
        end = np.stack([x[0] + PERIOD * x[1] + PERIOD**2 / 2 * u, x[1] + PERIOD * u])
        assert kept.keeps_limits(end.T).all()
        away = np.flatnonzero(found.kept[0] & ~found.allowed[0, label])
        assert len(away)


@pytest.mark.parametrize("mutant", ["tube", "end", "corner", "seam", "hold"])
def test_mutants_let_limits_be_broken(mutant, monkeypatch):
    """Each of these errors of the proof is met by an attack: the attacks can tell."""
    problem, cells = double_integrator(), (400, 300)
    if mutant == "hold":
        problem = problem.replace(min_dwell=4 * PERIOD)
        monkeypatch.setattr(
            "capsyn.limits.asked.LimitedLoop",
            lambda *args: invariant.LimitedLoop(*args[:8], np.ones(4, dtype=int), *args[9:]),
        )
    elif mutant == "tube":  # limits at the ends alone, far apart
        problem = problem.replace(
            dynamics=lambda x, u: [x[1], 3 * u[0]],
            settings=dataclasses.replace(problem.settings, sample_time=0.4),
        )
        original = invariant.LimitedLoop.bound
        monkeypatch.setattr(
            invariant.LimitedLoop,
            "followed",
            lambda self, box, parts: _ends_only(self, box, parts, original),
        )
    elif mutant == "end":  # the centre's end alone

        def centred(loop, chosen, box, layer, own=invariant._ends):
            middle = (box[0] + box[1]) / 2
            some, _ = own(loop, chosen, box, layer)
            return some, own(loop, chosen, (middle, middle), layer)[1]

        monkeypatch.setattr(invariant, "_ends", centred)
    elif mutant == "corner":  # a table of sums that is one cell off

        def shifted(loop, kept, own=invariant._sums):
            table = own(loop, kept).reshape(invariant._table_shape(loop))
            return np.roll(table, 2, axis=0).ravel()

        monkeypatch.setattr(invariant, "_sums", shifted)
    else:  # a periodic axis whose two ends are far apart
        problem = problem.replace(
            dynamics=lambda x, u: [1.0 + 0 * u[0], u[0]],
            domain=Box([0.0, -1.5], [4.0, 1.5], periodic=[True, False]),
            limits=lambda x: [(x[0] > 3.0) * (x[0] < 3.5) * (x[1] + 0.5), -1.4 - x[1]],
        )
        original = invariant.LimitedLoop.bound
        monkeypatch.setattr(
            invariant.LimitedLoop, "bound", lambda self, low, high: original(self, low, low)
        )
    policy = synthesize(problem, keep_limits=KeepLimits(cells=cells))
    states = policy.domain.sample(60_000, 3)
    states = states[policy.keeps_limits(states)]
    assert len(states) > 1000
    assert (worst_limit(policy, states, 60) > 1e-9).any()


def _ends_only(loop, box, parts, bound):
    count = box[0].shape[1]
    for label, duration, steps in parts:
        control = np.repeat(loop.controls[label][:, None], count, axis=1)
        tubes = loop.flow.tubes(*box, control, duration, loop.parameters, steps)
        box = tubes.end_lower, tubes.end_upper
    return bound(loop, *box), box


def struck_out(loop):
    """Return the set (C,) that `viable` gives, of a loop without memory, cell by cell in Python."""
    lower, upper = (end.T for end in loop.boxes(np.arange(loop.cells)))
    low, high = loop.space.lower, loop.space.upper
    turns = loop.space.widths * np.array(loop.space.periodic)
    touched = {}
    for cell in range(loop.cells):
        for label in range(loop.candidates):
            box = lower[cell][:, None], upper[cell][:, None]
            control = loop.controls[label][:, None]
            tube = loop.flow.tubes(*box, control, loop.period)
            if loop.bound(tube.lower, tube.upper)[0] > 0:
                continue
            first, last = tube.end_lower[:, 0], tube.end_upper[:, 0]
            free = np.array(loop.space.periodic)
            if ((first < low) | (last > high))[~free].any():
                continue
            meets = np.zeros(loop.cells, dtype=bool)
            for shift in np.ndindex(*(3 if p else 1 for p in free)):
                moved = (np.array(shift) - free) * turns
                below = lower + moved <= last
                above = (upper + moved > first) | ((upper == high) & (last >= high) & ~free)
                meets |= (below & above).all(axis=1)
            touched[cell, label] = meets
    kept = np.ones(loop.cells, dtype=bool)
    while True:
        left = np.zeros(loop.cells, dtype=bool)
        for (cell, _), meets in touched.items():
            left[cell] |= kept[cell] and kept[meets].all()
        if (left == kept).all():
            return kept
        kept = left


@pytest.mark.filterwarnings("ignore:cells are wider")
@pytest.mark.parametrize("periodic", [False, True])
def test_the_set_is_that_of_striking_out_cell_by_cell(periodic):
    settings = SsacSettings(rule="steepest", steps=8, sample_time=0.4)
    problem = double_integrator(settings=settings)
    if periodic:
        problem = problem.replace(
            dynamics=lambda x, u: [0.9 + 0.3 * x[1], u[0] - 0.2 * x[0]],
            domain=Box([-2.0, -1.5], [2.0, 1.5], periodic=[True, False]),
            limits=lambda x: [(x[0] > 1.2) * (x[0] < 1.8) * (x[1] - 0.6), x[1] - 1.3, -1.3 - x[1]],
        )
    policy = synthesize(problem, keep_limits=KeepLimits(cells=(23, 17)))
    loop = loop_of(policy, cells=(23, 17))
    wanted, found = struck_out(loop), viable(loop)
    assert 20 < wanted.sum() < loop.cells and found.rounds > 2
    assert (found.kept[0] == wanted).all()
