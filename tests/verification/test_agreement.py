"""Agreement with the controller: every figure recounted, and a planted island found."""

import dataclasses
import json
import threading

import numpy as np
import pytest
from scipy import stats

from capsyn import (
    Alphabet,
    Box,
    Policy,
    Problem,
    SsacSettings,
    Switching,
    problems,
    subdivide,
    synthesize,
)
from capsyn.cells.cell_tree import CellTree
from capsyn.controllers.ssac import policy_controller
from capsyn.errors import ProblemError
from capsyn.modelling.grid import Grid
from capsyn.policies.evidence import is_evidence
from capsyn.statistics import clopper_pearson
from capsyn.verification import agreement as module
from capsyn.verification import tally
from capsyn.verification.agreement import agreement
from capsyn.verification.sentences import headlines


@pytest.fixture(scope="module")
def pendulum():
    return synthesize(problems.plain("cart-pendulum"))


@pytest.fixture(scope="module")
def tank():
    settings = SsacSettings(gamma=-5.0)  # of the paper
    return synthesize(problems.plain("double-tank-a"), settings=settings)


def relabeled(policy, entry, leaf):
    """Return the policy with another leaf number in one cell."""
    entries = policy.cells.entries.copy()
    entries[entry] = -1 - leaf
    return dataclasses.replace(policy, cells=dataclasses.replace(policy.cells, entries=entries))


def line(max_level=3, edge=0.3):
    """Return a policy of one state that changes its symbol at an edge."""
    return subdivide(
        lambda x: (x[:, 0] > edge).astype(int),
        Box([-1.0], [1.0]),
        2,
        partitions=3,
        max_level=max_level,
    )


def in_box(states, island):
    return ((states >= island.lower) & (states < island.upper)).all(axis=1)


# The interval


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
@pytest.mark.parametrize(
    ("successes", "trials"),
    [(0, 1), (1, 1), (0, 50), (50, 50), (1, 50), (49, 50), (7, 20), (99_540, 100_000)],
)
def test_clopper_pearson_is_scipys(successes, trials, confidence):
    interval = clopper_pearson(successes, trials, confidence)
    wanted = stats.binomtest(successes, trials).proportion_ci(confidence, "exact")
    np.testing.assert_allclose(interval, wanted, rtol=1e-8, atol=0)  # SciPy searches its roots
    tail = (1 - confidence) / 2
    if successes:
        assert stats.binom.sf(successes - 1, trials, interval[0]) == pytest.approx(tail, rel=1e-9)
    if successes < trials:
        assert stats.binom.cdf(successes, trials, interval[1]) == pytest.approx(tail, rel=1e-9)


def test_clopper_pearson_is_exact_where_nothing_or_everything_succeeds():
    assert clopper_pearson(0, 9)[0] == 0.0 and clopper_pearson(9, 9)[1] == 1.0
    assert clopper_pearson(0, 9)[1] == pytest.approx(1 - 0.025 ** (1 / 9), rel=1e-14)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, 0), "`trials` must be a whole number >= 1; got 0"),
        ((3, 2), "`successes` must be a whole number >= 0 and <= 2; got 3"),
        ((-1, 2), "`successes`"),
        ((1, 2, 1.0), "`confidence` must be a number between 0 and 1; got 1"),
        ((1, 2, 0.0), "`confidence`"),
        ((1, 2, np.nan), "`confidence`"),
    ],
)
def test_bad_counts(arguments, words):
    with pytest.raises(ProblemError, match=words):
        clopper_pearson(*arguments)


# The figures


