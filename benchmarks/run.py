"""Run every benchmark in its own process; write README.md and results.json beside this file.

``run.py QUESTION ..`` measures some of them again, and keeps the others' rows.
"""

import json
import platform
import subprocess
import sys
from pathlib import Path

from capsyn.native.build import find_compiler
from capsyn.version import __version__

HERE = Path(__file__).parent
QUESTIONS = (
    "solve synthesis dimensions lookup compression sources tails improve optimum told inverter "
    "closed_loop explorer command counts exports timing cluster"
).split()

INTRODUCTION = """# Benchmarks

`make bench` runs one script per question, each in a process of its own, and writes this file and
`results.json`. Times are medians; trust the ratios, which are measured within one run, more than
the times. "Wanted" is what the project asks of itself on two cores.
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


def page(setting, rows):
    """Return the lines of README.md: a table for each question."""
    lines = [INTRODUCTION, *(f"- {key}: {value}" for key, value in setting.items())]
    for question in QUESTIONS:
        title = question.replace("_", " ").capitalize()
        lines += ["", f"## {title}", "", "| what | figure | wanted | met |", "|---|---|---|---|"]
        for row in rows:
            if row["question"] != question:
                continue
            value, wanted = row["value"], row.get("wanted") or ""
            figure = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
            lines.append(
                f"| {row['what']} | {figure} {row['unit']} | {wanted} | {met(value, wanted)} |"
            )
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
