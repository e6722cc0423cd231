"""The page of a policy, used as a person would: by mouse and keyboard in a browser."""

import dataclasses
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import capsyn.explorer
from capsyn import Alphabet, Box, Policy, compress, explore, simulate, subdivide
from capsyn.errors import ProblemError
from capsyn.explorer.explore import page
from support.explorer.page import OUTPUT, hex_color, json_of, synthesized
from support.features import exact
from support.problems.study import motor_study
from support.processes.command_line import capsyn as run_capsyn
from support.processes.command_line import run_apart
from support.trees import random_policy

HOME = Path(capsyn.explorer.__file__).parent
ROOT = HOME.parents[2]


def pendulum(level=3):
    return synthesized("cart-pendulum", max_level=level)


def test_the_page_is_one_small_file_and_the_same_every_time(tmp_path):
    policy = synthesized("cart-pendulum")
    first = explore(policy, tmp_path / "a.html").read_bytes()
    policy.save(tmp_path / "p.cap")
    assert explore(Policy.load(tmp_path / "p.cap"), tmp_path / "b.html").read_bytes() == first
    assert len(first) <= 500_000
    text = first.decode()
    (security,) = re.findall(r'Content-Security-Policy" content="(.*?)"', text)
    assert security.startswith("default-src &#x27;none&#x27;; script-src &#x27;sha256-")
    assert "unsafe" not in security
    outside = re.sub(r"http://www.w3.org/\S+?[\"`']", "", text)  # the names of SVG and MathML
    links = set(re.findall(r"https?://[^\s\"'`]*", outside))
    assert "Permission is hereby granted" in text and "Leon Sorokin" in text
    assert links <= {"https://github.com/leeoniya/uPlot"}  # in the note of its licence


def test_a_tree_with_features_is_evaluated_on_its_page(show):
    tree = exact()
    shown = show(tree)
    shown.page.uncheck("#outlines")
    shown.assert_map()
    for state in tree.domain.sample(8, 2):
        pointed = shown.hover(state)
        assert pointed["symbol"] == tree(pointed["state"])
    assert shown.active["samples"] > 0
    assert "cos(theta) * omega" in shown.page.text_content("body")


def test_pointing_shows_what_the_policy_says(show):
    policy = pendulum()
    shown = show(policy)
    for state in policy.domain.sample(20, 1):
        pointed = shown.hover(state)
        assert pointed["state"] == pytest.approx(state, abs=0.02)
        symbol = policy(pointed["state"])
        assert pointed["symbol"] == symbol
        text = shown.text("#readout")
        cell = policy.cells.find(policy.domain.locate(np.array([pointed["state"]]),
                                                      policy.cells.counts))[0]  # fmt: skip
        control = f"acceleration = {'−' if symbol else ''}5 m/s²"
        assert f"{cell:,}, level" in text and control in text
        assert ("mixed" in text) == (cell in policy.cells.mixed_cells)
    shown.page.mouse.move(5, 5)
    assert shown.state["pointed"] is None


def test_the_map_has_the_policys_colours_wherever_one_looks(show):
    shown = show(pendulum())
    middle = np.random.default_rng(1).uniform(0.1, 0.9, (50, 2))
    before, _ = shown.colors(middle)
    shown.page.uncheck("#outlines")
    shown.assert_map()
    shown.page.focus("#map")
    shown.page.mouse.move(*shown.place([2.0, 1.0]))
    shown.page.mouse.wheel(0, -400)
    zoomed = shown.state["bounds"]
    assert zoomed[1] - zoomed[0] < 2 * np.pi and zoomed[0] < 2 < zoomed[1]
    shown.assert_map()
    x, y = shown.place([2.0, 1.0])
    shown.page.mouse.move(x, y)
    shown.page.mouse.down()
    shown.page.mouse.move(x - 30, y + 20)
    shown.page.mouse.move(x - 60, y + 40)
    shown.page.mouse.up()
    moved = shown.state["bounds"]
    assert moved[0] > zoomed[0] and moved[2] > zoomed[2]
    assert moved[1] - moved[0] == pytest.approx(zoomed[1] - zoomed[0])
    assert len(shown.state["tracks"]) == 1  # dragging is no click
    shown.assert_map()
    shown.page.click("#zoom button[title='Show all']")
    assert shown.state["bounds"] == pytest.approx([0, 2 * np.pi, -5, 5])
    shown.page.check("#outlines")
    assert (shown.colors(middle)[0] == before).all()


def test_outlines_are_where_cells_end(show):
    policy = pendulum(1)
    shown = show(policy)
    shares = np.random.default_rng(0).uniform(0.001, 0.999, (1500, 2))
    outlined, states = shown.colors(shares)
    shown.page.focus("#map")
    shown.page.keyboard.press("o")
    plain, _ = shown.colors(shares)
    dark = (outlined < plain).all(axis=1)
    steps = (states - policy.domain.lower) / policy.domain.widths * np.array(policy.cells.counts)
    gaps = np.abs(steps - np.round(steps))
    assert 0.02 < dark.mean() < 0.3 and gaps[dark].min(axis=1).max() < 0.1
    for axis in (0, 1):  # some are on faces across each axis alone
        assert (gaps[dark, 1 - axis] > 0.2).mean() > 0.1
    assert (plain[~dark] == outlined[~dark]).all()


