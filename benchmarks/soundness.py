"""Proofs of random loops, each attacked by many simulated ones: whether any claim is false.

``soundness.py CASES TRAJECTORIES`` tries so many; by default the figures of `run.py`.
"""

import json
import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import numpy as np

from capsyn.errors import ProblemError
from support.proofs.attack import attack, prove
from support.proofs.random_loops import KINDS, random_case

CASES, TRAJECTORIES = 10_000, 10_000
"""Random loops, and how many simulated ones attack the proof of each."""


def tried(seed, trajectories):
    """Return what came of a case: its seed, figures, seconds, and violations by name."""
    case = random_case(np.random.default_rng([21, seed]), KINDS[seed % len(KINDS)])
    began = time.process_time()
    try:
        proof = prove(case)
    except (ProblemError, ValueError) as error:  # no answer is no false one, and counts as none
        return {"seed": seed, "error": f"{type(error).__name__}: {error}"}
    proved = time.process_time()
    found = attack(case, proof, trajectories, seed)
    moving = int((proof.bound > 0).sum())
    return {
        "seed": seed,
        "share": proof.share,
        "claims": len(proof.held),
        "moving": moving,
        "stays": proof.staying is not None,
        "prove": proved - began,
        "attack": time.process_time() - proved,
        "violations": dict(Counter(violation.what for violation in found)),
    }


def row(what, value, unit="", wanted=""):
    return {"what": what, "value": value, "unit": unit, "wanted": wanted}


def main(cases, trajectories, first=0):
    """Try cases on all processors, and print rows."""
    results = []
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        seeds = range(first, first + cases)
        for result in pool.map(tried, seeds, [trajectories] * cases, chunksize=4):
            results.append(result)
            if "error" in result or result["violations"] or len(results) % 100 == 0:
                print(len(results), result, file=sys.stderr, flush=True)
    errors = sum("error" in result for result in results)
    results = [result for result in results if "error" not in result]
    false = sum(bool(result["violations"]) for result in results)
    some = [result for result in results if result["moving"]]
    shares = [result["share"] for result in results]
    title = f"{cases:,} random loops, {trajectories:,} attacks on each"
    rows = [
        row(f"{title}: false proofs", false, "", "<= 0"),
        row(f"{title}: refused or failed", errors, "", "<= 0"),
        row(f"{title}: with something proved outside the target", len(some)),
        row(f"{title}: mean share proved to arrive", 100 * float(np.mean(shares)), "%"),
        row(f"{title}: proved to stay", sum(result["stays"] for result in results)),
        row(f"{title}: boxes proved", sum(result["claims"] for result in results)),
        row(f"{title}: a proof", float(np.mean([r["prove"] for r in results])), "s"),
        row(f"{title}: an attack", float(np.mean([r["attack"] for r in results])), "s"),
    ]
    print(json.dumps(rows))


if __name__ == "__main__":
    main(*(map(int, sys.argv[1:]) if len(sys.argv) > 1 else (CASES, TRAJECTORIES)))
