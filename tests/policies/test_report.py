"""Figures and hints of policies."""

import dataclasses
import json

import pytest

import capsyn
from capsyn import Box, SsacSettings, problems, subdivide, synthesize
from capsyn.policies.report import hints, report


def hinted(problem, word, **options):
    return any(word in hint for hint in hints(synthesize(problem, **options)))


def test_policies_with_fine_boundaries_have_no_hints():
    for name in ("cart-pendulum", "double-tank-a", "double-tank-b", "boost-converter"):
        assert hints(synthesize(problems.get(name))) == []


def test_a_report_is_plain_data_and_agrees_with_the_policy():
    policy = synthesize(problems.get("double-tank-a"))
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
    pendulum = problems.get("cart-pendulum")
    assert hinted(pendulum, "max_level", max_level=1)
    assert not hinted(pendulum, "max_solves", max_solves=400)  # it was asked for
    same = SsacSettings(control_weight=1e9)  # two symbols of the same effort
    assert not hinted(pendulum, "never used", settings=same, max_level=1)
    four = problems.get("cart-pendulum-4")
    heavy = SsacSettings(rule="steepest", control_weight=1e9)
    assert hinted(four, "never used: -5, 5", settings=heavy, max_level=1)
    assert hinted(four, "control_weight decides", settings=heavy, max_level=1)
    assert hinted(pendulum, "weakest symbols win", settings=SsacSettings(gamma=-1e-6), max_level=1)
    assert hinted(pendulum, "not scaled", settings=SsacSettings(alpha_d=-1e12), max_level=1)


def test_coarse_boundaries_in_many_dimensions_are_told_of_affine_leaves():
    pole = problems.get("cart-pole")
    assert hinted(pole, "raise max_level, or take affine leaves", max_level=0)
    assert not hinted(pole, "boundaries", max_level=0, leaves="affine")
    assert not hinted(problems.get("cart-pendulum"), "affine", max_level=1)


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
