"""Prices, least times and forbidden transitions on the command line, and the curve."""

import csv
import json

import pytest

from capsyn import Policy
from support.processes.command_line import capsyn, error_of


def synth(path, *options, code=0):
    return capsyn("synth", "double-tank-b", "--max-level", 1, "-o", path, *options, code=code)


def test_synth_takes_prices_times_and_forbidden_transitions(tmp_path):
    path = tmp_path / "p.cap"
    low, high = "(0, 0.2, 0)", "(1, 0.2, 1)"
    synth(path, "--switch-price", "V1=0.5,V3=1%", "--hold", "V1=2", "--delay", 0.01)
    switching = Policy.load(path).switching
    assert switching.price["V1"] == 0.5 and 0 < switching.price["V3"] < 10
    assert switching.hold == {"V1": 2.0} and Policy.load(path).delay == 0.01
    synth(path, "--switch-price", 3, "--hold", 0.5, "--forbid", f"{low}:{high}")
    switching = Policy.load(path).switching
    assert (switching.price, switching.hold, switching.forbidden) == (3.0, 0.5, ((low, high),))
    assert capsyn("query", path, 0.2, 0.2, "--current", low)[0].startswith("symbol")
    out, _ = capsyn("info", path, "--quick")
    assert "3 per second" in out and f"{low} to {high}" in out
    synth(
        path,
        "--hold",
        "V1=2",
        "--hold",
        "V3=1",
        "--forbid",
        f"{low}:{high}",
        "--forbid",
        f"{high}:{low}",
    )
    switching = Policy.load(path).switching
    assert switching.hold == {"V1": 2.0, "V3": 1.0} and len(switching.forbidden) == 2
    synth(path, "--switch-price", "none")
    assert Policy.load(path).switching is None and not Policy.load(path).remembers


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--switch-price", "-1"], "`price` must be a finite number >= 0; got -1.0"),
        (["--switch-price", "much"], "`--switch-price` must be a number; got 'much'"),
        (["--switch-price", "V2=1,V9=1"], "`price` must name inputs (V1, V2, V3); got 'V9'"),
        (["--switch-price", "none", "--hold", "1"], "none takes no --hold and no --forbid"),
        (["--hold", "open=1"], "`hold` must name symbols and inputs"),
        (["--forbid", "open"], "--forbid must be FROM:TO; got 'open'"),
        (["--forbid", "open:closed"], "`forbidden` must name symbols"),
        (["--delay", "-1"], "`delay` must be a finite number >= 0; got -1.0"),
        (["--delay", "0.1", "--leaves", "affine"], "`leaves` must be constant"),
    ],
)
def test_bad_options_are_told_in_one_line(tmp_path, options, message):
    arguments = ["synth", "double-tank-b", "--max-level", 1, "-o", tmp_path / "p.cap", *options]
    assert message in error_of(*arguments, cwd=tmp_path)


def test_the_curve(tmp_path):
    path, picture = tmp_path / "p.cap", tmp_path / "c.png"
    out, _ = capsyn(
        "synth", "cart-pendulum", "--switch-price", "none", "--max-level", 2, "-o", path
    )
    (hint,) = [line for line in out.splitlines() if "--switch-price" in line]
    assert "times per second at 1000 samples: --switch-price" in hint
    loop = ["--trials", 30, "--duration", 5]
    prices = ["--curve", "--prices", "0,1%,30%", "--holds", "0,0.05", "-o", picture]
    points = json.loads(capsyn("switching", path, *loop, *prices, "--json")[0])["points"]
    assert [(p["price"], p["hold"]) for p in points][:3] == [("0", 0), ("1%", 0), ("30%", 0)]
    free, priced, dear = points[:3]
    assert free["switches"] > 100 > 30 > priced["switches"] > dear["switches"]
    assert priced["cost"] < 1.05 * free["cost"] and priced["success"] > 0.9
    assert sum(p["recommended"] for p in points) == 1 and not dear["recommended"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    with open(tmp_path / "c.csv") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["switches"]) for row in rows] == [p["switches"] for p in points]
    alone = json.loads(capsyn("switching", path, *loop, "--json")[0])
    assert alone["switches"] == pytest.approx(free["switches"]) and alone["price"] == "0"
    assert "--prices needs --curve" in capsyn("switching", path, "--prices", "1", code=2)[1]
    capsyn("compress", path, "-o", tmp_path / "t.cap")
    _, err = capsyn("switching", tmp_path / "t.cap", "--curve", "-o", picture, code=2)
    assert "`policy` must be one of cells" in err


HOUSE = """
import capsyn
problem = capsyn.Problem(
    name="house", dynamics=lambda x, u: [u[0] - 0.1 * x[0]], domain=capsyn.Box([-1], [1]),
    alphabet=capsyn.Alphabet([0, 1, -1], names=["off", "heat", "cool"]), default=0, horizon=1.0,
    running_cost=lambda x: x[0]**2, partitions=4, max_level=1,
    switching=capsyn.Switching(hold={"heat": 10, "cool": 9}, forbidden=[("heat", "cool")]),
)
"""


def test_options_stand_beside_what_the_problem_says(tmp_path):
    (tmp_path / "house.py").write_text(HOUSE)
    for options, hold, forbidden in (
        (["--hold", "off=5"], {"heat": 10, "cool": 9, "off": 5}, 1),
        (["--hold", "heat=3", "--forbid", "cool:heat"], {"heat": 3, "cool": 9}, 2),
        (["--hold", "4"], 4.0, 1),
        (["--hold", "none", "--forbid", "none"], 0.0, 0),
    ):
        capsyn("synth", "house.py", "-o", "h.cap", *options, cwd=tmp_path)
        switching = Policy.load(tmp_path / "h.cap").switching
        assert switching.hold == hold and len(switching.forbidden) == forbidden
