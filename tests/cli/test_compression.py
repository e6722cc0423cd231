"""`capsyn compress`, `capsyn automaton` and what `capsyn info` says about both."""

import csv
import json

import numpy as np
import pytest

from capsyn import DecisionTree, Policy, problems, synthesize
from support.processes.command_line import capsyn, error_of


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("compression") / "pendulum.cap"
    synthesize(problems.plain("cart-pendulum"), max_level=2).save(path)
    return path


def test_exact_trees_are_written_where_they_are_wanted(pendulum, tmp_path):
    out, _ = capsyn("compress", pendulum, "-o", tmp_path / "t.cap")
    assert f"wrote {tmp_path / 't.cap'}" in out and "equal to the policy in every cell" in out
    capsyn("compress", pendulum, cwd=tmp_path)
    assert (tmp_path / "pendulum-exact.cap").read_bytes() == (tmp_path / "t.cap").read_bytes()
    tree, policy = Policy.load(tmp_path / "t.cap"), Policy.load(pendulum)
    assert isinstance(tree, DecisionTree) and tree.guarantee.mode == "exact"
    states = policy.domain.sample(20_000, 1)
    np.testing.assert_array_equal(tree(states), policy(states))


def test_a_tree_file_works_wherever_a_policy_file_does(pendulum, tmp_path):
    tree = tmp_path / "t.cap"
    capsyn("compress", pendulum, "--mode", "freedom", "-o", tree)
    data = json.loads(capsyn("info", tree, "--json")[0])
    assert data["guarantee"]["mode"] == "freedom" and "cells" not in data
    assert data["complexity"]["tree"]["nodes"] == data["nodes"]
    assert data["complexity"]["table"] is None
    for command in (
        ("query", tree, "3.0", "0.5"),
        ("plot", tree, "-o", tmp_path / "t.png"),
        ("simulate", tree, "--x0", "3,0", "--duration", "1"),
        ("verify", tree, "--monte-carlo", "5", "--within", "1", "--agreement", "1000", "--save"),
        ("automaton", tree, "-o", tmp_path / "t.svg"),
    ):
        capsyn(*command)
    assert "agreement" in Policy.load(tree).evidence


FEATURES = """
import casadi as ca
features = {
    "energy": lambda x: 2 * x[1] ** 2 + 19.62 * (ca.cos(x[0]) - 1),
    "cos(theta) * omega": lambda x: ca.cos(x[0]) * x[1],
}
more = features | {"log": lambda x: ca.log(x[1])}
number = 3
"""


def test_features_come_from_a_file(pendulum, tmp_path):
    (tmp_path / "law.py").write_text(FEATURES)
    tree = tmp_path / "t.cap"
    out, _ = capsyn("compress", pendulum, "--features", tmp_path / "law.py", "-o", tree)
    assert "features     energy, cos(theta) * omega: " in out and "(proved)" in out
    policy, made = Policy.load(pendulum), Policy.load(tree)
    states = policy.domain.sample(5000, 1)
    np.testing.assert_array_equal(made(states), policy(states))
    data = json.loads(capsyn("info", tree, "--json")[0])
    assert data["features"]["names"] == ["energy", "cos(theta) * omega"]
    for command in (
        ("query", tree, "3.0", "0.5"),
        ("plot", tree, "-o", tmp_path / "t.png"),
        ("simulate", tree, "--x0", "3,0", "--duration", "1"),
        ("verify", tree, "--monte-carlo", "5", "--within", "1", "--agreement", "1000", "--save"),
        ("export", tree, "--to", "python", "-o", tmp_path / "made"),
    ):
        capsyn(*command)
    assert "agreement" in Policy.load(tree).evidence
    for given, message in (
        ("law.py:number", "'law.py' must hold a dict of functions named 'number'"),
        ("law.py:none", "'law.py' must hold a dict of functions named 'none'"),
        ("law", "features must be given as FILE.py or FILE.py:NAME; got 'law'"),
        ("law.py:more", "`features['log']` must be a number below 1e+150 all over the domain"),
        ("no.py", "there is no file 'no.py'"),
    ):
        command = ("compress", pendulum, "--features", given, "-o", tmp_path / "no.cap")
        assert message in error_of(*command, cwd=tmp_path)
    assert not (tmp_path / "no.cap").exists()
    assert "takes no --features" in error_of(
        "compress", pendulum, "--curve", "--features", tmp_path / "law.py"
    )


