"""Go through the whole command line on one small problem, in the folder that is the argument.

Prints a line of JSON: the commands with their exit status and what they print, and whether POSIX
is hidden here.
"""

import contextlib
import io
import json
import os
import sys
import warnings

BOAT = """
import capsyn
problem = capsyn.Problem(
    name="boat", dynamics=lambda x, u: [x[1], u[0] - x[1] / 2],
    domain=capsyn.Box([-1, -1], [1, 1], names=["\\u03b8", "\\u03c9"]),
    alphabet=capsyn.Alphabet([-1, 0, 1], names=["\\u2190", "0", "\\u2192"]), default=0,
    horizon=2.0, running_cost=lambda x: x[0]**2 + x[1]**2, target=capsyn.Ball([0, 0], 0.4),
    settings=capsyn.SsacSettings(steps=8, rule="steepest"), partitions=5, max_level=1,
    outside="nearest",
)
"""
TABLE = "x,y,u\n0,0,-1\n0,1,1\n1,0,1\n1,1,1\n"
COMMANDS = """
list
synth boat.py -o p.cap --checkpoint kept
synth boat.py -o again.cap --checkpoint kept
info p.cap
query p.cap 0.5 0.25
simulate p.cap --x0 0.5,0.25 --rate 16 --duration 2 -o t.csv
verify p.cap --monte-carlo 20 --rate 16 --duration 4 --seed 1
certify p.cap --initial \u03b8=-0.1:0.1,\u03c9=-0.1:0.1 --rate 16 --counts 8,8 --certificate c.zip
check c.zip p.cap
switching p.cap --rate 16
automaton p.cap -o a.dot
compress p.cap --mode exact -o e.cap
improve p.cap --starts 4 --duration 2 --rate 8 --horizons 1 -o i.cap
export e.cap --to c -o c
export p.cap --to python -o python
export p.cap --to javascript -o javascript
export p.cap --to structured-text -o st
export e.cap --to verilog -o verilog
export p.cap --to json -o json
plot p.cap -o p.svg
explore p.cap -o p.html
import table.csv -o table.cap
info table.cap
info missing.cap
doctor
"""


def seconds():
    """Return the processor time of this process and those that it started."""
    return sum(os.times()[:4])


def call(words):
    """Return how one command ends, what it prints, and its processor time."""
    from capsyn.cli.app import main

    out, err = (io.TextIOWrapper(io.BytesIO(), "cp1252", write_through=True) for _ in range(2))
    sys.argv, status, started = ["capsyn", *words], 0, seconds()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        warnings.resetwarnings()
        try:
            main()
        except SystemExit as stopped:
            status = stopped.code or 0
    texts = [stream.buffer.getvalue().decode("cp1252") for stream in (out, err)]
    return [" ".join(words), status, *texts, seconds() - started]


def go_through(folder):
    """Run all commands in a folder, and print what became of them."""
    os.chdir(folder)
    for name, text in (("boat.py", BOAT), ("table.csv", TABLE)):
        with open(name, "w", encoding="utf-8") as file:
            file.write(text)
    done = [call(line.split()) for line in COMMANDS.strip().splitlines()]
    from capsyn.native import build

    print(json.dumps({"done": done, "posix": hasattr(build.os, "getuid")}))


if __name__ == "__main__":
    go_through(sys.argv[1])
