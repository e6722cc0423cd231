"""What notebooks show: well-formed, with axes, and with all names as text."""

import dataclasses
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from capsyn import Alphabet, Automaton, Ball, Box, Problem, monte_carlo, simulate, synthesize
from capsyn.notebook import curves, table, ticks
from capsyn.policies.colors import symbol_looks
from support.proofs.certificates import complete

NASTY = ["</td><script>alert(1)</script>", "<img src=x onerror=alert(1)>", 'a"b&c', "'><b>"]
COUNT = 10


@pytest.fixture(scope="module")
def shown():
    """Return what notebooks show of everything, under names that would be markup."""
    problem = Problem(
        name=NASTY[0],
        dynamics=lambda x, u: [u[0], -x[1] + u[0]],
        domain=Box([-1, -1], [1, 1], names=NASTY[:2], units=NASTY[2:]),
        alphabet=Alphabet(
            np.linspace(-1, 1, COUNT), names=[f"{NASTY[1]}{k}" for k in range(COUNT)],
            inputs=[NASTY[0]], units=[NASTY[2]],
        ),
        default=0.0,
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2 + x[1] ** 2,
        target=Ball([0, 0], 0.2),
        outside="nearest",
        partitions=5,
        max_level=1,
    )  # fmt: skip
    policy = synthesize(problem)
    run = simulate(policy, [0.5, 0.3], 1.0, 20.0)
    many = simulate(policy, policy.domain.sample(12, 1), 1.0, 20.0)
    trials = monte_carlo(policy, 5, duration=1.0, rate=20.0)
    things = [
        problem,
        policy,
        run,
        many,
        trials,
        Automaton.of(policy),
        complete(policy.domain, (4, 4)),
    ]
    return {f"{type(thing).__name__} {k}": thing for k, thing in enumerate(things)}


def test_everything_is_well_formed_and_names_are_text(shown):
    for name, thing in shown.items():
        html = thing._repr_html_()
        tree = ElementTree.fromstring(html)
        tags = {element.tag.split("}")[-1] for element in tree.iter()}
        allowed = "div table tr td th svg title defs pattern g path rect text"
        assert tags <= set(allowed.split()), name
        attributes = {key for element in tree.iter() for key in element.attrib}
        assert not any(key.startswith("on") for key in attributes)
        assert html == thing._repr_html_() and len(html) < 60_000, name


def test_a_map_has_scales_and_marks(shown):
    policy = shown["Policy 1"]
    space = "{http://www.w3.org/2000/svg}"
    (svg,) = ElementTree.fromstring(policy._repr_html_()).iter(f"{space}svg")
    texts = [text.text for text in svg.iter(f"{space}text")]
    assert f"{NASTY[0]} [{NASTY[2]}]" in texts and f"{NASTY[1]} [{NASTY[3]}]" in texts
    assert {"-1", "-0.5", "0", "0.5", "1"} <= set(texts)
    fills = {path.get("fill") for path in svg.find(f"{space}g")}
    ids = {f"url(#{pattern.get('id')})" for pattern in svg.iter(f"{space}pattern")}
    assert ids == {fill for fill in fills if fill.startswith("url")}
    used = {int(k) for k in np.unique(policy(policy.domain.sample(5000, 1)))}
    assert ids or not {k for k in used if symbol_looks(COUNT)[k].marks}


def test_the_strip_of_a_trajectory_has_its_symbols(shown):
    run = shown["Trajectory 2"]
    rects = re.findall(
        r'<rect x="([\d.]+)" y="\d+" width="([\d.]+)" height="12"', run._repr_html_()
    )
    runs = 1 + np.count_nonzero(np.diff(run.symbols))
    assert len(rects) == runs and sum(float(width) for _, width in rects) == pytest.approx(
        420, 0.01
    )
    assert "the first 8 are drawn" in shown["Trajectory 3"]._repr_html_()
    ended = dataclasses.replace(
        run, states=np.where(np.arange(21)[:, None] > 0, np.nan, run.states),
        symbols=np.full(20, -2), last=np.int64(0),
    )  # fmt: skip
    ElementTree.fromstring(ended._repr_html_())


def test_lines_have_gaps_where_there_is_nothing():
    line = np.array([0.0, 1.0, np.nan, 1.0, 0.0])
    html = curves("t", np.arange(5.0), "s", [("x", [line, np.full(5, np.nan)], "#000000")])
    first, second = re.findall(r'<path d="([^"]*)"', html)
    assert re.sub(r"[\d. ]+", "", first) == "MLML" and second == ""


def test_ticks_are_round():
    assert ticks(-1, 1, 4) == [-1, -0.5, 0, 0.5, 1]
    assert ticks(0.0, 0.02, 5) == [0, 0.005, 0.01, 0.015, 0.02]
    assert ticks(0, 2 * np.pi, 5) == [0, 2, 4, 6]
    assert "&lt;b&gt;" in table("<b>", [("<i>", 1)], ["<u>"])