def test_freedom_is_judged_and_smaller(pendulum, tmp_path):
    sizes = {}
    for price in ("0", "0.5", "10"):
        out, _ = capsyn(
            "compress", pendulum, "--mode", "freedom", "--node-price", price,
            "-o", tmp_path / "t.cap", "--json",
        )  # fmt: skip
        data = json.loads(out)
        assert data["guarantee"]["states"] == 100_000 and data["guarantee"]["controller"] == "ssac"
        sizes[price] = data["nodes"]
    assert sizes["10"] < sizes["0.5"] < sizes["0"]


def test_a_missed_agreement_is_told_and_sets_the_status(pendulum, tmp_path):
    path = tmp_path / "t.cap"
    out, error = capsyn(
        "compress", pendulum, "--mode", "freedom", "--agreement", "0.999", "-o", path, code=1
    )
    assert f"wrote {path}" in out and not Policy.load(path).guarantee.reached
    assert error.startswith("warning: an agreement of 0.999 was not reached")
    assert "max_level" in error and error.count("\n") == 1


def test_info_tells_the_complexity_unless_it_is_quick(pendulum):
    data = json.loads(capsyn("info", pendulum, "--json")[0])["complexity"]
    assert data["automaton"]["regions"] == 2 and data["automaton"]["edges"] == 4
    assert data["tree"]["mode"] == "exact" and data["table"]["comparisons"] == 4 + 4 + 2 * 2
    assert "complexity" not in json.loads(capsyn("info", pendulum, "--quick", "--json")[0])
    text, _ = capsyn("info", pendulum)
    assert "connected partitions" in text and "exact tree" in text
    assert "connected partitions" not in capsyn("info", pendulum, "--quick")[0]


def test_automata_are_printed_and_drawn(pendulum, tmp_path):
    out, _ = capsyn("automaton", pendulum, "-o", tmp_path / "a.dot")
    assert "region A1" in out and "slides on" in out
    assert (tmp_path / "a.dot").read_text().count("->") == 4
    data = json.loads(capsyn("automaton", pendulum, "--json")[0])
    assert len(data["edges"]) == 4 and len(data["vertices"]) == 2
    assert "must end in .dot" in error_of("automaton", pendulum, "-o", tmp_path / "a.gif")


@pytest.fixture(scope="module")
def boat(tmp_path_factory):
    """Return a policy file without a model: linear trees of it are fitted fast."""
    import capsyn as package

    path = tmp_path_factory.mktemp("curve") / "boat.cap"
    box = package.Box([-1, -1], [1, 1])
    package.subdivide(
        lambda x: (x[:, 0] + 0.3 * x[:, 1] > 0.1).astype(int), box, 2, partitions=3, max_level=2
    ).save(path)
    return path


def test_a_curve_is_a_table_and_a_picture(boat, tmp_path):
    out, _ = capsyn("compress", boat, "--curve", "--states", "20000", cwd=tmp_path)
    assert "wrote boat-curve.csv and boat-curve.png" in out
    with open(tmp_path / "boat-curve.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert (tmp_path / "boat-curve.png").read_bytes().startswith(b"\x89PNG")
    modes = [row["mode"] for row in rows]
    assert modes.count("cells") == modes.count("exact") == 3 and modes.count("freedom") == 9
    assert "linear" in modes
    best = [row for row in rows if row["smallest"] == "True"]
    best.sort(key=lambda row: int(row["bytes"]))
    shares = [float(row["agreement"]) for row in best]
    assert shares == sorted(shares)
    # the options of a row make its tree
    row = next(row for row in rows if row["mode"] == "freedom" and row["level"] == "1")
    out, _ = capsyn(
        "compress", boat, *row["options"].split(), "--states", "20000", "--json",
        "-o", tmp_path / "t.cap",
    )  # fmt: skip
    made = json.loads(out)
    assert made["nodes"] == int(row["nodes"]) and made["depth"] == int(row["depth"])
    assert made["guarantee"]["agreeing"] / 20000 == float(row["agreement"])


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("--mode", "best"), "`mode` must be one of 'exact', 'freedom', 'linear'; got 'best'"),
        (("--agreement", "0.9"), "`agreement` is for mode freedom and linear only; got 0.9"),
        (
            ("--mode", "linear", "--agreement", "1"),
            "`agreement` must be above 0 and below 1; got 1",
        ),
        (("--mode", "linear", "--level", "1"), "`level` is for mode exact and freedom only; got 1"),
        (("--level", "3"), "`level` must be a whole number >= 0 and <= 2; got 3"),
        (("--node-price", "1"), "`node_price` is for mode freedom only; got 1.0"),
        (("--curve", "--mode", "linear"), "--curve tries all modes and takes no --mode"),
        (("--curve", "--level", "1"), "--curve tries all modes and takes no --level"),
        (("--curve", "-o", "c.txt"), "a picture must end in .png, .pdf, .svg; got 'c.txt'"),
        (("-o", "/nowhere/t.cap"), "/nowhere"),
        (("--nodes", "9"), "--nodes is for --judge loop only"),
        (("--duration", "9"), "--duration is for --judge loop only"),
        (("--judge", "loop", "--target", "avr"), "--target needs --bytes"),
        (("--judge", "loop", "--bytes", "9", "--target", "z80"), "`target` must be one of 'cortex"),
        (("--judge", "loop", "--mode", "exact"), "`mode` must be linear or freedom with judge 'l"),
        (
            ("--judge", "loop", "--curve", "--nodes", "9"),
            "--curve tries all modes and takes no --n",
        ),
        (
            ("--judge", "loop", "--initial", "y=0:1"),
            "--initial must name states among theta, omega",
        ),
    ],
)
def test_wrong_options_are_one_line(pendulum, tmp_path, arguments, error):
    assert error in error_of("compress", pendulum, *arguments, cwd=tmp_path)
    assert not list(tmp_path.iterdir())