def test_levels_replay_the_algorithm(show):
    policy = pendulum(2)
    shown = show(policy)
    shown.page.uncheck("#outlines")
    colors = [hex_color(color) for color in shown.state["colors"]]
    shares = np.random.default_rng(5).uniform(0.001, 0.999, (600, 2))
    for level in (0, 1, 2):
        shown.slide("#level", level)
        assert shown.text("output[for=level]") == f"{level} of 2"
        pixels, states = shown.colors(shares)
        steps = policy.domain.locate(states, policy.cells.counts)
        depth = {entry: leaves.level for leaves in policy.cells.leaves()
                 for entry in leaves.places.tolist()}  # fmt: skip
        known = np.array([depth[entry] <= level for entry in policy.cells.find(steps).tolist()])
        wanted = np.array(colors)[policy(states)]
        painted = (pixels == wanted).all(axis=1)
        assert (painted == known).mean() > 0.995
        assert known.all() == (level == 2)
    shown.page.keyboard.press("[")
    assert shown.state["level"] == 1
    replay = "() => (document.getElementById('replay').click(), capsyn.state().level)"
    assert shown.page.evaluate(replay) == 0
    shown.wait_for(lambda state: state["level"] == 2)


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a"])
def test_a_click_runs_the_closed_loop_as_simulate_does(show, name):
    policy = synthesized(name, max_level=3)
    shown = show(policy)
    shown.set("duration", 5)
    state = policy.domain.lower + 0.35 * policy.domain.widths
    track = shown.click(state)
    assert track["start"] == pytest.approx(state, abs=0.02)
    known = simulate(policy, track["start"], 5)
    np.testing.assert_allclose(track["end"], known.states[-1], atol=1e-9, rtol=0)
    assert track["switches"] == known.switches and track["samples"] == 5000
    assert track["cost"] == pytest.approx(float(known.cost), abs=1e-9)
    assert f"{int(known.switches):,} switches" in shown.text("#status")
    arrived = float(known.arrived)
    assert ("target not reached" if np.isnan(arrived) else f"{arrived:.4g} s") in shown.text(
        "#status"
    )
    plots = shown.page.locator("#series .title").all_inner_texts()
    named = {
        "cart-pendulum": "theta [rad]|omega [rad/s]|acceleration [m/s²]|symbol",
        "double-tank-a": "x1 [m]|x2 [m]|V1|V2|V3|symbol|running cost so far",
    }
    assert "|".join(plots) == named[name]


@pytest.mark.parametrize("width", [1280, 400])
def test_settings_have_room(show, width):
    policy = dataclasses.replace(pendulum(), min_dwell=0.0004, outside="nearest")
    shown = show(policy, width=width)
    room, wide, out = shown.page.evaluate("""() => {
      const box = document.querySelector("#settings"), edge = box.getBoundingClientRect().right;
      const text = document.createElement("canvas").getContext("2d");
      const spare = field => {
        const style = getComputedStyle(field), chosen = field.selectedOptions;
        text.font = `${style.fontSize} ${style.fontFamily}`;
        const needed = text.measureText(chosen ? chosen[0].textContent : field.value).width;
        const around = parseFloat(style.paddingLeft) + parseFloat(style.paddingRight);
        return field.clientWidth - around - needed - 16;  // its arrow or buttons
      };
      const all = names => [...box.querySelectorAll(names)];
      return [
        Math.min(...all("#set-dwell, #set-outside").map(spare)),
        Math.max(...all(".unit").map(unit => unit.scrollWidth - unit.clientWidth)),
        Math.max(...all("input, select, .unit").map(e => e.getBoundingClientRect().right - edge)),
      ];
    }""")
    assert shown.page.input_value("#set-dwell") == "0.0004"
    assert room >= 0 and wide <= 0 and out <= 0.5


def test_settings_of_the_loop(show):
    policy = pendulum()
    shown = show(policy)
    for name, value in {"duration": 3, "rate": 200, "delay": 12.5, "dwell": 0.1}.items():
        shown.set(name, value)
    track = shown.active
    known = simulate(policy, track["start"], 3, rate=200, delay=0.0125, min_dwell=0.1)
    np.testing.assert_allclose(track["end"], known.states[-1], atol=1e-9, rtol=0)
    assert track["switches"] == known.switches and track["rate"] == 200
    assert "200 Hz, delay 12.5 ms, dwell 0.1 s" in shown.text(".chip.active")
    shown.set("noise", 2)
    assert shown.active["end"] != track["end"] and "noise 2 %" in shown.text(".chip.active")
    shown.set("rate", -1)
    assert shown.text("#problem") == "sample rate must be a number above 0"
    assert shown.page.locator("[aria-invalid]").get_attribute("id") == "set-rate"
    before = shown.active
    assert shown.click([1.0, 2.0]) == before  # a click says why nothing happens
    assert shown.text("#note") == "No trajectory: sample rate must be a number above 0"
    assert shown.page.evaluate("getComputedStyle(document.querySelector('#series')).opacity") < "1"
    shown.set("rate", 1e9)
    assert "samples" in shown.text("#problem")
    shown.set("rate", 200)
    assert shown.text("#problem") == "" and not shown.page.locator("[aria-invalid]").count()


