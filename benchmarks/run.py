"""Run every benchmark in its own process; write README.md and results.json beside this file.

``run.py QUESTION ..`` measures some of them again, and keeps the others' rows.
"""

import json
import platform
import subprocess
import sys
from pathlib import Path

from capsyn.native.compiler import find_compiler
from capsyn.version import __version__

HERE = Path(__file__).parent
QUESTIONS = (
    "solve synthesis dimensions lookup compression sources tails improve tune alphabet_gains "
    "sparsity loop_trees optimum limits certify told inverter coordinates closed_loop explorer "
    "command counts exports timing cluster"
).split()

FIRST = {
    "solve": (
        "one solve: capsyn c, double, 1 thread",
        "one solve: capsyn c, double over CasADi JIT (scalar C), 1 thread",
    ),
    "command": ("capsyn synth cart-pendulum, warm kernel cache",),
    "lookup": ("lookup: cart-pendulum level 4, c, 1 core",),
    "closed_loop": ("closed loop: cart-pendulum, 1,000 trials of 15 s at 1 kHz, all processors",),
    "tails": (
        "planar quadrotor with a tail, within 0.2 of the origin from 10 to 20 s: success",
        "cart-pole with a tail, starts within 5 % of the domain, up for 10 s: success",
        "docking with 9 symbols with a tail, arrived within 60 s: success",
        "docking with 9 symbols with a tail, arrived within 60 s: mean fuel",
        "quadrotor, one cell, starts from 0.6 of the domain, within 0.3 m from 6 s: success",
    ),
    "improve": (
        "double-tank-a, 2 round(s): cost over the optimum's",
        "cart-pendulum, 2 round(s): cost over the optimum's",
        "boost-converter, 2 round(s): cost over the optimum's",
    ),
    "tune": (
        "docking, 3 weights 10 times what does well, 40 settings: success",
        "docking, 3 weights 10 times what does well, 40 settings: mean fuel",
        "cart-pendulum, 24 prices of a switch: switches there",
    ),
    "loop_trees": (
        "docking, judged by loops, as small as may be: nodes",
        "docking, judged by loops, as small as may be: success of 1,000 loops",
        "docking, judged by loops, as small as may be: mean fuel",
    ),
    "limits": tuple(
        f"boost converter, at most 4.5 A at 100 kHz, 576 x 576 cells: {what}"
        for what in (
            "share of the domain",
            "synthesis",
            "1,000,000 trials that break it",
            "cost over the plain policy's",
        )
    ),
    "certify": (
        "double-tank-b, [0.1, 0.9]^2, 1 kHz: proved to arrive",
        "double-tank-b, [0.1, 0.9]^2, 1 kHz: took",
        "boost-converter, 200 kHz, hold 10 us: proved to arrive",
        "boost-converter, 200 kHz, hold 10 us: took",
    ),
    "told": (
        "building, law as default: largest mean error of 1,000 days",
        "boost converter told its load: largest mean error, 30 to 50 V, 10 to 40 ohm",
    ),
    "inverter": ("inverter told 10 A: rms error over online control's",),
    "exports": (
        "export c: cart-pendulum level 4 exact, table lattice, cortex-m0",
        "export c: cart-pendulum level 4 exact, grid double, gcc -O2, a decision",
    ),
}
"""The rows that a reader wants first, of each question."""

INTRODUCTION = """# Benchmarks

With this page you can judge how fast capsyn is, how good its policies are, and how small they
get.

`make bench` runs one script for each question, each script in a process of its own. It writes
this file and `results.json`. Times are medians. Trust the ratios more than the times, since each
ratio is measured within one run. The column "wanted" is what the project asks of itself on two
cores. A question that was not measured again keeps its rows, so some rows come from another machine
than the last one, which is named here:
"""


def machine():
    """Return what the figures were measured on."""
    model = platform.processor() or platform.machine()
    cpu = Path("/proc/cpuinfo")
    cores = 0
    if cpu.exists():
        lines = [line.partition(":") for line in cpu.read_text().splitlines()]
        models = [value.strip() for key, _, value in lines if key.strip() == "model name"]
        model, cores = models[0] if models else model, len(models)
    return {
        "machine": f"{model}, {cores or '?'} processors, {platform.system()} {platform.machine()}",
        "compiler": find_compiler().version,
        "python": platform.python_version(),
        "capsyn": __version__,
    }


def met(value, wanted):
    """Return whether a figure meets a bound such as "<= 0.65"; nothing where there is none."""
    sign, _, bound = wanted.partition(" ")
    if sign not in ("<=", ">="):
        return ""
    return "yes" if (value <= float(bound) if sign == "<=" else value >= float(bound)) else "**no**"


def measured(question):
    """Return the rows of a question."""
    print(f"{question} ...", flush=True)
    run = subprocess.run(
        [sys.executable, str(HERE / f"{question}.py")], capture_output=True, text=True
    )
    if run.returncode:
        sys.exit(f"{question} failed:\n{run.stderr}")
    return [{"question": question, **row} for row in json.loads(run.stdout.splitlines()[-1])]


def table(title, rows):
    """Return the lines of a table under its title."""
    lines = ["", f"## {title}", "", "| what | figure | wanted | met |", "|---|---|---|---|"]
    for row in rows:
        value, wanted = row["value"], row.get("wanted") or ""
        figure = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
        what = row["what"].replace("|", r"\|")
        cells = what, f"{figure} {row['unit']}", wanted, met(value, wanted)
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def page(setting, rows):
    """Return the lines of README.md: a table of what matters most, and one for each question."""
    lines = [INTRODUCTION, *(f"- {key}: {value}" for key, value in setting.items())]
    named = {(row["question"], row["what"]): row for row in rows}
    wanted = [(question, what) for question in FIRST for what in FIRST[question]]
    measured = {row["question"] for row in rows}
    missing = [what for question, what in wanted if (question, what) not in named]
    for question, what in wanted:
        if (question, what) not in named and question in measured:
            sys.exit(f"no question has the row {what!r}, which is to be among the first")
    if missing:
        print(f"not measured yet, of what is to be among the first: {', '.join(missing)}")
    lines += table("First of all", [named[key] for key in wanted if key in named])
    for question in QUESTIONS:
        title = question.replace("_", " ").capitalize()
        lines += table(title, [row for row in rows if row["question"] == question])
    return lines


def main(questions):
    """Measure some questions, or all, and write; what is not measured again stays."""
    unknown = [question for question in questions if question not in QUESTIONS]
    if unknown:
        sys.exit(f"questions are {', '.join(QUESTIONS)}; got {unknown[0]}")
    results = HERE / "results.json"
    old = json.loads(results.read_text())["rows"] if questions else []
    setting, rows = machine(), []
    for question in QUESTIONS:
        again = not questions or question in questions
        kept = [row for row in old if row["question"] == question]
        rows += measured(question) if again else kept
    (HERE / "README.md").write_text("\n".join(page(setting, rows)) + "\n")
    results.write_text(json.dumps({**setting, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
