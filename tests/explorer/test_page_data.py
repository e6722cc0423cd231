"""What the page is told, so that it has no figures of its own."""

import numpy as np
import pytest

from capsyn import Box, subdivide
from capsyn.explorer.explore import page
from capsyn.explorer.packed import pack
from capsyn.explorer.page_data import page_data
from capsyn.policies.colors import PALETTE, TILE
from capsyn.problems import cart_pendulum, cart_pole, double_tank
from support.explorer.node import BEGIN, node
from support.explorer.page import json_of
from support.exports.policies import built_in
from support.trees import random_policy

LENGTHS = {
    "cart-pendulum": cart_pendulum.LENGTH,
    "cart-pole": cart_pole.LENGTH,
    "double-tank-a": double_tank.HEIGHT,
}
"""The lengths that the built-in problems' drawings show [m]."""


@pytest.mark.parametrize("name", LENGTHS)
def test_drawings_have_the_lengths_of_the_problems(name):
    assert page_data(built_in(name))["drawn_length"] == LENGTHS[name]
    assert page_data(built_in(name), "none")["drawn_length"] is None


def test_a_page_is_told_the_colours():
    data = page_data(random_policy(3))
    assert data["looks"] == [[color, 0] for color in PALETTE[: len(data["symbols"]) - 1]]
    assert data["tiles"].shape == (32, TILE, TILE)


def test_the_steps_of_the_loop_are_those_that_it_is_told(tmp_path):
    code = (
        'import { makeLookup } from "#page/policy/lookup.js";'
        'import { makeLoop } from "#page/loop/loop.js";'
        'import { model } from "./model.js";'
        + BEGIN
        + """
      const { policy, changes } = input, lookup = makeLookup(policy);
      print(changes.map(change => {
        const sampled = { ...policy.sampled, ...change };
        return makeLoop({ ...policy, sampled }, lookup, model).substeps(30);
      }));
    """
    )
    changes = [
        {},
        {"ladder": [2, 3]},
        {"ladder": [3, 5], "accuracy": 1.0},
        {"accuracy": 1e-30, "falling": 0.0, "stalls": 3, "tried": 1},
        {"accuracy": 1e-30, "falling": 0.0, "stalls": 5, "tried": 1},
    ]
    usual, unresolved, first, three, five = node(
        tmp_path, code, built_in("cart-pendulum"), changes=changes
    )
    assert usual["resolved"] and usual["steps"] > 3
    assert unresolved == {"steps": 3, "resolved": False}
    assert first == {"steps": 3, "resolved": True}
    assert (three["steps"], five["steps"]) == (4, 16)
    assert not three["resolved"] and not five["resolved"]


def test_what_the_page_is_told_is_plain():
    policy = built_in("cart-pole")
    assert json_of(f'<script id="data">{pack(page_data(policy))}</script>')["slack"] == 1e-9


def arrays():
    """Return arrays of all kinds that pages have."""
    rng = np.random.default_rng(3)
    return {
        "bytes": np.array([5, -3, 127, -128], dtype=np.int64),
        "large": np.array([255, 0, 255], dtype=np.int32),
        "long": np.array([-(2**31), 2**31 - 1, 0, 7], dtype=np.int64),
        "words": np.array([[0, 2**32 - 1], [1, 2**31], [5, 5]], dtype=np.uint32),
        "rows": np.arange(30_000).reshape(-1, 6) - 500,
        "noise": rng.integers(-32768, 32768, (50, 3)),
        "floats": rng.normal(size=(7, 2)),
        "cube": np.arange(24).reshape(2, 3, 4),
        "none": np.empty((0, 4), dtype=np.int16),
    }


def test_arrays_come_out_of_a_page_as_they_went_in(tmp_path):
    code = (
        BEGIN
        + """
      const data = await unpacked(input.packed);
      print(Object.fromEntries(Object.entries(data)
        .map(([name, { values }]) => [name, [values.constructor.name, values]])));
    """
    )
    found = node(tmp_path, code, random_policy(3), packed=pack(arrays()))
    for name, array in arrays().items():
        assert found[name][1] == array.ravel().tolist(), name
    types = ["Int8", "Uint8", "Int32", "Uint32", "Int16", "Int16", "Float64", "Int8", "Int8"]
    assert [found[name][0] for name in arrays()] == [f"{name}Array" for name in types]
    assert len(pack({"rows": np.arange(300_000)})) < 3_000  # what it changes by is packed
    with pytest.raises(TypeError, match="holds no int64"):
        pack({"count": np.int64(3)})


def test_rows_stand_symbol_by_symbol_in_a_page(tmp_path):
    code = (
        'import { regrouped } from "#page/policy/packed.js";'
        + BEGIN
        + "print(input.cases.map(([values, symbols]) => regrouped(values, symbols)));"
    )
    rng, cases, wanted = np.random.default_rng(5), [], []
    for symbols, width in (([3, 0, 3, 1, 0], 2), ([7], 1), ([2, 2, 2], 3), (range(5, 0, -1), 1)):
        values = rng.integers(0, 99, (len(symbols), width))
        order = np.argsort(symbols, kind="stable")
        cases.append([values[order].ravel().tolist(), list(symbols)])
        wanted.append(values.ravel().tolist())
    assert node(tmp_path, code, random_policy(3), cases=cases) == wanted


def test_the_page_of_a_large_policy_is_small():
    goals = np.random.default_rng(1).uniform(size=(27, 3))

    def label(x):
        return ((x[:, None] - goals) ** 2).sum(axis=2).argmin(axis=1)

    policy = subdivide(label, Box([0] * 3, [1] * 3), 27, partitions=8, max_level=3)
    assert policy.cells.leaf_count > 40_000
    small = subdivide(label, policy.domain, 27, partitions=8, max_level=0)
    assert len(page(policy)) - len(page(small)) < 2 * policy.cells.leaf_count  # [bytes]