def test_stop_at_the_target(show):
    policy = synthesized("double-tank-a", max_level=3)
    shown = show(policy)
    shown.page.check("#set-stop")
    known = simulate(policy, shown.active["start"], 5, stop_at_target=True)
    assert shown.active["ended"] == "target" and 0 < shown.active["samples"] < 5000
    k = shown.active["samples"]
    assert k == np.round(known.arrived * 1000)
    np.testing.assert_allclose(shown.active["end"], known.states[k], atol=1e-9)
    assert "reached the target at" in shown.text("#status")


def test_rules_outside_the_domain(show):
    policy = dataclasses.replace(pendulum(2), outside="error")
    shown = show(policy)
    shown.set("duration", 20)
    start = shown.click([0.3, 4.9])
    assert start["ended"] == "left the domain"
    assert "left the domain at" in shown.text("#status")
    shown.page.select_option("#set-outside", label="nearest cell")
    known = simulate(policy, start["start"], 20, outside="nearest")
    assert shown.active["ended"] == "time" and shown.active["switches"] == known.switches
    assert f"{int(known.outside):,} samples outside" in shown.text("#status")
    shown.page.select_option("#set-outside", label="symbol -5")
    known = simulate(policy, start["start"], 20, outside=1)
    np.testing.assert_allclose(shown.active["end"], known.states[-1], atol=1e-6)


def test_trajectories_are_kept_and_compared(show):
    shown = show(pendulum(2))
    shown.page.check("#keep")
    shown.click([1.0, 1.0])
    shown.click([5.0, -2.0])
    assert [track["number"] for track in shown.state["tracks"]] == [1, 2, 3]
    shown.set("delay", 50)  # the same start again, under other settings
    tracks = shown.state["tracks"]
    assert len(tracks) == 4 and tracks[3]["start"] == tracks[2]["start"]
    assert tracks[3]["end"] != tracks[2]["end"] and tracks[3]["active"]
    shown.page.focus(".chip[data-number='2'] .choose")
    shown.page.keyboard.press("Enter")
    assert shown.active["number"] == 2
    focused = "document.activeElement.closest('.chip').dataset.number"
    assert shown.page.evaluate(focused) == "2"
    assert shown.page.get_attribute(".chip[data-number='2'] .choose", "aria-pressed") == "true"
    shown.page.click(".chip[data-number='2'] .drop")
    assert [track["number"] for track in shown.state["tracks"]] == [1, 3, 4]
    for _ in range(4):
        shown.click([2.0, 2.0])
    assert len(shown.state["tracks"]) == 6
    assert "trajectory 1 made room" in shown.text("#status")
    shown.page.uncheck("#keep")
    shown.click([1.0, 1.0])
    assert len(shown.state["tracks"]) == 1


def test_the_start_of_a_trajectory_can_be_dragged(show):
    policy = pendulum(2)
    shown = show(policy)
    shown.set("duration", 2)
    shown.click([2.0, 1.0])
    x, y = shown.place([2.0, 1.0])
    shown.page.mouse.move(x, y)
    shown.page.mouse.down()
    for share in (0.5, 1.0):
        shown.page.mouse.move(x + 120 * share, y - 60 * share)
    shown.page.mouse.up()
    track = shown.active
    assert track["start"][0] > 2.5 and track["start"][1] > 1.5
    known = simulate(policy, track["start"], 2)
    np.testing.assert_allclose(track["end"], known.states[-1], atol=1e-9)
    assert shown.state["bounds"] == pytest.approx([0, 2 * np.pi, -5, 5])


def test_play_pause_speed_reset_and_seek(show):
    policy = pendulum(2)
    shown = show(policy, reduced_motion="no-preference")
    assert shown.state["playing"]  # by itself
    shown.page.click("#play")
    paused = shown.state
    assert not paused["playing"] and 0 < paused["time"] < 10
    shown.page.click("#reset")
    assert shown.state["time"] == 0
    shown.page.select_option("#speed", "10")
    shown.page.click("#play")
    shown.wait_for(lambda state: state["time"] == 10 and not state["playing"])
    assert shown.text("#play").endswith("Play") and shown.text("#time") == "10.00 s"
    shown.slide("#scrub", 0.25)
    assert shown.state["time"] == pytest.approx(2.5)
    line = "a => parseFloat(getComputedStyle(a).left) / a.parentNode.clientWidth"
    assert shown.page.locator(".now").first.evaluate(line) == pytest.approx(0.25, abs=0.01)
    assert shown.page.get_attribute("#scrub", "aria-valuetext") == "2.50 s of 10 s"
    box = shown.page.locator(".plot .u-over").first.bounding_box()
    shown.page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 10)
    assert shown.state["time"] == pytest.approx(6.0, abs=0.05)
    known = simulate(policy, shown.active["start"], 10)
    k = int(np.floor(shown.state["time"] * 1000 + 1e-6))
    np.testing.assert_allclose(shown.active["now"], known.states[k], atol=1e-7)


