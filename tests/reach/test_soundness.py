"""Proofs of random loops, attacked: none is false. More are in ``benchmarks/soundness.py``."""

import numpy as np
import pytest

from support.proofs.attack import attack, prove
from support.proofs.enclosure import enclosed
from support.proofs.random_loops import random_case

KINDS = [
    ("line", "ball", "half", 4),
    ("plane", "ball", "none", 4),
    ("friction", "box", "ball", 2),
    ("torus", "condition", "half", 4),
    ("space", "box", "half", 4),
    ("told", "ball", "none", 4),
]
CASES, LOOPS = 4, 1000
SEEDS = {"torus": (4, 8, 11), "told": (1, 2, 3, 8)}  # of the others nothing is proved


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind[0])
def test_no_proof_is_false(kind):
    moving = 0
    for seed in SEEDS.get(kind[0], range(CASES)):
        case = random_case(np.random.default_rng([9, seed]), kind)
        proof = prove(case)
        assert attack(case, proof, LOOPS, seed) == []
        assert enclosed(case, proof, seed) == []
        moving += int((proof.bound > 0).sum())
    assert moving >= 5


def test_attacks_find_what_is_claimed_too_early():
    """The same proofs with a bound halved, or a box larger, are false."""
    found = 0
    for seed in range(CASES):
        case = random_case(np.random.default_rng([9, seed]), KINDS[0])
        proof = prove(case, stays=False)
        if not (proof.bound > 4 * case.period).any():
            continue
        proof.bound = proof.bound / 2
        found += bool(attack(case, proof, LOOPS, seed))
    assert found >= 3
