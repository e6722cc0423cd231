"""The page of a policy that counts time in minutes, and readings that do not wait."""

import re

import numpy as np
import pytest

from capsyn import simulate
from support.at_once import RATE, STORIES
from support.closed_loops import grid_policy, relay_problem
from support.explorer.node import BEGIN, node, texts
from support.explorer.page import Shown

LOOP = (
    'import { makeLookup } from "#page/policy/lookup.js";'
    'import { makeLoop } from "#page/loop/loop.js";'
    'import { model } from "./model.js";'
    + BEGIN
    + """
const readings = numbers([input.readings])[0], lookup = makeLookup(input.policy);
const seen = { ...lookup, k: 0, symbol(x, outside) {
  return lookup.symbol([readings[this.k++]], outside);
} };
const loop = makeLoop(input.policy, seen, model);
print(loop.run([0], { duration: readings.length / input.rate, rate: input.rate }));
"""
)


@pytest.mark.parametrize("story", STORIES, ids=lambda story: story.name)
def test_symbols_of_a_story(story, tmp_path):
    (readings,) = texts(np.array([story.readings]))
    run = node(tmp_path, LOOP, story.policy, readings=readings, rate=RATE)
    assert run["symbols"] == list(story.symbols)
    assert run["switches"] == story.switches


def minutes(outside="nearest"):
    """Return a policy in minutes that oscillates across 0, held for 2 minutes at least."""
    problem = relay_problem(outside=outside, min_dwell=2.0, horizon=3.0, time_unit="min")
    return grid_policy(problem, [0, 1], [2], time_unit="min")


@pytest.mark.parametrize("width", [1280, 400])
def test_a_page_in_minutes_says_no_second(width, browser, tmp_path):
    policy = minutes()
    shown = Shown(browser, policy, tmp_path, width=width)
    for name, value in {"duration": 30, "rate": 4, "delay": 0.25, "dwell": 3}.items():
        shown.set(name, value)
    track = shown.active
    known = simulate(policy, track["start"], 30, rate=4, delay=0.25, min_dwell=3)
    np.testing.assert_allclose(track["end"], known.states[-1], atol=1e-9, rtol=0)
    assert track["switches"] == known.switches > 3
    assert "4 1/min, delay 0.25 min, dwell 3 min" in shown.text(".chip.active")
    assert "ran to the end (30 min)" in shown.text("#status")
    assert shown.text("#time").endswith(" min")
    assert shown.page.get_attribute("#scrub", "aria-valuetext").endswith("of 30 min")
    units = shown.page.locator("#settings .unit").all_inner_texts()
    assert units == ["min", "1/min", "%", "min", "min"]
    speeds = shown.page.locator("#speed option").all_inner_texts()
    assert "1 min/s" in speeds and all(text.endswith(" min/s") for text in speeds)
    text = shown.text("body").replace(" min/s", "")
    assert not re.search(r"[\d\]] (s|ms|Hz)\b|1/s|\bseconds?\b", text)
    wide, out = shown.page.evaluate("""() => {
      const box = document.querySelector("#settings"), edge = box.getBoundingClientRect().right;
      const units = [...box.querySelectorAll(".unit")];
      return [Math.max(...units.map(unit => unit.scrollWidth - unit.clientWidth)),
        Math.max(...units.map(unit => unit.getBoundingClientRect().right - edge))];
    }""")
    assert wide <= 0 and out <= 0.5
    assert shown.messages == []
    shown.close()


def test_the_rule_outside_is_a_setting(browser, tmp_path):
    policy = minutes(outside=0)
    shown = Shown(browser, policy, tmp_path)
    shown.set("rate", 4)
    assert not shown.page.is_checked("#set-at-once")
    ends = []
    for told in (False, True):
        shown.page.set_checked("#set-at-once", told)
        track = shown.active
        known = simulate(policy, track["start"], 30, rate=4, outside_at_once=told)
        ends.append((track["end"], track["switches"]))
        assert ends[-1] == (known.states[-1].tolist(), known.switches)
        assert ("outside at once" in shown.text(".chip.active")) is told
    assert ends[0] != ends[1]
    shown.close()