def test_the_automaton_and_the_drawing_follow(show):
    policy = pendulum(2)
    shown = show(policy)
    start = shown.active["start"]
    symbols = simulate(policy, start, 10).symbols
    for time in (0.4, 4.0, 10.0, 1.5):
        shown.slide("#scrub", time / 10)
        k = min(int(np.floor(shown.state["time"] * 1000 + 1e-6)), len(symbols) - 1)
        lit = shown.page.locator(".vertex.lit")
        assert lit.count() == 1 and lit.get_attribute("data-symbol") == str(symbols[k])
        pairs = list(zip(symbols[:k].tolist(), symbols[1 : k + 1].tolist()))
        for source in (0, 1):
            for target in (0, 1):
                edge = shown.page.locator(f"[data-edge='{source}-{target}']")
                taken = pairs.count((source, target))
                assert edge.get_attribute("data-taken") == str(taken)
                label = shown.page.locator(f"[data-label='{source}-{target}'] tspan")
                texts = label.all_text_contents()
                cells = np.count_nonzero(policy.cells.entries == -1 - target)
                assert texts == [f"{cells:,} cells", f"{taken:,}×"]
        drawn = shown.page.locator("#drawing canvas").get_attribute("data-state").split()
        assert [float(v) for v in drawn] == pytest.approx(shown.active["now"])
    painted = "c => new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size"
    assert shown.page.locator("#drawing canvas").evaluate(painted) > 10


@pytest.mark.parametrize("name", ["double-tank-a", "cart-pole"])
def test_drawings_of_the_other_systems(show, name):
    shown = show(synthesized(name, max_level=1))
    drawing = shown.page.locator("#drawing canvas")
    first = drawing.screenshot()
    shown.slide("#scrub", 0.1)
    assert drawing.screenshot() != first
    shown = show(synthesized(name, max_level=1), drawing="none")
    assert not shown.page.locator("#drawing").is_visible()


def test_planes_and_slices_of_four_states(show):
    shown = show(synthesized("cart-pole", max_level=1))
    shown.page.uncheck("#outlines")
    shown.assert_map()
    shown.page.select_option("#axis-x", label="theta")
    shown.page.select_option("#axis-y", label="omega")
    assert shown.state["axes"] == [2, 3]
    assert (
        shown.page.locator("#slice-0").is_visible()
        and not shown.page.locator("#slice-2").is_visible()
    )
    central, _ = shown.assert_map()
    shown.slide("#slice-1", -2.4)
    assert shown.state["fixed"][1] == pytest.approx(-2.4)
    moved, _ = shown.assert_map()
    assert (central != moved).any()
    shown.page.select_option("#axis-y", label="theta")  # the two change places
    assert shown.state["axes"] == [3, 2]
    shown.assert_map()
    track = shown.click([0.0, -2.4, 0.1, 0.5])
    assert track["start"][1] == pytest.approx(-2.4) and track["start"][2] == pytest.approx(
        0.1, abs=0.01
    )
    shown.page.check("#follow")
    shown.slide("#scrub", 0.5)
    assert shown.state["fixed"] == pytest.approx(shown.active["now"])
    shown.assert_map()


def test_the_keyboard_does_it_all(show):
    shown = show(pendulum(2))
    press = shown.page.keyboard.press
    shown.page.focus("#map")
    press("ArrowRight")
    first = shown.state["pointed"]["state"]
    press("ArrowRight")
    press("ArrowUp")
    second = shown.state["pointed"]["state"]
    assert second[0] - first[0] == pytest.approx(2 * np.pi / 40)
    assert second[1] - first[1] == pytest.approx(10 / 40)
    press("Shift+ArrowLeft")
    assert shown.state["pointed"]["state"][0] == pytest.approx(second[0] - 2 * np.pi / 200)
    press("Enter")
    assert shown.active["start"] == pytest.approx(shown.state["pointed"]["state"])
    press("+")
    assert shown.state["bounds"][1] - shown.state["bounds"][0] == pytest.approx(0.8 * 2 * np.pi)
    press("-")
    press("0")
    assert shown.state["bounds"] == pytest.approx([0, 2 * np.pi, -5, 5])
    press("r")
    press(" ")
    assert shown.state["playing"]
    press(" ")
    assert not shown.state["playing"] and shown.state["time"] > 0
    press("d")
    assert shown.state["theme"] == "dark"
    press("]")
    press("[")
    press("[")
    assert shown.state["level"] == 0
    press("Escape")
    assert shown.state["pointed"] is None
    press("?")
    assert shown.page.locator("#help").is_visible() and "play or pause" in shown.text("#help")
    press("Escape")
    shown.page.focus("#set-rate")
    press("d")  # typing in a field is typing
    assert shown.state["theme"] == "dark"


