"""Alphabets beyond 63 symbols: sets of several words on the whole road."""

import itertools
from functools import partial

import numpy as np
import pytest

from capsyn import Alphabet, Ball, Box, Policy, Problem, SsacSettings, agreement, compress, simulate
from capsyn.cells.masks import members, word_count
from capsyn.compression.proof import prove
from capsyn.errors import PolicyFormatError
from capsyn.explorer.policy_data import policy_data
from capsyn.synthesis.synthesize import synthesize
from capsyn.verification.monte_carlo import monte_carlo
from support.exports.policies import RUNNERS, assert_equal
from support.policy_files import rewrite

WEIGHTS = (0.2, -0.4, 0.6, -0.8, 1.0, -1.2, 0.3)


def valves(count, **changes):
    """Return a problem of on/off valves, with a symbol for each combination."""
    flags = list(itertools.product([0, 1], repeat=count))
    values = {
        "name": "valves",
        "dynamics": lambda x, u: [
            x[1], sum(w * u[i] for i, w in enumerate(WEIGHTS[:count])) - 0.1 * x[1]
        ],
        "domain": Box([-1, -1], [1, 1]),
        "alphabet": flags,
        "default": [0] * count,
        "horizon": 2.0,
        "running_cost": lambda x: x[0] ** 2 + x[1] ** 2,
        "settings": SsacSettings(control_weight=0.01, steps=8),
        "outside": "nearest",
        "partitions": 6,
        "max_level": 2,
    }  # fmt: skip
    return Problem(**values | changes)


@pytest.fixture(scope="module", params=["constant", "affine"])
def policy(request):
    return synthesize(valves(7), leaves=request.param)


def test_the_policy_is_the_controllers_at_its_test_points(policy):
    found = agreement(policy, states=4000)
    assert found.share > 0.55 and len(policy.alphabet) == 128
    used = np.unique(policy(policy.domain.sample(20_000)))
    assert (used >= 64).any() and (used < 64).any()
    seen = policy.cells.mixed_labels
    assert seen.shape[1:] == (1, word_count(129)) and seen.shape[0] == len(policy.cells.mixed_cells)
    own = policy.cells.labels_at(policy.cells.mixed_cells)
    constant = own < 129
    held = members(seen[constant, 0], 129)
    assert held[np.arange(constant.sum()), own[constant]].all()


def test_files_hold_several_words(policy, tmp_path):
    path = tmp_path / "p.cap"
    policy.save(path)
    loaded = Policy.load(path)
    for name, array in policy.cells.arrays().items():
        assert np.array_equal(loaded.cells.arrays()[name], array)
    states = policy.domain.sample(2000, 1)
    assert np.array_equal(loaded(states), policy(states))
    if not len(policy.cells.mixed_cells):
        return
    whole = policy.cells.mixed_labels
    for damaged, message in (
        (whole[..., :1], "differ in number"),
        (whole | np.uint64(1 << 63), "unknown label"),
        (whole[:, 0], "one-dimensional uint64"),
        (0 * whole, "not among the labels seen"),
    ):
        policy.save(path)
        rewrite(path, partial(replaced, damaged))
        with pytest.raises(PolicyFormatError, match=message):
            Policy.load(path)


def replaced(array, document, arrays):
    arrays["mixed_labels"] = np.ascontiguousarray(array)


@pytest.mark.filterwarnings("ignore:the tree gives some symbols half as often")
@pytest.mark.parametrize("mode", ["exact", "freedom"])
def test_trees(mode):
    source = synthesize(valves(7))
    tree = compress(source, mode)
    states = source.domain.sample(4000, 2)
    same = (tree(states) == source(states)).mean()
    assert (same == 1) == (mode == "exact") and tree.guarantee.mode == mode
    assert prove(tree, source) == pytest.approx(1 - same, abs=0.03)
    assert tree.cells.leaf_labels().max() >= 64


@pytest.mark.parametrize("to", RUNNERS)
def test_exports(policy, to, tmp_path):
    assert_equal(to, policy, tmp_path)


def test_loops_and_pages(policy):
    run = simulate(policy, [0.5, 0.4], duration=2, rate=50)
    twin = simulate(policy, [0.5, 0.4], duration=2, rate=50, backend="numpy")
    assert np.array_equal(run.symbols, twin.symbols) and run.symbols.max() >= 0
    found = monte_carlo(policy, 5, duration=1, rate=20, target=Ball([0, 0], 0.5))
    assert found.to_json()["trials"] == 5
    data = policy_data(policy)
    assert data["cells"]["mixed_labels"].shape[1] == 2 * word_count(129)


def test_settings_of_equal_controls_are_told_apart_by_names():
    alphabet = Alphabet([[0, 0], [1, 0], [0, 0]], names=["low", "on", "high"])
    assert len(alphabet) == 3 and alphabet.names[2] == "high"
    made = synthesize(valves(2, alphabet=alphabet))
    assert set(np.unique(made(made.domain.sample(2000)))) == {0, 1}  # of equals the first
