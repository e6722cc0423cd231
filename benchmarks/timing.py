"""How long decisions of exported C take on emulated processors: at most, and over random states.

From lattice steps to a symbol, by style: cycles of an AVR (simavr), instructions of a Cortex-M3
(QEMU). The longest decision is found from the tree; that of random states must not be longer.
"""

import json

import numpy as np

from capsyn import compress, problems, synthesize
from capsyn.exports.c.target import STYLES, TARGET
from capsyn.exports.c.timing.emulators import MACHINES, longest
from capsyn.exports.c.timing.states import longest_steps
from capsyn.exports.plan import Plan

STATES = 100_000
NOT_OF = {"freedom": ("cells",), "affine": ("grid",)}
"""Styles that are not for such policies, or too large."""
CASES = [
    ("cart-pendulum", 4, "exact"),
    ("cart-pendulum", 4, "freedom"),
    ("double-tank-a", 4, "exact"),
    ("cart-pole", 2, "exact"),
    ("cart-pendulum", 3, "affine"),
]
"""Problem, level, and mode of its tree; or affine leaves."""


def measure(name, level, mode):
    """Yield the rows of one policy."""
    leaves = "affine" if mode == "affine" else "constant"
    policy = synthesize(problems.plain(name), max_level=level, leaves=leaves)
    own = Plan.of(compress(policy, mode) if mode == "freedom" else policy)
    some = np.random.default_rng(1).integers(own.counts, size=(STATES, own.n))
    for style in STYLES if mode == "exact" else [s for s in STYLES if s not in NOT_OF[mode]]:
        plan = own.written(style == "cells")
        tree = plan.cells
        files = TARGET.files(plan, None, style=style).files
        (header,) = [file for file in files if file.endswith(".h")]
        steps, exact = longest_steps(tree, style)
        for processor, machine in MACHINES.items():
            if not machine.here:
                continue
            call = (machine, files, header[:-2], "symbol", "int16_t")
            worst = longest(*call, steps)
            if worst is None:  # tables that the processor does not reach
                continue
            seen = longest(*call, some)
            what = f"export c: {name} level {level} {mode}, {style}, {processor}, a decision"
            at = f"at {steps[worst.row].tolist()}" + ("" if exact else ", of those seen")
            yield {"what": f"{what}, longest ({at})", "value": worst.time, "unit": machine.unit}
            yield {
                "what": f"{what}, longest of {STATES:,} random states",
                "value": seen.time,
                "unit": machine.unit,
                "wanted": f"<= {worst.time}",
            }


if __name__ == "__main__":
    print(json.dumps([row for case in CASES for row in measure(*case)]))
