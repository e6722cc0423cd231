"""Run every benchmark in its own process; write README.md and results.json beside this file."""

import json
import platform
import subprocess
import sys
from pathlib import Path

from capsyn.native.build import find_compiler
from capsyn.version import __version__

HERE = Path(__file__).parent
QUESTIONS = (
    "solve synthesis dimensions lookup compression sources told inverter closed_loop explorer "
    "command counts exports timing cluster"
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


def main():
    """Measure and write."""
    setting, rows = machine(), []
    for question in QUESTIONS:
        print(f"{question} ...", flush=True)
        run = subprocess.run(
            [sys.executable, str(HERE / f"{question}.py")], capture_output=True, text=True
        )
        if run.returncode:
            sys.exit(f"{question} failed:\n{run.stderr}")
        rows += json.loads(run.stdout.splitlines()[-1])
    lines = [INTRODUCTION]
    lines += [f"- {key}: {value}" for key, value in setting.items()]
    lines += ["", "| what | figure | wanted | met |", "|---|---|---|---|"]
    for row in rows:
        value = row["value"]
        figure = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
        wanted = row.get("wanted") or ""
        lines.append(
            f"| {row['what']} | {figure} {row['unit']} | {wanted} | {met(value, wanted)} |"
        )
        print(lines[-1])
    (HERE / "README.md").write_text("\n".join(lines) + "\n")
    (HERE / "results.json").write_text(json.dumps({**setting, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