def test_light_dark_and_narrow_and_looked_at(show):
    OUTPUT.mkdir(parents=True, exist_ok=True)
    backgrounds = []
    for scheme, width in (("light", 1280), ("dark", 1280), ("light", 420)):
        for name in ("cart-pendulum", "double-tank-a"):
            shown = show(synthesized(name), color_scheme=scheme, width=width)
            assert shown.state["theme"] == scheme
            shown.slide("#scrub", 0.2)
            shown.page.screenshot(path=OUTPUT / f"{name}-{scheme}-{width}.png", full_page=True)
            assert shown.page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
            wide = "c => c.scrollWidth > c.clientWidth + 1"
            cards = f"[...document.querySelectorAll('.card')].filter({wide}).map(c => c.id)"
            assert shown.page.evaluate(cards) == []
        backgrounds.append(
            shown.page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
        )
        shown.page.click("#theme")
        assert shown.state["theme"] != scheme
        shown.page.uncheck("#outlines")
        shown.assert_map()
    assert backgrounds[0] != backgrounds[1]


def test_facts_and_evidence(show):
    evidence = {
        **{"trials": 1000, "successes": 997, "low": 0.991, "high": 0.999, "confidence": 0.95},
        "conditions": {"target": "near", "within": 9},
    }
    policy = synthesized("cart-pendulum").with_evidence(monte_carlo=evidence)
    shown = show(policy)
    facts = shown.text("#facts")
    for words in ("4,314", "41,842 at worst: 10.3% were needed", "1,710", "theta [rad] ↻",
                  "997 of 1,000 trials succeed", "target near, within 9", "50.00 %"):  # fmt: skip
        assert words in facts, words
    assert shown.page.locator("#formulas math").count() >= 3
    assert shown.text("#summary") == "2 states · 2 symbols · 1,710 cells · 4,314 solves"


def test_the_table_of_a_chosen_alphabet(show):
    study = motor_study()
    policy = pendulum(1)
    assert "Choice" not in show(policy).text("#facts")
    shown = show(dataclasses.replace(policy, statistics={"alphabet": study.summary()}))
    card = shown.page.locator(".fact.broad")
    heads, cells = (card.locator(tag).all_inner_texts() for tag in ("th", "td"))
    assert card.locator("h2").inner_text() == "Choice of the alphabet"
    assert heads[:5] == ["kind", "symbols", "best", "objective", "95 % interval"]
    assert cells[2 * len(heads) :][:5] == ["chosen", "3", "*", "555", "535 to 575"]
    marks = card.locator("svg.choice g")
    assert marks.count() == 4  # the fifth is infinite
    assert [mark.get_attribute("class") for mark in marks.all()][:2] == ["chosen", "uniform"]
    assert card.locator("figcaption span").all_inner_texts() == ["chosen", "uniform", "random"]


NASTY = ['</script><script>alert("a")</script>', "<img src=x onerror=alert(1)>", "{{SCRIPT}}",
         "<!--", "&lt;b&gt;", "' onload='alert(2)"]  # fmt: skip


def test_hostile_names_are_only_text(show):
    policy = pendulum(1)
    domain, alphabet = policy.domain, policy.alphabet
    hostile = dataclasses.replace(
        policy,
        name=NASTY[0],
        domain=Box(domain.lower, domain.upper, names=NASTY[1:3], units=NASTY[3:5],
                   periodic=domain.periodic),
        alphabet=Alphabet(alphabet.values, names=NASTY[:2], inputs=[NASTY[5]], units=[NASTY[0]]),
    )  # fmt: skip
    shown = show(hostile)
    assert shown.text("h1") == NASTY[0] and shown.page.title() == f"{NASTY[0]} - capsyn"
    assert shown.page.locator("img").count() == 0
    assert shown.page.evaluate("document.scripts.length") == 1  # the code; the data are read
    shown.hover([1.0, 1.0])
    assert NASTY[1] in shown.text("#readout") and NASTY[2] in shown.text("#facts")
    assert NASTY[0] in shown.text("#legend")
    html = hostile._repr_html_()
    assert "<script" not in html and "<img" not in html
    ElementTree.fromstring(html)


