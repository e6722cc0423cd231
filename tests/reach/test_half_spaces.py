"""Half-spaces of trees beside lookups, and layers of cells that come to the same."""

import itertools

import numpy as np
import pytest

from capsyn.cells.split_tree import LEAF
from capsyn.modelling.domain import Box
from capsyn.reach.half_spaces import half_spaces
from capsyn.reach.kernel import Cells
from capsyn.reach.twins import rows_under, twin_layers
from support.proofs.attack import asked_of
from support.proofs.random_loops import KINDS, random_case
from support.split_trees import tree_of
from support.trees import states_at_faces

LATTICES = [(19,), (12, 7), (5, 6, 4)]


def ways(half, states, exact):
    """Return whether each state (B, n) may get to each node (B, K)."""
    may = np.zeros((len(states), len(half.row)), bool)
    may[:, 0] = True
    for node in np.flatnonzero(half.row < 0):
        at = states @ half.normal[node]
        first = at < half.below[node]
        second = ~first | (at > half.above[node]) if not exact else ~first
        may[:, node + 1] |= may[:, node] & first
        may[:, half.second[node]] |= may[:, node] & second
    return may


@pytest.mark.parametrize("planes", [0, 3])
@pytest.mark.parametrize("counts", LATTICES)
def test_half_spaces_hold_what_lookups_find(counts, planes):
    """On faces, corners and one rounding beside them too; without planes there is one way only."""
    for seed in range(8):
        policy = tree_of(counts, planes=planes, seed=seed)
        states = states_at_faces(policy.domain, counts, 300, seed)
        states = states[((states >= policy.domain.lower) & (states <= policy.domain.upper)).all(1)]
        half = half_spaces(policy.cells, policy.domain)
        found = policy(states)
        labels = np.where(found < 0, len(policy.alphabet), found)
        may = ways(half, states, exact=not planes)
        leaves = np.flatnonzero(policy.cells.split == LEAF)
        rows = may[:, leaves]
        assert (rows & (half.row[leaves] == labels[:, None])).any(axis=1).all()
        if not planes:
            assert (rows.sum(axis=1) == 1).all()


def test_oblique_half_spaces_are_tight():
    """A state that may be in either child is within a step of each axis of the split."""
    policy = tree_of((12, 7), planes=3, seed=1)
    half = half_spaces(policy.cells, policy.domain)
    nodes = np.flatnonzero((policy.cells.split >= 2) & (half.normal != 0).any(axis=1))
    assert len(nodes)
    steps = policy.domain.widths / (12, 7)
    gap = half.below[nodes] - half.above[nodes]
    most = np.abs(half.normal[nodes]) @ steps
    assert (gap <= most).all() and (gap >= -1e-9).all()


@pytest.mark.parametrize("planes", [0, 3])
def test_rows_under_boxes_are_those_of_their_states(planes):
    policy = tree_of((12, 7), planes=planes, seed=3)
    half, domain = half_spaces(policy.cells, policy.domain), policy.domain
    rng = np.random.default_rng(3)
    lower = domain.sample(60, 1)
    upper = np.minimum(lower + rng.uniform(0, 0.3, lower.shape) * domain.widths, domain.upper)
    box, row = rows_under(half, lower, upper)
    known = set(zip(box.tolist(), row.tolist()))
    for k in range(60):
        states = lower[k] + (upper[k] - lower[k]) * rng.random((200, 2))
        labels = policy(states)
        labels[labels < 0] = len(policy.alphabet)
        assert {(k, int(label)) for label in labels} <= known


def test_a_split_by_nothing_has_a_side():
    """A plane of zeros, whose sum is never below 0: all states are beyond, none is nowhere."""
    policy = tree_of((4, 4), seed=0)
    tree = type(policy.cells)(
        (4, 4), np.array([2, LEAF, LEAF]), np.array([0, 0, 1]), np.array([2, 1, 2]),
        np.zeros((1, 2), dtype=np.int32),
    )  # fmt: skip
    box = Box([0.0, 0.0], [1.0, 1.0])
    _, rows = rows_under(half_spaces(tree, box), np.zeros((1, 2)), np.ones((1, 2)))
    assert rows.tolist() == [1]


def remembering(seeds):
    """Yield loops of policies that remember, without holds or delays."""
    kind = next(kind for kind in KINDS if kind[0] == "linear")
    for seed in seeds:
        case = random_case(np.random.default_rng(seed), kind)
        loop = asked_of(case).loop
        if loop.layered and loop.delay == 0 and loop.holds.max() <= 1:
            yield case, loop


def test_twin_layers_come_to_the_same():
    """Beside lookups at many states of each cell: the same label follows either label in force."""
    tried = 0
    for case, loop in remembering(range(60)):
        cells = Cells(loop.space.lower, loop.space.upper, np.array([7, 6]))
        twins = twin_layers(loop, cells)
        lower, upper = cells.boxes(np.arange(cells.total))
        places = np.array(list(itertools.product([0.0, 0.21, 0.5, 0.83, 1 - 1e-9], repeat=2)))
        states = lower[:, None] + (upper - lower)[:, None] * places
        flat = states.reshape(-1, 2)
        follows = np.stack(
            [
                case.policy.leaves(flat, True, "numpy", np.full(len(flat), now, np.int32))
                for now in range(loop.labels)
            ]
        ).reshape(loop.labels, cells.total, -1)
        twin = np.take_along_axis(follows, twins[:, :, None], axis=0)
        assert (follows == twin).all()
        tried += bool((twins != np.arange(loop.layers)[:, None]).any())
    assert tried >= 3


def test_layers_differ_where_something_else_remembers():
    kind = next(kind for kind in KINDS if kind[0] == "linear")
    for seed in range(60):
        loop = asked_of(random_case(np.random.default_rng(seed), kind)).loop
        if loop.layers > 1 and (loop.delay > 0 or loop.holds.max() > 1):
            cells = Cells(loop.space.lower, loop.space.upper, np.array([3, 3]))
            assert (twin_layers(loop, cells) == np.arange(loop.layers)[:, None]).all()
            return
    raise AssertionError("no loop holds or is late")
