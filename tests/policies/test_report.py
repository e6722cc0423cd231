"""Figures and hints of policies."""

import dataclasses
import json

import numpy as np
import pytest

import capsyn
from capsyn import Alphabet, Box, SsacSettings, Switching, problems, subdivide, synthesize
from capsyn.cli.printed import print_agreement, print_report
from capsyn.policies.report import hints, report


def hinted(problem, word, **options):
    return any(word in hint for hint in hints(synthesize(problem, **options)))


def test_policies_with_fine_boundaries_have_no_hints():
    for name in ("cart-pendulum", "double-tank-a", "double-tank-b", "boost-converter"):
        assert hints(synthesize(problems.plain(name))) == []
    # the band in which symbols stay has two boundaries, of which each symbol in force sees one
    tank = problems.plain("double-tank-a").replace(switching=Switching(price="1%"))
    policy = synthesize(tank)
    assert policy.mixed_share > 0.1 and hints(policy) == []


@pytest.fixture(scope="module")
def priced():
    tank = problems.plain("double-tank-a")
    switching = Switching(price="1%", hold={tank.alphabet.names[0]: 0.1}, forbidden=())
    return synthesize(tank.replace(switching=switching, delay=0.01), max_level=3)


def printed(capsys, policy):
    print_report(report(policy))
    return capsys.readouterr().out.splitlines()


def test_a_report_tells_what_is_remembered(priced, capsys):
    data = json.loads(json.dumps(report(priced)))
    memory, table = data["memory"], priced.transitions
    assert memory["rows"] == len(table[np.unique(priced.cells.leaf_labels())])
    assert memory["varying_rows"] == len(table) - len(priced.alphabet) - 1
    states = priced.domain.sample(20_000)
    start = priced(states)
    stays = [(priced(states, current=k) == k) & (start != k) for k in range(len(priced.alphabet))]
    assert memory["staying_share"] == pytest.approx(np.any(stays, axis=0).mean(), abs=0.01)
    assert data["switching"] == priced.switching.to_json() and data["delay"] == 0.01
    lines = printed(capsys, priced)
    name = priced.alphabet.names[0]
    assert f"price        {priced.switching.price:.4g} per second, of any switch" in lines
    assert f"hold         {name} 0.1 s at least" in lines
    assert "delay        0.01 s, compensated" in lines
    assert any(line.startswith("memory") for line in lines)
    assert not any("minimum dwell" in line for line in lines)
    affine = synthesize(
        problems.plain("double-tank-a").replace(switching=Switching(price="1%")),
        max_level=2,
        leaves="affine",
    )
    assert 0 < report(affine)["memory"]["staying_share"] < 0.2
    assert "<path" in affine._repr_html_() and "the one in force stays" in affine._repr_html_()
    print_agreement(capsyn.agreement(priced, 500).to_json(), "so much")
    assert "\nin force     default 9" in (out := capsys.readouterr().out)
    assert "%; the others more\n" in out


def test_a_policy_without_memory_is_told_as_ever(capsys):
    policy = synthesize(problems.plain("double-tank-a"), max_level=2)
    assert not {"memory", "switching", "delay"} & set(report(policy))
    lines = printed(capsys, policy)
    assert any(line.endswith("minimum dwell 0 s") for line in lines)
    assert not any(line.startswith(("memory", "price", "hold")) for line in lines)


def test_symbols_that_no_row_leads_to_are_unused(capsys):
    def label(x):  # 2 would stay, but nothing leads there
        right = (x[:, 0] > 0).astype(int)
        return np.stack([0 * right, right, 2 + 0 * right, right], axis=1)

    alphabet = Alphabet([0.0, 1.0, 2.0], names=["off", "on", "more"])
    policy = subdivide(label, Box([-1.0], [1.0]), alphabet, in_force=True)
    prices = [[0, 1, 2], [1, 0, 1], [2, 1, 0]]
    policy = dataclasses.replace(
        policy, switching=Switching(price=prices, hold=[0, 1, 2], forbidden=[("more", "off")])
    )
    assert report(policy)["unused_symbols"] == ["more"] and policy.volume_shares[2] > 0
    assert hints(policy)[0].startswith("never entered: more; ")
    lines = printed(capsys, policy)
    assert "price        1 to 2 per second, by pair" in lines
    assert "hold         off 0, on 1, more 2 s at least" in lines
    assert "forbidden    more to off" in lines
    priced = dataclasses.replace(policy, switching=Switching(price={alphabet.inputs[0]: 0.5}))
    lines = printed(capsys, priced)
    assert f"price        {alphabet.inputs[0]} 0.5 per second, for each unit of change" in lines