def test_the_view_goes_round_a_periodic_axis(show):
    policy = pendulum(2)
    shown = show(policy)
    shown.page.uncheck("#outlines")
    x, y = shown.place([2.0, 1.0])
    shown.page.mouse.move(x, y)
    shown.page.mouse.down()
    for far in (100, 200):
        shown.page.mouse.move(x + far, y)
    shown.page.mouse.up()
    x0, x1, *_ = shown.state["bounds"]
    assert x0 < -1 and x1 - x0 == pytest.approx(2 * np.pi)
    assert any(text.startswith("−") for text in shown.page.evaluate("capsyn.map().ticks.x"))
    shown.assert_map()
    pointed = shown.hover([-0.7, 1.3])
    assert pointed["state"] == pytest.approx([-0.7, 1.3], abs=0.02)
    assert pointed["symbol"] == policy(pointed["state"])
    low, high = re.search(r": \[(\S+), (\S+)\] ×", shown.text("#readout")).groups()
    assert float(low.replace("−", "-")) < -0.7 < float(high.replace("−", "-"))
    assert shown.click([-0.7, 1.3])["start"] == pytest.approx([-0.7, 1.3], abs=0.02)


def test_paths_stay_when_zoomed_and_cross_seams(show):
    shown = show(pendulum(2))
    shown.set("duration", 3)
    shown.set("rate", 10)  # steps are longer than what is seen in the end
    shown.click([6.0, 2.5])  # over the seam
    known = simulate(shown.policy, shown.active["start"], 3, rate=10).states[:, 0]
    turns = np.floor(known / (2 * np.pi))
    assert turns.max() > 0
    pieces = shown.page.evaluate("capsyn.map().pieces")
    assert pieces == [1 + np.count_nonzero(np.diff(turns))]
    shown.page.focus("#map")
    shown.page.keyboard.press("0")
    for _ in range(14):
        shown.page.keyboard.press("+")
    middle = sum(shown.state["bounds"][:2]) / 2
    turns = np.floor((known - middle) / (2 * np.pi) + 0.5)  # the seam is opposite of what is seen
    pieces = shown.page.evaluate("capsyn.map().pieces")
    assert pieces == [1 + np.count_nonzero(np.diff(turns))]


def test_series_show_what_simulate_gives(show):
    policy = synthesized("double-tank-a", max_level=3)
    shown = show(policy)
    shown.set("duration", 2)
    track = shown.click([0.3, 0.6])
    known = simulate(policy, track["start"], 2)
    plots = {plot["name"]: plot for plot in shown.page.evaluate("capsyn.series()")}
    for i, name in enumerate(("x1 [m]", "x2 [m]")):
        times, values = map(np.array, plots[name]["points"])
        k = np.round(times * 1000).astype(int)
        np.testing.assert_allclose(values, known.states[k, i], atol=1e-9)
        assert values.min() == pytest.approx(known.states[:, i].min(), abs=1e-9)  # none is missed
        assert values.max() == pytest.approx(known.states[:, i].max(), abs=1e-9)
    shares = plots["symbol"]["shares"]
    total = {symbol: sum(piece.get(symbol, 0) for piece in shares) / len(shares)
             for symbol in set().union(*shares)}  # fmt: skip
    wanted = {str(k): np.mean(known.symbols == k) for k in np.unique(known.symbols)}
    assert total == pytest.approx(wanted, abs=1e-6)
    assert len(total) > 2 and max(len(piece) for piece in shares) > 1
    cost = plots["running cost so far"]["points"][1]
    assert cost[0] == 0 and (np.diff(cost) >= 0).all()
    assert cost[-1] == pytest.approx(float(known.cost - known.terminal_cost), abs=1e-9)


def test_the_target_is_outlined_where_it_ends(show):
    policy = synthesized("double-tank-a", max_level=1)
    shown = show(policy)
    drawn = shown.page.evaluate("capsyn.map()")
    points = np.array(drawn["target"])
    ball = policy.target
    away = np.linalg.norm(policy.domain.lower + points * policy.domain.widths - ball.center, axis=1)
    assert len(points) > 50 and away == pytest.approx(ball.radius, abs=2e-3)
    assert drawn["ticks"]["x"] == ["0", "0.2", "0.4", "0.6", "0.8", "1"]


def test_ticks_tell_near_values_apart(show):
    shown = show(pendulum(3))
    shown.page.focus("#map")
    shown.hover([2.0, 1.0])
    for _ in range(20):
        shown.page.keyboard.press("+")
    ticks = shown.page.evaluate("capsyn.map().ticks")
    assert len(set(ticks["x"])) == len(ticks["x"]) > 1 < len(set(ticks["y"])) == len(ticks["y"])


def test_a_symbol_of_the_legend_or_the_automaton_stands_out(show):
    shown = show(pendulum(2))
    shown.page.uncheck("#outlines")
    shares = np.random.default_rng(4).uniform(0.01, 0.99, (200, 2))
    before, states = shown.colors(shares)
    shown.page.focus("#legend .key[data-symbol='1']")
    assert shown.state["only"] == 1
    after, _ = shown.colors(shares)
    same = (before == after).all(axis=1)
    assert (same == (shown.policy(states) == 1)).mean() > 0.99
    shown.page.focus(".vertex[data-symbol='0']")
    assert shown.state["only"] is None
    assert "5 → -5: " in shown.text("#automaton .caption")
    assert "taken" in shown.page.locator(".vertex").first.get_attribute("aria-label")


