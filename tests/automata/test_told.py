"""Automata of policies that are told exogenous inputs: no loop crosses from one to another."""

import json

import numpy as np
import pytest

from capsyn import Box
from capsyn.automata.automaton import Automaton
from capsyn.automata.face_rates import IMPOSSIBLE, POSSIBLE
from capsyn.automata.switching import switching
from capsyn.compression.complexity import complexity
from support.relays import relay

LINE = Box([-1.0], [1.0])
TOLD = Box([-1.0], [1.0], names=["told"])
GRID = {"partitions": [8, 4], "exogenous": TOLD}


def push(x, u, w):
    return [u[0]]


def test_symbols_that_only_the_exogenous_input_parts_never_follow_each_other():
    policy = relay(push, LINE, lambda z: (z[:, 1] > 0).astype(int), **GRID)
    machine = Automaton.of(policy)
    found = machine.switching
    assert len(found.faces) == 0 and found.rate == 0 and found.sliding_share == 0
    assert [machine.edge(0, 1).possible, machine.edge(1, 0).possible] == [False, False]
    assert found.exit_rates == pytest.approx([0.25, 0.25, 0.0])  # at the ends of the state alone


def test_rates_are_means_over_the_exogenous_inputs():
    """Symbols change at x = w: rows of cells, each a relay of its own."""

    def label(z):
        return (z[:, 0] > np.floor(2 * z[:, 1] + 1e-9) / 2 + 0.25).astype(int)

    policy = relay(lambda x, u, w: [u[0] * (1 + x[0] ** 2)], LINE, label, **GRID)
    whole = switching(policy)
    cuts = [switching(policy.at(w)) for w in (-0.75, -0.25, 0.25, 0.75)]
    for name in ("switch_rates", "sliding_rates", "areas_between", "exit_rates"):
        mean = np.mean([getattr(cut, name) for cut in cuts], axis=0)
        np.testing.assert_allclose(getattr(whole, name), mean, err_msg=name)
    assert whole.rate == 0 and whole.sliding_share == 1.0
    assert (whole.faces.axis == 0).all()


def test_an_edge_is_possible_where_it_is_for_some_exogenous_input():
    """x' = w: the loop crosses upwards at positive values only, and back at negative ones."""
    told = Box([-1.0], [0.5], names=["told"])
    policy = relay(
        lambda x, u, w: [w[0]],
        LINE,
        lambda z: (z[:, 0] > 0).astype(int),
        partitions=[8, 3],
        exogenous=told,
    )
    found = switching(policy)
    assert found.switches[0, 1] == found.switches[1, 0] == POSSIBLE
    assert (found.slidings == IMPOSSIBLE).all()
    # the integral of |w| over one half, per volume: 2 states wide, 1.5 of w
    assert found.switch_rates[0, 1] == pytest.approx(0.5**2 / 2 / 3)
    assert found.switch_rates[1, 0] == pytest.approx(1.0**2 / 2 / 3)
    one_way = switching(policy.at(0.3))
    assert one_way.switches[0, 1] == POSSIBLE and one_way.switches[1, 0] == IMPOSSIBLE


def test_sliding_leads_around_no_face_between_exogenous_inputs():
    """Below w = 0 the loop slides at x = 0; symbol 2 is beside it, at w > 0 only."""

    def label(z):
        return np.where(z[:, 1] > 0, 2, (z[:, 0] > 0).astype(int))

    policy = relay(push, LINE, label, alphabet=[1.0, -1.0, 0.5], **GRID)
    found = switching(policy)
    assert found.slidings[0, 1] == POSSIBLE
    assert (found.switches[[0, 1], 2] == IMPOSSIBLE).all()
    assert (found.switches[2] == IMPOSSIBLE).all()


def test_partitions_are_connected_through_exogenous_inputs_and_regions_have_their_bounds():
    policy = relay(push, LINE, lambda z: (z[:, 0] > 0).astype(int), **GRID)
    machine = Automaton.of(policy)
    assert len(machine.partitions) == 2 and machine.told == 1
    lower, upper = machine.bounds(1)
    assert lower.tolist() == [[0, -1]] and upper.tolist() == [[1, 1]]
    data = json.loads(json.dumps(machine.to_json()))
    assert data["states"] == ["x1"] and data["exogenous"] == ["told"]
    assert "exogenous" not in Automaton.of(policy.at(0.1)).to_json()
    assert complexity(policy)["automaton"]["regions"] == 2