QUICK = "--judge loop --duration 3 --rate 20 --trials 30 --states 1000".split()


def test_loops_judge_a_tree(pendulum, tmp_path):
    options = "--nodes 21 --arrive omega=-4.9:4.9 --hold 1 --initial theta=1:5".split()
    out, _ = capsyn("compress", pendulum, *QUICK, *options, "--json", cwd=tmp_path)
    told = json.loads(out)
    tree = Policy.load(tmp_path / "pendulum-linear.cap")
    assert tree.node_count == told["nodes"] <= 21
    loop = told["guarantee"]["loop"]
    assert (loop["duration"], loop["rate"], loop["trials"]) == (3.0, 20.0, 30)
    assert loop["limit"] == 21 and loop["target"] and loop["successes"] >= 28
    assert loop["visited"] > 0 and told["guarantee"]["states"] == 1000
    assert "30 closed loops" in capsyn("info", tmp_path / "pendulum-linear.cap", "--quick")[0]


def test_a_budget_that_no_tree_meets_is_exit_status_1(pendulum, tmp_path):
    out, errors = capsyn("compress", pendulum, *QUICK, "--bytes", "1", cwd=tmp_path, code=1)
    assert "no tree of at most 1 bytes packed was found" in errors and "wrote" in out


def test_a_tree_is_not_compressed_again(pendulum, tmp_path):
    capsyn("compress", pendulum, "-o", tmp_path / "t.cap")
    for more in ((), ("--curve",)):
        line = error_of("compress", tmp_path / "t.cap", "-o", tmp_path / "u.png", *more)
        assert "must be one of cells" in line


def test_a_proof_is_made_again(pendulum, tmp_path):
    for mode in ("exact", "freedom", "linear"):
        least = ("--agreement", "0.8") if mode == "linear" else ()  # fitted faster
        capsyn("compress", pendulum, "--mode", mode, *least, "-o", tmp_path / f"{mode}.cap")
    for mode in ("exact", "freedom"):
        data = json.loads(
            capsyn("info", tmp_path / f"{mode}.cap", "--proof", pendulum, "--quick", "--json")[0]
        )
        assert data["proof"]["changed"] == data["guarantee"]["changed"]
    line = error_of("info", tmp_path / "linear.cap", "--proof", pendulum)
    assert "must be a decision tree of mode exact or freedom" in line
    other = tmp_path / "other.cap"
    synthesize(problems.plain("cart-pendulum"), max_level=1).save(other)
    assert "was made from another" in error_of("info", tmp_path / "exact.cap", "--proof", other)


def test_the_policy_is_not_overwritten_by_its_tree(pendulum, tmp_path):
    before = pendulum.read_bytes()
    (tmp_path / "link.cap").symlink_to(pendulum)
    for output in (pendulum, tmp_path / "link.cap"):
        assert "must be another file" in error_of("compress", pendulum, "-o", output)
    assert pendulum.read_bytes() == before