def test_a_report_is_plain_data_and_agrees_with_the_policy():
    policy = synthesize(problems.plain("double-tank-a"))
    data = json.loads(json.dumps(report(policy)))
    assert data["cells"] == policy.cells.leaf_count == policy.statistics["cells"]
    shares = [s["volume_share"] for s in data["symbols"]] + [data["default"]["volume_share"]]
    assert sum(shares) == pytest.approx(1)
    assert data["table_bytes"] == 4 * len(policy.cells.entries)


def test_the_axes_that_cells_are_split_along_are_part_of_the_table():
    box = Box([0, 0], [1, 1])
    policy = subdivide(lambda x: (x[:, 0] > 0.6).astype(int), box, 2, refine="adaptive")
    entries = len(policy.cells.entries)  # of 32 bits, and 16 for the axes
    assert policy.cells.splits is not None and report(policy)["table_bytes"] == 6 * entries


def test_hints_name_what_smells():
    pendulum = problems.plain("cart-pendulum")
    assert hinted(pendulum, "max_level", max_level=1)
    assert not hinted(pendulum, "max_solves", max_solves=400)  # it was asked for
    same = SsacSettings(control_weight=1e9)  # two symbols of the same effort
    assert not hinted(pendulum, "never used", settings=same, max_level=1)
    four = problems.plain("cart-pendulum-4")
    heavy = SsacSettings(rule="steepest", control_weight=1e9)
    assert hinted(four, "never used: -5, 5", settings=heavy, max_level=1)
    assert hinted(four, "control_weight decides", settings=heavy, max_level=1)
    assert hinted(pendulum, "weakest symbols win", settings=SsacSettings(gamma=-1e-6), max_level=1)
    assert hinted(pendulum, "not scaled", settings=SsacSettings(alpha_d=-1e12), max_level=1)


def test_coarse_boundaries_in_many_dimensions_are_told_of_affine_leaves():
    pole = problems.plain("cart-pole")
    assert hinted(pole, "raise max_level, or take affine leaves", max_level=0)
    assert not hinted(pole, "boundaries", max_level=0, leaves="affine")
    assert not hinted(problems.plain("cart-pendulum"), "affine", max_level=1)


def test_hints_see_a_weak_alphabet_and_a_blind_cost():
    box = capsyn.Box([-1.0, -1.0], [1.0, 1.0])
    one_way = capsyn.Problem(
        name="one-way",
        dynamics=lambda x, u: [u[0], -x[1]],
        domain=box,
        alphabet=[1.0, 2.0],
        default=0.0,
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2,
    )
    assert hinted(one_way, "alphabet may be too weak")
    blind = dataclasses.replace(one_way, running_cost=lambda x: x[1] ** 2)
    assert hinted(blind, "several symbols tie")
    held = dataclasses.replace(one_way, alphabet=capsyn.Alphabet([0.0, 2.0]), default=0.5)
    weights = SsacSettings(rule="steepest", control_weight=100.0)
    assert hinted(held, "would: control_weight holds it back", settings=weights)
    for wanted, name in ({"gamma": -1e-6}, "gamma"), ({"alpha_d": -1e-6}, "alpha_d"):
        weights = SsacSettings(control_weight=100.0, **wanted)
        assert hinted(held, f"would: {name} holds it back, or control_weight", settings=weights)
    assert not hinted(held, "alphabet may be too weak", settings=weights)
    short = dataclasses.replace(one_way, horizon=1e-5)
    assert hinted(short, "horizon may be too short")


def test_a_negative_cost_turns_gamma_around():
    problem = capsyn.Problem(
        name="sunk",
        dynamics=lambda x, u: [x[1], u[0]],
        domain=capsyn.Box([-1.0, -1.0], [1.0, 1.0]),
        alphabet=[-1.0, 1.0],
        default=0.0,
        horizon=1.0,
        terminal_cost=lambda x: x[1] - 10,
    )
    assert hinted(problem, "cost is negative in 100%")
    assert not hinted(problem, "cost is negative", settings=SsacSettings(rule="steepest"))
