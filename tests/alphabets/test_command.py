"""The command ``capsyn alphabet``, and the way from it to a policy."""

from __future__ import annotations

import json

import pytest

from capsyn import Policy
from capsyn.alphabets.study import AlphabetStudy
from support.processes.command_line import capsyn, error_of

CART = """
import capsyn
problem = capsyn.Problem(
    name="cart", dynamics=lambda x, u: [x[1], u[0]], domain=capsyn.Box([-1, -1], [1, 1]),
    alphabet=capsyn.Alphabet([-2, 0, 2], inputs=["push"]), default=0, horizon=1.0,
    running_cost=lambda x: x[0]**2 + x[1]**2, target=capsyn.Ball([0, 0], 0.2), outside="nearest",
    partitions=3, max_level=1,
)
levels = [-2, -1, 0, 1, 2]
mine = [-1, 0.5, 2]
"""
QUICK = "--starts 8 --fresh 20 --duration 3 --rate 5".split()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "cart.py").write_text(CART)
    return tmp_path


def test_it_prints_the_table_and_writes_what_synth_takes(folder):
    files = ["--plot", "cart.png", "--report", "cart.html", "--max-solves", "900"]
    options = ["--candidates", "cart.py:levels", "--count", "2", "--own", "cart.py:mine"]
    weights = ["--objective", "cost,failures=2", "--objective", "switches=0.001"]
    out, err = capsyn("alphabet", "cart.py", *options, *weights, *files, *QUICK, cwd=folder)
    study = AlphabetStudy.load(folder / "cart-alphabet.json")
    assert err == "" and study.problem == "cart" and study.fresh == 20
    assert study.objective == {"cost": 1.0, "failures": 2.0, "switches": 0.001}
    assert study.count == 2 and len(study.candidates) >= 3
    assert study.alphabet.inputs == ("push",) and len(study.alphabet) <= study.count
    kinds = {row.kind for row in study.table}
    assert kinds == {"chosen", "own", "uniform", "random"}
    assert all(row.bytes and row.nodes and row.solves <= 900 for row in study.table)
    assert f"alphabet     {', '.join(study.alphabet.names)}" in out and "hint" not in out
    assert max(map(len, out.partition("alphabet ")[0].splitlines())) <= 80 and "(95 %)" in out
    assert out.splitlines()[-1] == (
        "wrote cart-alphabet.json, cart.png, cart.html; capsyn synth cart.py --alphabet "
        "cart-alphabet.json --max-solves 900 makes the policy"
    )
    assert (folder / "cart.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (folder / "cart.html").read_text()
    out, err = capsyn("synth", "cart.py", "--alphabet", "cart-alphabet.json", cwd=folder)
    assert err == "" and "chosen for cart from" in out
    policy = Policy.load(folder / "cart.cap")
    assert policy.alphabet == study.alphabet
    assert policy.statistics["alphabet"] == study.summary()


def test_kept_excluded_and_priced_symbols_as_json_and_again_from_a_storage(folder):
    options = ["--candidates", "cart.py:levels", "--count", "3", "--no-policies", "--json"]
    symbols = ["--keep", "0", "--exclude", "-2,2", "--price", "0=0.5", "--storage", "kept.db"]
    words = ["alphabet", "cart.py", *options, *symbols, *QUICK, "-o", "best.json"]
    data = json.loads(capsyn(*words, cwd=folder)[0])
    assert data["file"] == "best.json" and data["prices"] == {"0": 0.5}
    chosen = data["table"][0]
    assert chosen["kind"] == "chosen" and "0" in chosen["alphabet"]["names"]
    assert not {"-2", "2"} & set(data["alphabet"]["names"])
    assert chosen["cells"] is None and chosen["objective"] >= chosen["figures"]["cost"] + 0.5 - 1e-9
    text = (folder / "best.json").read_bytes()
    assert json.loads(capsyn(*words, cwd=folder)[0]) == data  # goes on where all is known
    assert (folder / "best.json").read_bytes() == text
    bare = [word for word in words if word not in ("--storage", "kept.db")]
    assert json.loads(capsyn(*bare, cwd=folder)[0]) == data


def test_a_box_and_combinations_of_inputs(folder):
    words = ["alphabet", "cart.py", *QUICK, "--count", "1,2", "--no-policies", "--json"]
    data = json.loads(capsyn(*words, "--box", "-1:1", "--steps", "3", cwd=folder)[0])
    assert data["candidates"]["values"] == [[-1], [0], [1]]
    assert {row["count"] for row in data["table"]} <= {1, 2} and data["count"] in (1, 2)
    assert all(-1 <= value <= 1 for (value,) in data["alphabet"]["values"])
    data = json.loads(capsyn(*words, "--combinations", "1", cwd=folder)[0])
    assert data["candidates"]["values"] == [[0], [-2], [2]]


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (["--duration", "0.2"], "% of the closed loops of the chosen alphabet succeed: weigh them"),
        (["--outside", "error"], "of 20 closed loops of the chosen alphabet are lost (out of the"),
    ],
)
def test_a_hint_says_that_loops_fail_and_what_to_do(folder, options, hint):
    words = ["alphabet", "cart.py", *QUICK, "--box=-1:1", "--steps", "2", "--count", "2"]
    out, _ = capsyn(*words, "--no-policies", *options, cwd=folder)
    (line,) = [line for line in out.splitlines() if line.startswith("hint ")]
    assert hint in line


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "candidates must be given by one of --candidates, --box, --combinations; got none"),
        (["--box", "-1:1", "--combinations", "2"], "got --box and --combinations"),
        (["--combinations", "1", "--steps", "3"], "--steps needs --box"),
        (["--combinations", "0"], "--combinations must be a whole number >= 1 and <= 1; got 0"),
        (["--box", "-1"], "--box must be LOW:HIGH for each input (push); got '-1'"),
        (["--box=5:-5"], "--box must be LOW:HIGH, finite and LOW < HIGH; got '5:-5'"),
        (["--box", "low:1"], "`--box` must be a number; got 'low'"),
        (["--box", "-1:1,-1:1"], "--box must be LOW:HIGH for each input (push); got '-1:1,-1:1'"),
        (["--candidates", "cart.py:none"], "'cart.py' must hold symbols named 'none'"),
        (["--box", "-1:1", "--count", "many"], "--count must be whole numbers such as 9 or 9,5"),
        (["--box", "-1:1", "--count", "0"], "`count` must be"),
        (["--box", "-1:1", "--objective", "speed=1"], "`objective` must be weights by name"),
        (["--box", "-1:1", "--objective", "cost=much"], "must be a number; got 'much'"),
        (["--box", "-1:1", "--price", "much"], "--price must be NAME=VALUE"),
        (["--box", "-1:1", "--own", "none.json"], "cannot read the alphabet 'none.json'"),
        (["--box", "-1:1", "--keep", "off"], "`keep`"),
        (["--box", "-1:1", "--fresh", "1"], "`fresh` must be a whole number >= 2"),
        (["--box", "-1:1", "--initial", "x9=0"], "x9"),
        (["--box", "-1:1", "--plot", "a.txt"], "--plot must end in .png, .pdf, .svg; got 'a.txt'"),
        (["--box", "-1:1", "--report", "a.md"], "--report must end in .html; got 'a.md'"),
        (["--box", "-1:1", "-o", "no/a.json"], "cannot write the output 'no/a.json'"),
    ],
)
def test_errors_are_one_line_and_nothing_is_written(folder, options, message):
    assert message in error_of("alphabet", "cart.py", *QUICK, *options, cwd=folder)
    assert [path.name for path in folder.iterdir() if path.suffix != ".py"] == []
