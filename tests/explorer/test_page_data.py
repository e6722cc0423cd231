"""What the page is told, so that it has no figures of its own."""

import json

import pytest

from capsyn.explorer.page_data import page_data
from capsyn.policies.colors import PALETTE
from capsyn.problems import cart_pendulum, cart_pole, double_tank
from support.explorer.node import BEGIN, node
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
    assert page_data(random_policy(3))["palette"] == list(PALETTE)


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
    assert json.loads(json.dumps(page_data(built_in("cart-pole"))))["slack"] == 1e-9