@pytest.mark.parametrize("name", ["pendulum", "tank"])
def test_every_count_is_that_of_a_plain_recount(name, request):
    policy = request.getfixturevalue(name)
    found = agreement(policy, 20_000, seed=3)
    states = policy.domain.sample(20_000, 3)
    last = len(policy.alphabet)
    own, masks = policy(states), policy_controller(policy).masks(states)[:, 0]
    agree = (masks >> own.astype(np.uint64)) & np.uint64(1) == 1
    assert found.states == len(states) and found.agreeing == agree.sum()
    assert found.share == agree.mean() and found.low < found.share < found.high
    assert found.not_finite == 0
    assert found.ties == sum(int(mask).bit_count() > 1 for mask in masks)

    other = np.where(agree, own, policy_controller(policy).symbols(states))
    pairs = [[((own == i) & (other == j)).sum() for j in range(last)] for i in range(last)]
    assert found.pairs[:last, :last].tolist() == pairs
    assert found.pairs.shape == (last + 1, last + 1) and found.pairs.sum() == len(states)
    assert found.symbols == (*policy.alphabet.names, "default")
    assert np.array_equal(found.disagreeing_states, states[~agree])
    assert found.disagreeing_symbols.tolist() == np.stack([own, other], 1)[~agree].tolist()

    tree = policy.cells
    cell = tree.find(policy.domain.locate(states, tree.counts))
    mixed = np.isin(cell, tree.mixed_cells)
    assert (found.mixed_states, found.mixed_agreeing) == (mixed.sum(), agree[mixed].sum())
    for leaves in tree.leaves():
        here = np.isin(cell, leaves.places)
        assert found.level_states[leaves.level] == here.sum()
        assert found.level_agreeing[leaves.level] == agree[here].sum()

    missed = ~agree & ~mixed
    assert found.island_states == missed.sum() == sum(x.disagreeing for x in found.islands)
    assert found.island_cells == len(np.unique(cell[missed])) == len(found.islands) > 0
    counts = [island.disagreeing for island in found.islands]
    assert counts == sorted(counts, reverse=True)
    for island in found.islands:
        here = in_box(states, island)
        assert island.states == here.sum() and island.disagreeing == (here & missed).sum()
        assert island.example == tuple(states[here & missed][0])
        assert {island.symbol} == set(own[here])
        assert island.others == tuple(np.unique(other[here & missed]))


@pytest.fixture(scope="module")
def priced():
    problem = problems.plain("cart-pendulum").replace(switching=Switching(price="1%"))
    return synthesize(problem, max_level=3)


@pytest.mark.parametrize("leaves", ["constant", "affine", "delay"])
def test_with_memory_every_pair_of_state_and_symbol_in_force_is_counted(leaves, priced):
    policy = priced
    if leaves != "constant":
        problem = problems.plain("cart-pendulum").replace(switching=Switching(price="1%"))
        options = {"leaves": "affine"} if leaves == "affine" else {"delay": 0.02}
        policy = synthesize(problem, max_level=2, **options)
    found = agreement(policy, 5000, seed=3)
    states = policy.domain.sample(5000, 3)
    sets = policy_controller(policy).masks(states)
    masks = [[int(word) for word in row] for row in sets[:, :, 0]]
    pairs, agreeing, wrong, islands = np.zeros((3, 3), int), [0, 0, 0], [], set()
    cells = policy.cells.find(policy.domain.locate(states, policy.cells.counts))
    mixed = set(policy.cells.mixed_cells.tolist())
    for j in range(3):
        for k, symbol in enumerate(policy(states, current=j).tolist()):
            right = [i for i in range(3) if masks[k][j] >> i & 1]
            other = symbol if symbol in right else j if j in right else right[0]
            pairs[symbol, other] += 1
            agreeing[j] += other == symbol
            if other != symbol:
                wrong.append((k, j, symbol, other))
                islands |= {cells[k]} - mixed
    assert found.states == 5000 and found.agreeing == sum(agreeing) // 3
    assert found.in_force_agreeing.tolist() == agreeing and found.pairs.tolist() == pairs.tolist()
    assert found.share == pytest.approx(sum(agreeing) / 15000) and 0.9 < found.share < 1
    assert found.low < found.share < found.high
    assert found.low == clopper_pearson(found.agreeing, 5000)[0]
    assert found.level_states.sum() == 15_000 and found.ties == sum(
        mask.bit_count() > 1 for row in masks for mask in row
    )
    wrong.sort()
    names = [-1 if label == 2 else label for _, label, *_ in wrong]
    assert found.disagreeing_in_force.tolist() == names
    assert found.disagreeing_symbols.tolist() == [[own, other] for *_, own, other in wrong]
    assert np.array_equal(found.disagreeing_states, states[[k for k, *_ in wrong]])
    assert found.island_cells == len(islands)
    for island in found.islands:
        assert policy(island.example, current=island.in_force) == island.symbol
    data = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert [row["symbol"] for row in data["in_force"]] == [*policy.alphabet.names, "default"]
    assert [row["agreeing"] for row in data["in_force"]] == agreeing
    assert is_evidence("agreement", data)
    assert headlines({"agreement": data})["agreement"].endswith(", mean over the symbols in force")


