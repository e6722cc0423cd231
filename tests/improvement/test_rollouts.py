"""Rollouts: what a symbol costs, against closed loops written out trial by trial."""

import dataclasses

import numpy as np
import pytest

import capsyn
from capsyn import Box, Problem, SsacSettings, Switching
from capsyn.cells.masks import members
from capsyn.improvement.charged_loop import ChargedLoop
from capsyn.improvement.rollouts import Rollouts
from support.closed_loops import BACKENDS
from support.told import ROOMS

RATE = 20.0
CART = Problem(
    name="cart",
    dynamics=lambda x, u: [x[1], u[0] - 0.5 * u[1] - 0.3 * x[1]],
    domain=Box([-2, -2], [2, 2]),
    alphabet=[[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 1.0]],
    default=[0.0, 0.0],
    horizon=0.8,
    running_cost=lambda x: x[0] ** 2 + 0.5 * x[1] ** 2,
    terminal_cost=lambda x: 3 * x[0] ** 2,
    settings=SsacSettings(rule="steepest", control_weight=0.05),
    outside="nearest",
    partitions=4,
    max_level=2,
)
PRICE = [[0, 0.1, 0.2, 0.3], [0.1, 0, 0.1, 0.2], [0.2, 0.1, 0, 0.1], [0.3, 0.2, 0.1, 0]]
VARIANTS = {
    "plain": {},
    "leaves": {"outside": "error"},
    "dwell": {"min_dwell": 0.15},
    "price": {"switching": Switching(price=PRICE)},
    "holds": {"switching": Switching(price=0.05, hold=(0.15, 0.1, 0.2, 0.0))},
    "inputs": {"switching": Switching(hold={"u1": 0.1, "u2": 0.15})},
    "forbidden": {"switching": Switching(forbidden=[("(-1, 0)", "(1, 0)"), ("(1, 1)", "(-1, 0)")])},
}


def reference(loop, state, first, before, samples, end):
    """Return what a trial costs that takes `first` while `before` is in force, or infinity."""
    policy, plant, period = loop.policy, loop.plant, loop.loop.period
    holds, none = loop.loop.holds, np.zeros((0, 1))
    x, cost = state[:, None].copy(), np.zeros(1)
    now, last = before, len(policy.alphabet)
    held, inputs = 1 << 30, np.full(policy.alphabet.m, 1 << 30)
    for k in range(samples):
        wanted = first
        if k:
            inside = policy.space.contains(x.T)[0]
            if not inside and policy.outside == "error":
                return np.inf
            wanted = int(policy.leaves(x.T, True, "numpy", np.array([now], np.int32))[0])
            wanted = int(
                holds.permitted(
                    np.array([now]), np.array([wanted]), np.array([held]), inputs[None]
                )[0]
            )
        changed = policy.controls[wanted] != policy.controls[now]
        if policy.switching is None and k == 0:
            changed[:] = True  # without a memory the symbol in force is not known
        enters = holds.kinds[wanted] != holds.kinds[now] or (policy.switching is None and k == 0)
        held = 1 if enters else held + 1
        inputs = np.where(changed, 1, inputs + 1)
        price = loop.prices[now, wanted] if policy.switching is not None or k else 0.0
        if k == 0 and policy.switching is None:
            price = 0.0
        efforts = policy.settings.efforts(policy.controls)
        effort = efforts[wanted] - efforts[:-1].min()
        cost = cost + (price + effort) * period
        u = policy.controls[wanted][:, None]
        length = np.array([period])
        x, cost = plant.advance(x, cost, u, none, np.zeros_like(x), length, loop.loop.substeps)
        now = wanted
    assert last >= now
    return float(cost[0] + (plant.terminal_cost.evaluate(x)[0][0, 0] if end else 0.0))


def rollouts_of(problem, samples, backend="auto", end=True):
    policy = capsyn.synthesize(problem)
    loop = ChargedLoop.of(policy, RATE, backend, 1).charging(1.0)
    return Rollouts.of(loop if end else dataclasses.replace(loop, end=None), samples)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", VARIANTS)
def test_costs_are_those_of_closed_loops(name, backend):
    rollouts = rollouts_of(CART.replace(**VARIANTS[name]), 8, backend)
    loop, space = rollouts.loop, rollouts.loop.policy.space
    states = np.vstack([space.sample(2, 3), [[1.99, 1.9], [-1.9, 0.1]]])
    costs = rollouts.costs(states)
    remembers = "switching" in VARIANTS[name]
    assert costs.shape == (4, 5 if remembers else 1, 4)
    for j in range(costs.shape[1]):
        before = j if remembers else 4
        for i in range(4):
            own = [reference(loop, x, i, before, 8, True) for x in states]
            np.testing.assert_allclose(costs[:, j, i], own, rtol=1e-9)
    assert np.isinf(costs).any() == (name in ("leaves", "forbidden"))


