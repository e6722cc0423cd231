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
CASES = [
    ("cart-pendulum", 4, "exact"),
    ("cart-pendulum", 4, "freedom"),
    ("double-tank-a", 4, "exact"),
    ("cart-pole", 2, "exact"),
]


def measure(name, level, mode):
    """Yield the rows of one tree."""
    plan = Plan.of(compress(synthesize(problems.get(name), max_level=level), mode))
    tree = plan.tree.cells
    some = np.random.default_rng(1).integers(tree.counts, size=(STATES, plan.n))
    for style in STYLES:
        files = TARGET.files(plan, None, style=style).files
        (header,) = [file for file in files if file.endswith(".h")]
        steps, exact = longest_steps(tree, style)
        for processor, machine in MACHINES.items():
            if not machine.here:
                continue
            call = (machine, files, header[:-2], "symbol", "int16_t")
            worst, seen = longest(*call, steps), longest(*call, some)
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