def test_controllers_of_ones_own_and_memory(priced, pendulum, monkeypatch):
    same = agreement(priced, 3000, controller=priced)
    assert same.agreeing == 3000 and same.in_force_agreeing.tolist() == [3000] * 3
    plain = agreement(priced, 3000, controller=lambda x: priced(x))  # whatever is in force
    assert plain.in_force_agreeing[2] == 3000 > plain.in_force_agreeing[0]
    other = agreement(pendulum, 3000, controller=priced)  # that has memory where the policy has not
    states = pendulum.domain.sample(3000)
    wanted = [(pendulum(states) == priced(states, current=j)).sum() for j in (0, 1, -1)]
    assert other.in_force_agreeing.tolist() == wanted
    four = synthesize(problems.plain("cart-pendulum-4"), max_level=0)
    with pytest.raises(ProblemError, match="`controller` must have 4 symbols, as the policy has"):
        agreement(four, 10, controller=priced)
    whole = agreement(priced, 3000).to_json()
    monkeypatch.setattr(module, "CHUNK", 1000)
    monkeypatch.setattr(module, "WAVE", 2)
    assert agreement(priced, 3000, threads=2).to_json() == whole


def test_agreement_of_the_papers_policies(pendulum, tank):
    found = agreement(pendulum)
    assert 0.995 < found.share < 0.9965 and found.low < 0.9957 < found.high
    assert found.level_agreeing[:4].tolist() == found.level_states[:4].tolist()
    assert 0.984 < agreement(tank).share < 0.988


def test_the_tanks_goal_is_an_island(tank):
    largest = agreement(tank).islands[0]
    assert in_box(np.array([[0.8, 0.2]]), largest)[0] and largest.level < tank.cells.max_level
    assert largest.disagreeing > 0.2 * largest.states


def test_a_policy_of_level_0_only():
    policy = synthesize(problems.plain("cart-pendulum"), max_level=0)
    found = agreement(policy, 10_000)
    assert 0.6 < found.share < 0.95
    assert found.level_states.tolist() == [10_000]
    assert found.mixed_states > 0


def test_other_confidence_and_seed(pendulum):
    found = agreement(pendulum, 5000)
    wider = agreement(pendulum, 5000, confidence=0.999)
    assert wider.low < found.low and wider.high > found.high and wider.share == found.share
    other = agreement(pendulum, 5000, seed=1)
    assert not np.array_equal(other.disagreeing_states, found.disagreeing_states)


# Islands


