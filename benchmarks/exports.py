"""What exported C takes: bytes by processor, and nanoseconds per decision on this computer.

``lattice`` is timed from states, through its quantiser; its bytes are those from lattice steps, and
``counts`` are its integer readings.
"""

import ctypes
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from capsyn import compress, problems, synthesize
from capsyn.exports.c.sizes import sizes
from capsyn.exports.c.target import TARGET
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan

STATES = 100_000
ROUNDS = 20
CASES = [
    ("cart-pendulum", 4, "exact"),
    ("cart-pendulum", 4, "freedom"),
    ("cart-pendulum-4", 4, "exact"),
    ("double-tank-a", 4, "exact"),
    ("cart-pole", 2, "exact"),
]
STYLES = ("table", "nested", "grid")
ARITHMETICS = {
    "lattice": ({"arithmetic": "lattice"}, "double"),
    "double": ({"arithmetic": "double"}, "double"),
    "float": ({"arithmetic": "float"}, "float"),
    "counts": ({"readings": "int16"}, "int16_t"),
}
"""Options of the target, and the type of what it reads."""
CODES = [*((s, a) for s in STYLES for a in ("lattice", "double", "counts")), ("nested", "float")]
"""Codes that are timed."""
PROCESSORS = ("cortex-m0", "avr")
COUNTS = 4096
"""Counts of each axis where readings are counts."""
MOST_BYTES = {
    "exact": {"cortex-m0": 1200, "avr": 2500},
    "freedom": {"cortex-m0": 900, "avr": 2500},
}
"""Of the pendulum's `table` from lattice steps."""
LOOP = """
#include "{p}.h"
void loop(long count, const {type} *x, int16_t *symbols);
void loop(long count, const {type} *x, int16_t *symbols)
{{
    for (long i = 0; i < count; ++i) {{
        {p}_status status;
        symbols[i] = {p}_decide(x + {n} * i, &status);
    }}
}}
"""


def compiled(written, n, compiler, kind, directory):
    """Return the loop over decisions, compiled."""
    directory.mkdir()
    for name, content in written.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_bytes(content)
    prefix = prefix_of(written)
    (directory / "loop.c").write_text(LOOP.format(p=prefix, n=n, type=kind))
    command = [compiler, "-O2", "-std=c99", "-shared", "-fPIC", f"{prefix}.c", "loop.c"]
    subprocess.run([*command, "-o", "loop.so"], cwd=directory, check=True)
    return ctypes.CDLL(str(directory / "loop.so")).loop


def prefix_of(written):
    """Return what the header and the source are called."""
    (header,) = [name for name in written if name.endswith(".h")]
    return header.removesuffix(".h")


def nanoseconds(loops, readings, labels):
    """Return the nanoseconds per decision of each loop, best of rounds that take turns."""
    symbols, best = np.empty(STATES, np.int16), dict.fromkeys(loops, np.inf)
    for _ in range(ROUNDS):
        for (style, arithmetic, compiler), loop in loops.items():
            kind = ARITHMETICS[arithmetic][1]
            pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (readings[kind], symbols)]
            started = time.perf_counter()
            loop(ctypes.c_long(STATES), *pointers)
            seconds = time.perf_counter() - started
            key = (style, arithmetic, compiler)
            best[key] = min(best[key], seconds)
            if kind == "double" and not np.array_equal(symbols, labels):
                raise SystemExit(f"{style} {arithmetic} by {compiler} is wrong")
    return {key: 1e9 * seconds / STATES for key, seconds in best.items()}


def bytes_of(written, what, processors, limits):
    """Return the rows of what code takes, on processors that have a compiler here."""
    rows = []
    measured = sizes(written, prefix_of(written))
    for processor in processors:
        here = measured.get(processor, {})
        row = {"what": f"{what}, {processor}", "unit": "bytes"}
        most = limits.get(processor)
        if "decision" in here:
            rows.append({**row, "value": here["decision"], "wanted": most and f"<= {most}"})
        if "quantiser" in here:
            more = {**row, "what": f"{row['what']}, and its quantiser"}
            rows.append({**more, "value": here["quantiser"]})
    return rows


def measured_on(case, code):
    """Return the processors whose bytes of a code are measured, and the bytes wanted."""
    style, arithmetic = code
    pendulum = case[0] == "cart-pendulum"
    if style == "table" and arithmetic in ("lattice", "counts"):
        return PROCESSORS, MOST_BYTES[case[2]] if pendulum and arithmetic == "lattice" else {}
    return PROCESSORS[: pendulum and case[2] == "exact"], {}


def measure(name, level, mode):
    """Return the rows of one tree: bytes, and nanoseconds per decision."""
    tree = compress(synthesize(problems.plain(name), max_level=level), mode)
    domain, rows, loops = tree.domain, [], {}
    plain = Plan.of(tree)
    counted = Plan.of(tree, scale=domain.widths / COUNTS, offset=domain.lower)
    golden = golden_vectors(plain)
    states = domain.sample(STATES, 1)
    readings = {
        "double": states,
        "float": states.astype(np.float32),
        "int16_t": ((states - domain.lower) / domain.widths * COUNTS).astype(np.int16),
    }
    labels = tree.cells.labels(domain.locate(states, tree.cells.counts))
    with tempfile.TemporaryDirectory() as directory:
        for style, arithmetic in CODES:
            options, kind = ARITHMETICS[arithmetic]
            plan = counted if arithmetic == "counts" else plain
            written = TARGET.files(plan, golden, style=style, **options).files
            what = f"export c: {name} level {level} {mode}, {style} {arithmetic}"
            processors, limits = measured_on((name, level, mode), (style, arithmetic))
            if processors:
                rows += bytes_of(written, what, processors, limits)
            for compiler in ("gcc", "clang")[: 1 + ((style, arithmetic) == ("grid", "double"))]:
                if shutil.which(compiler):
                    place = Path(directory, f"{style}-{arithmetic}-{compiler}")
                    loop = compiled(written, plan.n, compiler, kind, place)
                    loops[style, arithmetic, compiler] = loop
        times = nanoseconds(loops, readings, labels)
    for (style, arithmetic, compiler), value in times.items():
        what = f"export c: {name} level {level} {mode}, {style} {arithmetic}, {compiler} -O2"
        wanted = "<= 30" if (style, arithmetic) == ("grid", "double") else ""
        rows.append({"what": f"{what}, a decision", "value": value, "unit": "ns", "wanted": wanted})
    return rows


def command():
    """Return the row of the command that exports to all targets, with its start."""
    seconds = []
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory, "p.cap")
        synthesize(problems.plain("cart-pendulum")).save(file)
        for k in range(3):
            run = [sys.executable, "-m", "capsyn", "export", file, "--to", "all"]
            started = time.perf_counter()
            subprocess.run([*run, "-o", Path(directory, str(k))], check=True, capture_output=True)
            seconds.append(time.perf_counter() - started)
    what = "export: all targets of cart-pendulum, whole command"
    return {"what": what, "value": sorted(seconds)[1], "unit": "s", "wanted": "<= 3"}


if __name__ == "__main__":
    print(json.dumps([command(), *(row for case in CASES for row in measure(*case))]))
