"""Mutants of what encloses loops: each makes a false proof, or loses states, and is caught.

A run tries some of them, since each is a kernel of its own; with CAPSYN_ALL_MUTANTS set, all.
"""

import os
from unittest import mock

import numpy as np
import pytest

from capsyn.reach import kernel
from support.proofs.attack import attack, prove
from support.proofs.enclosure import enclosed
from support.proofs.random_loops import random_case

PLANE, SPACE = ("plane", "ball", "none", 4), ("space", "box", "half", 4)
FRICTION, TURNING = ("friction", "ball", "none", 4), ("torus", "ball", "none", 4)
ROOTS = ("roots", "box", "ball", 2)
CASES, LOOPS = 6, 400
"""Random loops that are tried on a mutant, and attacks on each."""
NOISY = {"no noise": (26,)}
"""Which loops else: few have an error that matters."""

MUTANTS = {
    "a slab too small": (
        FRICTION,
        ("face - reach - slack(face)", "face"),
        ("face + reach + slack(face)", "face"),
    ),
    "no remainder": (
        PLANE,
        ("rest[i] += ((most - least) / 2 + slack(least) + slack(most)) * half;", ""),
    ),
    "no remainder of boxes": (
        SPACE,
        ("rest[i] += ((most - least) / 2 + slack(least) + slack(most)) * half;", ""),
    ),
    "a label missed": (
        PLANE,
        ("            cut_below(c, t->second[node], &half, moved);\n", "            ;\n"),
    ),
    "a label of boxes missed": (
        SPACE,
        ("            cut_below(c, t->second[node], &half, moved);\n", "            ;\n"),
    ),
    "a vertex dropped": (PLANE, ("n = a->count + b->count;", "n = a->count + b->count - 1;")),
    "fewer vertices within": (PLANE, ("memcpy(v + 2 * which, best, sizeof best);", "")),
    "no error carried on": (PLANE, ("grown[i] += fabs(M[i * STATES + j]) * error[j];", "")),
    "no error at labels": (PLANE, ("p->error[i] + t->noise[i];", "t->noise[i];")),
    "no hold": (PLANE, ("t->holds[label] > 1 && (change || way)", "0")),
    "no delay": (PLANE, ("if (t->delay > 0 && p->held != label)", "if (0)")),
    "no noise": (PLANE, ("p->error[i] + t->noise[i];", "p->error[i];")),
    "one end of parameters": (PLANE, ("t->parameters[end * PARAMETERS + j]", "t->parameters[j]")),
    "nothing avoided": (ROOTS, ("        return AVOIDED;\n", "        ;\n")),
    "no wall": (PLANE, ("i < MOVING && crossed(a, &wall, i, sign)", "0")),
    "cells missed": (PLANE, ("at[0] <= last[0]; ++at[0]) { /*", "at[0] < last[0]; ++at[0]) { /*")),
    "another label in force": (PLANE, ("(t->layers > 1 ? p->held : 0)", "0")),
    "one copy of a turning axis": (TURNING, ("k <= greater(high, low)", "k <= low")),
}  # fmt: skip


def caught(kind, seeds):
    """Return the seed of the first case of which something is false, None where nothing is."""
    for seed in seeds:
        case = random_case(np.random.default_rng([8, seed]), kind)
        proof = prove(case, stays=False)
        if attack(case, proof, LOOPS, seed) or enclosed(case, proof, seed):
            return seed
    return None


SOME = MUTANTS if os.environ.get("CAPSYN_ALL_MUTANTS") else (
    "a slab too small", "a label missed", "no error carried on", "no hold", "nothing avoided",
    "cells missed",
)  # fmt: skip


@pytest.mark.parametrize("name", SOME)
def test_mutants_are_caught(name):
    kind, *changes = MUTANTS[name]
    plain = kernel.source

    def mutated(loop):
        text = plain(loop)
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        return text

    with mock.patch("capsyn.reach.kernel.source", mutated):
        assert caught(kind, NOISY.get(name, range(CASES))) is not None


@pytest.mark.parametrize("kind", [PLANE, SPACE])
def test_nothing_is_caught_of_what_is_not_mutated(kind):
    assert caught(kind, (*range(2), *NOISY["no noise"])) is None