@pytest.mark.parametrize("level", [0, 2, 4])
def test_a_planted_island_is_found_and_located(pendulum, level):
    tree, domain = pendulum.cells, pendulum.domain
    leaves = next(x for x in tree.leaves() if x.level == level)
    uniform = np.flatnonzero(~np.isin(leaves.places, tree.mixed_cells))
    chosen = uniform[len(uniform) // 3]
    label = int(tree.labels_at(leaves.places[chosen]))
    planted = relabeled(pendulum, leaves.places[chosen], 1 - label)

    before, found = (agreement(p, 100_000) for p in (pendulum, planted))
    corners = leaves.lower[chosen] + np.array([[0, 0], tree.sizes(level)])
    lower, upper = domain.points(corners, tree.counts)
    (island,) = (x for x in found.islands if x.lower == tuple(lower))
    assert island.upper == tuple(upper) and island.level == level
    assert (island.symbol, island.others) == (1 - label, (label,))
    assert island.states == island.disagreeing == before.agreeing - found.agreeing > 0
    assert in_box(np.array([island.example]), island)[0]
    assert found.island_cells == before.island_cells + 1
    if level < 4:
        assert found.islands[0] is island
    others = {x for x in found.islands if x is not island}
    assert others == set(before.islands)


def test_a_mixed_cell_is_no_island(pendulum):
    entry = pendulum.cells.mixed_cells[7]
    leaf = -1 - pendulum.cells.entries[entry]
    found = agreement(relabeled(pendulum, entry, 1 - leaf), 50_000)
    before = agreement(pendulum, 50_000)
    assert found.agreeing != before.agreeing and found.islands == before.islands


# Ties and results that are not finite


def test_any_of_the_symbols_that_tie_agrees():
    problem = Problem(
        name="spare",
        dynamics=lambda x, u: [u[0] + 0 * u[1]],
        domain=Box([-1.0], [1.0]),
        alphabet=[[-1, 0], [-1, 5], [1, 0]],
        default=[0, 0],
        horizon=0.5,
        running_cost=lambda x: x[0] ** 2,
    )
    policy = synthesize(problem, max_level=3)
    found = agreement(policy, 4000)
    assert found.share > 0.97 and 1800 < found.ties < 2200
    leaves = next(x for x in policy.cells.leaves() if x.level == 0)
    cell = leaves.places[-1]  # at x near 1 both symbols that go down are best
    assert -1 - policy.cells.entries[cell] == 0
    also = agreement(relabeled(policy, cell, 1), 4000)
    assert also.agreeing == found.agreeing and also.pairs[1, 1] > 0
    wrong = agreement(relabeled(policy, cell, 2), 4000)
    assert wrong.agreeing < found.agreeing and wrong.islands[0].others == (0,)


def test_only_the_default_agrees_without_a_finite_result():
    # the root of a negative number is NaN; the policy was made where there is none
    problem = Problem(
        name="root",
        dynamics=lambda x, u: [u[0]],
        domain=Box([1.0], [3.0]),
        alphabet=[-1, 1],
        default=0,
        horizon=0.5,
        terminal_cost=lambda x: x[0] ** 0.5,
    )
    policy = synthesize(problem, partitions=2, max_level=0)
    moved = dataclasses.replace(policy, domain=Box([-1.0], [1.0]))
    negative = (moved.domain.sample(1000) < 0).sum()
    found = agreement(moved, 1000)
    assert found.not_finite == negative == 1000 - found.agreeing
    assert found.pairs[0].tolist() == [1000 - negative, 0, negative]
    assert found.disagreeing_symbols.tolist() == [[0, -1]] * negative
    assert [(x.symbol, x.others) for x in found.islands] == [(0, (-1,))]
    safe = agreement(relabeled(moved, 0, 2), 1000)
    assert safe.not_finite == negative and safe.agreeing == 1000
    assert safe.pairs[2, 2] == negative


# Controllers of one's own


def test_a_policy_agrees_with_itself_and_with_its_own_controller(pendulum):
    assert agreement(pendulum, 5000, controller=pendulum).agreeing == 5000
    symbols = policy_controller(pendulum).symbols
    mine, own = agreement(pendulum, 5000, controller=symbols), agreement(pendulum, 5000)
    assert mine.agreeing == own.agreeing and mine.ties == 0


def test_one_state_and_the_default():
    found = agreement(line(), 4000, controller=lambda x: np.where(x[:, 0] > 0.3, 1, -1))
    states = Box([-1.0], [1.0]).sample(4000)[:, 0]
    wrong = line()(states[:, None]) != np.where(states > 0.3, 1, -1)
    assert found.agreeing == 4000 - wrong.sum()
    assert found.pairs[0, 2] > 2400 and found.pairs[1, 1] > 1200
    assert found.islands[0].others == (-1,) and found.islands[0].lower == (-1.0,)


def test_an_alphabet_of_63_symbols():
    nothing = np.zeros(0, np.int32), np.zeros(0, np.uint64)
    tree = CellTree(Grid((64,), (2,), 0), -1 - np.arange(64, dtype=np.int32), *nothing)
    policy = Policy("many", Box([0.0], [64.0]), Alphabet(range(63)), 0.5, tree)
    found = agreement(policy, 2000, controller=lambda x: np.floor(x[:, 0]).astype(int) % 63)
    last = np.floor(policy.domain.sample(2000)) == 63
    assert found.agreeing == 2000 - last.sum() and found.pairs[63, 0] == last.sum()
    (island,) = found.islands
    assert (island.lower, island.symbol, island.others) == ((63.0,), -1, (0,))
    same = agreement(policy, 2000, controller=policy)
    assert same.agreeing == 2000 and same.pairs[63, 63] == last.sum()


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (lambda x: np.zeros(len(x)), r"must return \(100,\) integers; got float64"),
        (lambda x: np.zeros((len(x), 1), int), r"of shape \(100, 1\)"),
        (lambda x: 0, r"of shape \(\)"),
        (lambda x: x[:, 0] > 0, "got bool"),
        (lambda x: np.full(len(x), 2), r"symbols from -1 to 1; got 2 at state \["),
        (lambda x: np.full(len(x), -2), "got -2 at state"),
        (3, "must be a function; got 3"),
    ],
)
def test_controllers_that_return_no_symbols(controller, words):
    with pytest.raises(ProblemError, match=f"^`controller` .*{words}"):
        agreement(line(), 100, controller=controller)


