"""What tests make again and again is kept: exact trees of the same cells, golden sequences."""

import dataclasses
import functools
import hashlib

import numpy as np

from capsyn.compression.induction import induce
from capsyn.exports.sequence import run

TREES, SEQUENCES = 100, 24
"""Most that are kept."""


class _Asked:
    """Arguments of `induce`, equal where their contents are."""

    def __init__(self, cells, prices, budget):
        self.arguments = cells, prices, budget
        digest = hashlib.sha256(repr((cells.grid, prices.leaf_price, budget)).encode())
        for part in (cells, prices):
            for field in dataclasses.fields(part):
                value = getattr(part, field.name)
                if isinstance(value, np.ndarray):
                    digest.update(f"{field.name} {value.dtype} {value.shape}".encode())
                    digest.update(value.tobytes())
        self.key = digest.digest()

    def __hash__(self):
        return hash(self.key)

    def __eq__(self, other):
        return self.key == other.key


@functools.lru_cache(maxsize=TREES)
def _kept(asked):
    return induce(*asked.arguments)


def kept_induce(cells, prices, budget=None):
    """Return what `induce` does, made once for each content."""
    if cells.affine is not None:
        return induce(cells, prices, budget)
    return _kept(_Asked(cells, prices, budget))


class _Steps:
    """Arguments of `run`, equal where the same policy, rules and readings are."""

    def __init__(self, plan, readings, period):
        self.arguments = plan, readings, period
        factors = plan.scale.tobytes(), plan.offset.tobytes()
        rules = plan.safe, plan.nearest, plan.dwell, plan.outside_at_once, plan.hold_off
        # the policy is the same object, not another of equal content
        self.key = plan.policy, rules, factors, readings.shape, readings.tobytes(), period

    def __hash__(self):
        return hash(self.key)

    def __eq__(self, other):
        return self.key == other.key


@functools.lru_cache(maxsize=SEQUENCES)
def _kept_run(steps):
    return run(*steps.arguments)


def kept_run(plan, readings, period):
    """Return what `run` does, made once for each policy and the same readings."""
    return _kept_run(_Steps(plan, readings, period))