def test_the_readout_is_of_the_level_and_of_the_slice(show):
    policy = synthesized("cart-pole", max_level=1)
    shown = show(policy)
    shown.slide("#slice-2", 0.3)
    assert not shown.page.is_checked("#follow")  # who moves the slice has it
    state = shown.hover([0.1, 0.2])["state"]
    shown.slide("#slice-2", -0.2)
    assert shown.state["pointed"]["state"][2] == pytest.approx(-0.2, abs=0.01)
    assert "theta = −0.198" in shown.text("#readout") and state[2] > 0.25
    shown = show(pendulum(2))
    shown.slide("#level", 0)
    shown.hover([3.0, 4.4])
    assert "still to split at level 0" in shown.text("#readout")
    assert "final" in shown.text("#readout")


def test_the_wheel_says_how_to_zoom(show):
    shown = show(pendulum(1))
    shown.page.mouse.move(*shown.place([2.0, 1.0]))
    shown.page.mouse.wheel(0, -100)
    assert "Ctrl" in shown.text("#note")
    assert shown.state["bounds"] == pytest.approx([0, 2 * np.pi, -5, 5])


def test_evidence_of_another_content_is_not_shown():
    evidence = {"trials": 10, "successes": 9, "low": 0.5, "high": 1.0, "confidence": 0.95}
    policy = pendulum(1).with_evidence(monte_carlo=evidence)
    assert "9 of 10 trials" in str(json_of(page(policy)))
    assert "9 of 10 trials" not in str(json_of(page(dataclasses.replace(policy, min_dwell=0.5))))


def test_statistics_of_any_size_are_only_told():
    policy = pendulum(1)
    huge = {**policy.statistics, "solves": 10**400}
    assert f"{10**400:,}" in str(json_of(page(dataclasses.replace(policy, statistics=huge))))


def test_without_dynamics_there_are_map_automaton_and_facts(show):
    box = Box([0, 0], [1, 2], names=["a", "b"])
    alphabet = Alphabet([[0.0], [1.0], [2.0]], names=["low", "middle", "high"])
    policy = subdivide(lambda x: np.searchsorted([0.8, 1.6], x.sum(axis=1)), box, alphabet)
    shown = show(policy)
    shown.page.uncheck("#outlines")
    shown.assert_map()
    assert shown.page.locator(".vertex").count() == 3 and "Solves" in shown.text("#facts")
    for part in ("#player", "#series", "#settings", "#drawing", "#formulas"):
        assert not shown.page.locator(part).is_visible()
    shown.page.mouse.click(*shown.place([0.5, 0.5]))
    assert shown.state["tracks"] == []
    assert shown.hover([0.9, 1.5])["symbol"] == 2
    shown.page.keyboard.press("Space")


def test_one_state_is_a_strip(show):
    domain = Box([10.0], [30.0], names=["temperature"], units=["degC"])
    problem = capsyn.Problem(
        name="thermostat", dynamics=lambda x, u: [-0.1 * (x[0] - 15) + u[0]], domain=domain,
        alphabet=Alphabet([0.0, 1.0], names=["off", "on"]), default=0.6, horizon=5.0,
        running_cost=lambda x: (x[0] - 21) ** 2, max_level=5,
    )  # fmt: skip
    policy = capsyn.synthesize(problem)
    shown = show(policy)
    shown.page.uncheck("#outlines")
    pixels, states = shown.assert_map()
    assert len(np.unique(pixels, axis=0)) == 2
    track = shown.click([27.0])
    np.testing.assert_allclose(
        track["end"], simulate(policy, track["start"], 50).states[-1], atol=1e-9
    )
    shown.page.keyboard.press("+")
    shown.assert_map()
    assert not shown.page.locator("#axis-x").count()


@pytest.mark.parametrize("mode", ["exact", "linear"])
def test_decision_trees(show, mode):
    options = {"agreement": 0.97} if mode == "linear" else {}
    tree = compress(pendulum(2), mode=mode, **options)
    assert (len(tree.cells.planes) > 0) == (mode == "linear")
    shown = show(tree)
    shown.page.uncheck("#outlines")
    shown.assert_map()
    assert not shown.page.locator("#level").count()
    assert shown.page.locator(".vertex").count() == 2
    assert tree.guarantee.text.split(";")[0] in shown.text("#facts")
    start = shown.active["start"]
    assert shown.active["switches"] == simulate(tree, start, 10).switches


def test_affine_leaves_are_shown_as_they_are(show):
    policy = synthesized("cart-pole", leaves="affine", max_level=1)
    shown = show(policy)
    shown.page.uncheck("#outlines")
    shown.assert_map()
    assert f"{policy.cells.leaf_count:,} cells" in shown.text("#summary")
    assert shown.page.locator(".vertex").count() == 2


