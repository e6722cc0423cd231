"""Certificates that are changed, a bit each: whether the checker refuses them all.

``tampering.py COUNT`` tries so many, 1,000 unless told.
"""

import json
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import numpy as np

from support.proofs.tampering import CHANGES, proof_arrays, proved_case, refusal, tampered

LOOPS = (42, 44, 79, 116, 331)
"""Loops of linear plants known exactly, whose proofs have no room: with memory, holds, delay and
noise, of cells and trees."""


def main(count):
    """Change proofs in all ways in turn, and print rows."""
    tried = refused = 0
    began, names = time.perf_counter(), []
    with tempfile.TemporaryDirectory() as folder:
        proofs = [(proved_case(k)[0], proof_arrays(k, f"{folder}/{k}")) for k in LOOPS]
    assert all(refusal(*proof) is None for proof in proofs)
    rng, number = np.random.default_rng(0), 0
    while tried < count:
        case, arrays = proofs[number % len(proofs)]
        change = CHANGES[number // len(proofs) % len(CHANGES)]
        number += 1
        changed = tampered(arrays, change, rng)
        if changed is None:
            continue
        tried += 1
        if refusal(case, changed) is None:
            names.append(change.__name__)
        else:
            refused += 1
    seconds = time.perf_counter() - began
    rows = [
        {"what": f"{tried:,} changed certificates: refused", "value": refused, "unit": "",
         "wanted": f"{tried:,}"},
        {"what": "changed certificates gone through", "value": tried / seconds, "unit": "1 / s",
         "wanted": ""},
    ]  # fmt: skip
    print(json.dumps(rows))
    if names:
        print(", ".join(sorted(set(names))), file=sys.stderr)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