def test_backends_and_threads_agree():
    problem = CART.replace(**VARIANTS["holds"])
    states = problem.space.sample(50, 1)
    one, two = (rollouts_of(problem, 9, backend).costs(states) for backend in BACKENDS)
    np.testing.assert_allclose(one, two, rtol=1e-12)
    loop = rollouts_of(problem, 9).loop
    costs = loop.costs_from(states, 30)
    for threads in (2, 3):
        other = dataclasses.replace(loop, threads=threads)
        assert np.array_equal(other.costs_from(states, 30), costs)


def test_masks_are_the_least_costs_and_the_policys_own_label_where_none_is_finite():
    rollouts = rollouts_of(CART.replace(outside="error", max_level=1), 30, end=False)
    states = np.vstack([CART.domain.sample(200, 2), [[1.99, 2.0], [2.0, 1.99]]])
    costs = rollouts.costs(states)[:, 0]
    masks, scores = rollouts.scored(states)
    best, lost = members(masks, 4), np.isinf(costs).all(axis=1)
    assert lost[-2:].all() and not lost.all()
    assert (best[~lost] == (costs == costs.min(axis=1, keepdims=True))[~lost]).all()
    own = rollouts.loop.policy(states[lost])
    assert (best[lost].argmax(axis=1) == own).all() and (best[lost].sum(axis=1) == 1).all()
    finite = np.isfinite(costs).all(axis=1)
    differences = (scores[finite, 0] - scores[finite, 0, :1]) / RATE
    np.testing.assert_allclose(differences, costs[finite, :1] - costs[finite], atol=1e-12)


def test_without_a_running_cost_the_terminal_cost_runs():
    problem = CART.replace(running_cost=None, terminal_cost=lambda x: x[0] ** 2)
    loop = ChargedLoop.of(capsyn.synthesize(problem), RATE, "auto", 1)
    x = problem.domain.sample(20, 0).T
    assert loop.end is None
    assert np.array_equal(loop.plant.running_cost.evaluate(x)[0][0], x[0] ** 2)


def test_exogenous_inputs_stay_as_they_are():
    policy = capsyn.synthesize(ROOMS)
    loop = ChargedLoop.of(policy, 1.0, "auto", 1).charging(1.0)
    rollouts = Rollouts.of(loop, 10)
    states = policy.space.sample(6, 4)
    costs = rollouts.costs(states)
    for b, state in enumerate(states):
        own = [reference(loop, state, i, 5, 10, True) for i in range(5)]
        np.testing.assert_allclose(costs[b, 0], own, rtol=1e-9)


def test_effort_and_prices_are_charged_times_a_scale():
    problem = CART.replace(**VARIANTS["price"])
    loop = ChargedLoop.of(capsyn.synthesize(problem), RATE, "auto", 1)
    states = problem.domain.sample(10, 5)
    zero, one, two = (loop.charging(scale).costs_from(states, 40) for scale in (0.0, 1.0, 2.0))
    np.testing.assert_allclose(two - one, one - zero, rtol=1e-9)
    assert (one > zero).all()
    run = capsyn.simulate(loop.policy, states, 40 / RATE, RATE, substeps=loop.loop.substeps)
    np.testing.assert_allclose(zero, run.costs[:, -1], rtol=1e-12)
    paid = 0.0
    efforts = np.append(0.05 * (CART.alphabet.values**2).sum(axis=1), 0.0)
    prices = loop.policy.rules.prices
    symbols = np.hstack([np.full((10, 1), -1), run.symbols])
    paid = (prices[symbols[:, :-1], symbols[:, 1:]] + efforts[symbols[:, 1:]]).sum(axis=1) / RATE
    np.testing.assert_allclose(one - zero, paid, rtol=1e-9)


def test_the_default_is_tried_where_the_policy_has_it():
    problem = CART.replace(
        settings=SsacSettings(rule="steepest", on_no_descent="default", control_weight=0.3),
        default=[0.2, 0.0],
    )
    rollouts = rollouts_of(problem, 10)
    assert rollouts.labels == (0, 1, 2, 3, 4)
    assert rollouts_of(CART, 10).labels == (0, 1, 2, 3)