def test_a_controller_of_ones_own_is_not_called_from_threads_unasked():
    seen = set()

    def controller(states):
        seen.add(threading.current_thread())
        return np.zeros(len(states), int)

    agreement(line(), 20_000, controller=controller)
    assert seen == {threading.main_thread()}


# Chunks, threads, errors, data


def test_threads_and_chunks_change_nothing(pendulum, monkeypatch):
    whole = agreement(pendulum, 20_000, threads=1).to_json()
    assert agreement(pendulum, 20_000, threads=4).to_json() == whole
    assert agreement(pendulum, 20_000).to_json() == whole
    monkeypatch.setattr(module, "CHUNK", 999)
    monkeypatch.setattr(module, "WAVE", 3)
    assert agreement(pendulum, 20_000, threads=2).to_json() == whole


def test_kept_states_and_islands_are_bounded(pendulum, monkeypatch):
    everything = agreement(pendulum, 20_000, controller=lambda x: 1 - pendulum(x))
    assert everything.agreeing == 0 and len(everything.disagreeing_states) == tally.KEPT
    monkeypatch.setattr(tally, "KEPT", 7)
    few = agreement(pendulum, 20_000, controller=lambda x: 1 - pendulum(x))
    assert np.array_equal(few.disagreeing_states, everything.disagreeing_states[:7])
    assert few.islands == everything.islands[:7]
    assert few.island_cells == everything.island_cells == len(everything.islands) > 7


def test_plain_data(pendulum):
    found = agreement(pendulum, 5000)
    data = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert data == found.to_json()
    assert data["share"] == found.share and data["pairs"] == found.pairs.tolist()
    assert data["islands"] == [island.to_json() for island in found.islands]
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.states = 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"states": 0}, "`states` must be a whole number >= 1; got 0"),
        ({"states": 1e5}, "`states`"),
        ({"seed": -1}, "`seed`"),
        ({"confidence": 1.5}, "`confidence`"),
        ({"threads": 0}, "`threads`"),
        ({"backend": "gpu"}, "`backend`"),
        ({"controller": None}, "`policy` must carry its model, horizon and settings"),
    ],
)
def test_bad_arguments(options, words):
    with pytest.raises(ProblemError, match=words) as error:
        agreement(line(), **({"controller": line()} | options))
    assert "\n" not in str(error.value)


def test_a_policy_is_wanted():
    with pytest.raises(ProblemError, match="`policy` must be a capsyn.Policy; got 3"):
        agreement(3)