def test_cells_without_a_symbol_are_outside(show):
    policy = random_policy(3)
    assert policy.volume_shares[-1] > 0
    shown = show(dataclasses.replace(policy, gaps=True))
    assert "outside" in shown.text("#legend") and "default" not in shown.text("#legend")


def test_symbols_that_are_the_default_or_many(show):
    policy = random_policy(6, periodic=True)
    shown = show(policy)
    assert (
        shown.page.locator(".vertex").count()
        == np.unique(policy.cells.labels_at(np.flatnonzero(policy.cells.entries < 0))).size
    )
    for state in policy.domain.sample(10, 2):
        state[2:] = shown.state["fixed"][2:]
        pointed = shown.hover(state)
        assert pointed["symbol"] == policy(pointed["state"])


def test_the_page_is_built_from_its_modules(tmp_path):
    esbuild = ROOT / "node_modules" / ".bin" / "esbuild"
    if not esbuild.exists():
        pytest.skip("needs the packages of package.json: npm ci")
    for script, built in (("page", "page"), ("page-memory", "page.memory")):
        command = ["npm", "run", "--silent", script, "--", f"--outdir={tmp_path}"]
        subprocess.run(command, cwd=ROOT, check=True)
        for name in (f"{built}.js", f"{built}.css"):
            assert (tmp_path / name).read_text() == (HOME / name).read_text(), "run `make page`"
        assert "</script" not in (HOME / f"{built}.js").read_text().lower()
    for name in ("uPlot.esm.js", "uPlot.min.css"):
        vendored = (HOME / "vendor" / name).read_bytes()
        assert vendored == (ROOT / "node_modules" / "uplot" / "dist" / name).read_bytes()


def test_the_command(tmp_path, monkeypatch):
    pendulum(1).save(tmp_path / "p.cap")
    page, seen = tmp_path / "page.html", tmp_path / "seen"
    out, _ = run_capsyn("explore", tmp_path / "p.cap", "-o", page)
    assert f"wrote {page} ({page.stat().st_size:,} bytes)" in out
    assert page.read_text().startswith("<!doctype html>")
    _, error = run_capsyn("explore", tmp_path / "p.cap", "-o", tmp_path / "p.cap", code=2)
    assert "another file" in error
    monkeypatch.setenv("BROWSER", f"sh -c 'echo $0 > {seen}' %s")
    opened = ("--open", "--drawing", "none")  # Python looks for browsers once in a process
    run_capsyn("explore", tmp_path / "p.cap", "-o", page, *opened, run=run_apart)
    assert seen.read_text().strip() == page.as_uri()
    assert json_of(page.read_text(encoding="utf-8"))["drawing"] is None


def test_errors_say_what_is_wrong(tmp_path):
    with pytest.raises(ProblemError, match="`policy` must be a capsyn.Policy; got 3"):
        explore(3, tmp_path / "p.html")
    with pytest.raises(ProblemError, match="`drawing` must be one of pendulum, .* got 'boat'"):
        explore(pendulum(1), tmp_path / "p.html", drawing="boat")
    with pytest.raises(ProblemError, match="is of 4 states .* the policy has 2"):
        explore(pendulum(1), tmp_path / "p.html", drawing="cart-pole")
    with pytest.raises(ProblemError, match="cannot write"):
        explore(pendulum(1), tmp_path / "nowhere" / "p.html")
    with pytest.raises(ProblemError, match="shows 3 inputs; the policy has 1"):
        explore(pendulum(1), tmp_path / "p.html", drawing="double-tank")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["cart-pendulum", "double-tank-a"])
def test_notebooks_show_a_small_map(name):
    policy = synthesized(name, max_level=2)
    html = policy._repr_html_()
    wide = {"cart-pendulum": "theta (0 to 6.283 rad)", "double-tank-a": "x2 (0 to 1 m) against x1"}
    assert wide[name] in html
    assert html == policy._repr_html_() and len(html) < 20_000
    svg = ElementTree.fromstring(html)[0]
    space = "{http://www.w3.org/2000/svg}"
    covered = np.full((48, 72), "", dtype=object)
    for path in svg.find(f"{space}g"):
        for column, row, run in re.findall(r"M(\d+) (\d+)h(\d+)", path.get("d")):
            covered[int(row), int(column) : int(column) + int(run)] = path.get("fill")
    names = dict(zip((r.get("fill") for r in svg.iter(f"{space}rect")),
                     (t.text for t in svg.iter(f"{space}text"))))  # fmt: skip
    for row, column in np.random.default_rng(0).integers((48, 72), size=(50, 2)):
        shares = np.array([(column + 0.5) / 72, 1 - (row + 0.5) / 48])
        symbol = policy(policy.domain.lower + shares * policy.domain.widths)
        assert names[covered[row, column]] == policy.symbol_name(symbol)
