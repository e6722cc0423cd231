"""Exported C of policies that remember the symbol in force: rows, timers, the caller's state."""

import dataclasses
import functools

import numpy as np
import pytest

import capsyn
from capsyn import problems
from capsyn.errors import ProblemError
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.target import TARGET as c
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.sequence import golden_sequence
from support.exports.c_machines import Library, avr, cortex_m3, need
from support.exports.c_plans import UNDEFINED, made, policy, remembering

INPUTS = {"fan": 0.4, "valve": 1.0, "valve on": 0.7, "default": 0.5}
FORBIDDEN = (("off", "both"), ("both", "off"), ("valve on", "fan on"))
KINDS = {
    "rows": {},
    "holds": {"hold": (0.2, 0.5, 0.1, 0.2)},
    "inputs": {"hold": INPUTS},
    "forbidden": {"hold": {"valve": 0.6}, "forbidden": FORBIDDEN},
    "ways": {"forbidden": FORBIDDEN},
    "many": {"symbols": 300, "hold": {"7": 0.3}},
}
OPTIONS = [
    {"style": style, "arithmetic": arithmetic}
    for style in ("table", "nested", "grid", "cells")
    for arithmetic in ("lattice", "double", "float")
] + [
    {"style": style, "readings": readings}
    for style in ("table", "nested", "grid", "cells")
    for readings in ("int16", "int32")
]


@functools.cache
def plan_of(kind, counts=False, hold_off=0.0, safe="valve on"):
    source = remembering(**KINDS[kind])
    scale = source.domain.widths / 1000 if counts else None
    return Plan.of(source, scale=scale, hold_off=hold_off, safe=safe if kind != "many" else 7)


def check(plan, directory, compiler="gcc", **options):
    """Assert that C gives golden vectors and sequences, whatever number ticks begin with."""
    golden = golden_vectors(plan)
    period = golden_sequence(plan).period
    code = made(plan, golden, tick=period, **options)
    vectors = code.golden or golden
    runs = code.sequence or golden_sequence(plan)
    library = Library(code.files, directory, plan.n, compiler, ["-O1", *UNDEFINED[1:]])
    if plan.policy.remembers:
        symbols, statuses = library.next(vectors.in_force, vectors.readings)
        lost = np.where(vectors.in_force == plan.default, -1, vectors.in_force)
        assert np.array_equal(library.next(lost, vectors.readings)[0], symbols)
        if options.get("arithmetic", "lattice") == "lattice":
            found = vectors.statuses == 0
            looked = library.look(vectors.steps[found], vectors.in_force[found])
            assert np.array_equal(looked, vectors.labels[found])
    else:
        symbols, statuses = library.decide(vectors.readings)
    assert np.array_equal(symbols, vectors.labels)
    assert np.array_equal(statuses, vectors.statuses)
    steps = runs.labels.shape[1]
    for readings, labels in zip(runs.readings, runs.labels):
        now = (np.arange(steps) + (1 << 32) - 100) % (1 << 32)
        assert np.array_equal(library.run(readings, now), labels)
    return code, runs


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("options", OPTIONS, ids=lambda o: " ".join(o.values()))
def test_every_option(kind, options, tmp_path):
    check(plan_of(kind, "readings" in options), tmp_path, **options)
