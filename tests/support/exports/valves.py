"""Random policies that remember: two actuators, with least times, forbidden transitions, prices."""

import dataclasses

import numpy as np

from capsyn import Alphabet, Policy, Switching
from capsyn.cells.affine_leaves import PriceRatios
from support.trees import GRIDS, random_affine_policy, random_policy, random_tree

NAMES = ["0 0", "0 1", "1 0", "1 1", "2 0", "2 1", "idle"]
VALUES = [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [2, 1], [0, 0]]
HOLDS = {
    "none": 0.0,
    "one": 0.08,
    "symbols": {"0 1": 0.08, "1 0": 0.12, "2 0": 0.2, "default": 0.04},
    "inputs": {"pump": 0.08, "valve": 0.24, "2 1": 0.12},
    "pump": {"pump": 0.08},
}
"""Kinds of least times [s]."""
FORBIDDEN = [("0 0", "2 1"), ("1 0", "2 1"), ("1 1", "0 1"), ("1 1", "idle")]


def table(labels, rows, forbidden, seed):
    """Return a random table of transitions, none of which is forbidden."""
    rng = np.random.default_rng(seed)
    free = rng.integers(labels, size=(rows, labels))
    free = np.where(rng.random(free.shape) < 0.3, np.arange(labels), free)
    free = np.where(forbidden[np.arange(labels), free], np.arange(labels), free)
    free[:, -1] = np.where(forbidden[-1, free[:, -1]], labels - 1, free[:, -1])
    constant = np.repeat(np.arange(labels)[:, None], labels, axis=1)
    return np.vstack([constant, np.unique(free, axis=0)])


def valves(holds="inputs", grid=3, seed=0, priced=False, constant=False, hold=None, **fields):
    """Return a policy of seven symbols, of which the first, the last and the default are alike.

    `holds` are of `HOLDS`, or others; where it is `priced`, leaves are affine; where `constant`,
    the symbol in force does not matter.
    """
    base = random_affine_policy(grid, True, seed) if priced else random_policy(grid, True, seed)
    forbidden, price = () if constant else FORBIDDEN, 0.0
    if priced:
        forbidden, price = _random_prices(seed)
    switching = Switching(
        price=price, hold=HOLDS[holds] if hold is None else hold, forbidden=forbidden
    )
    alphabet = Alphabet(VALUES, names=NAMES, inputs=["pump", "valve"])
    labels = len(NAMES) + 1
    prices = switching.prices(alphabet, np.zeros(2))
    transitions = table(labels, 0 if constant else 9, np.isinf(prices), seed)
    partitions, refinement, max_level = GRIDS[grid]
    cells = base.cells
    if priced:
        cells = _priced(cells, PriceRatios.of(prices).ratios, len(transitions), seed)
    else:  # rows in which nothing forbidden follows
        first = 0 if constant else labels
        count = len(transitions) - first
        cells = random_tree(partitions, refinement, max_level, count, seed=seed)
        entries = np.where(cells.entries < 0, cells.entries - first, cells.entries)
        cells = dataclasses.replace(cells, entries=entries.astype(np.int32))
    none = np.zeros((0, labels, 1), dtype=np.uint64)
    cells = dataclasses.replace(cells, mixed_cells=none[:, 0, 0].astype("i4"), mixed_labels=none)
    return Policy(
        "valves", base.domain, alphabet, np.zeros(2), cells,
        **{"transitions": transitions, "switching": switching, **fields},
    )  # fmt: skip


def _random_prices(seed):
    """Return forbidden transitions, none to the first or the fifth symbol, and a matrix of prices.

    Of some leaves all other symbols are forbidden at times.
    """
    rng = np.random.default_rng([4, seed])
    barred = rng.random((len(NAMES), len(NAMES))) < 0.25
    np.fill_diagonal(barred, False)
    barred[:, [0, 4]] = False
    pairs = [(NAMES[j], NAMES[k]) for j, k in np.argwhere(barred)]
    return pairs, rng.integers(0, 9, barred.shape) * (1 - np.eye(len(NAMES)))


def _priced(cells, ratios, rows, seed):
    """Return affine cells with prices, in whose other leaves nothing forbidden follows."""
    rng = np.random.default_rng([3, seed])
    affine, labels = cells.affine, len(ratios)
    moved = cells.entries < -affine.first
    constant = (cells.entries < 0) & ~moved
    entries = np.where(moved, cells.entries + affine.first - rows, cells.entries)
    entries[constant] = -1 - rng.integers(labels, rows, size=int(constant.sum()))
    prices = rng.integers(0, 30, len(affine)).astype(np.int32)
    symbols = [np.sort(rng.permutation(labels)[:k]) for k in np.diff(affine.starts)]
    affine = dataclasses.replace(
        affine,
        first=rows,
        symbols=np.concatenate(symbols).astype(np.int32),
        prices=prices,
        ratios=ratios,
    )
    return dataclasses.replace(cells, entries=entries.astype(np.int32), affine=affine)


def assert_rules_kept(policy, labels, at_once, period):
    """Check that no transition of labels (K,) is forbidden and each least time is kept.

    Steps are `period` [time unit] apart; those `at_once` (K,) do not wait.
    """
    rules, kinds = policy.rules, policy.rules.kinds[labels]
    assert not rules.forbidden[labels[:-1], labels[1:]].any()

    def held(values, holds):
        changes = np.flatnonzero(values[1:] != values[:-1]) + 1
        lasted = np.diff(np.concatenate([[0], changes])) * period
        wait = ~at_once[changes]
        assert (lasted >= holds[changes - 1] - 1e-9)[wait].all()
        return int(wait.sum())

    count = held(kinds, rules.holds[labels])
    for i, hold in enumerate(rules.input_holds):
        held(rules.controls[labels, i], np.full(len(labels), hold))
    return count
