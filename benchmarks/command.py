"""How long whole commands take in fresh processes, with an empty and with a warm kernel cache."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROUNDS = 7


def seconds_of(command, environment, directory):
    started = time.perf_counter()
    subprocess.run(command, env=environment, cwd=directory, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def measure():
    """Return rows of seconds, medians over several fresh processes."""
    capsyn = [sys.executable, "-m", "capsyn", "synth", "cart-pendulum", "-o", "policy.cap"]
    times = {"empty": [], "warm": [], "without": [], "import": [], "nothing": []}
    with tempfile.TemporaryDirectory() as directory:
        for k in range(ROUNDS):
            cache = Path(directory) / f"cache-{k}"
            environment = os.environ | {"CAPSYN_CACHE_DIR": str(cache)}
            times["empty"].append(seconds_of(capsyn, environment, directory))
            times["warm"].append(seconds_of(capsyn, environment, directory))
            alone = environment | {"PATH": "", "CC": ""}
            times["without"].append(seconds_of(capsyn, alone, directory))
            for name, code in (("import", "import capsyn"), ("nothing", "pass")):
                times[name].append(seconds_of([sys.executable, "-c", code], environment, directory))
    median = {name: float(np.median(values)) for name, values in times.items()}
    return [
        {
            "what": "capsyn synth cart-pendulum, empty kernel cache",
            "value": median["empty"],
            "unit": "s",
            "wanted": "<= 2.5",
        },
        {
            "what": "capsyn synth cart-pendulum, warm kernel cache",
            "value": median["warm"],
            "unit": "s",
            "wanted": "<= 1.0",
        },
        {
            "what": "capsyn synth cart-pendulum, no compiler",
            "value": median["without"],
            "unit": "s",
            "wanted": "<= 5",
        },
        {
            "what": "python -c 'import capsyn', whole process",
            "value": median["import"],
            "unit": "s",
            "wanted": "<= 0.35",
        },
        {"what": "python -c 'pass', whole process", "value": median["nothing"], "unit": "s"},
    ]


if __name__ == "__main__":
    print(json.dumps(measure()))
