"""The page of a policy that is told exogenous inputs: its sliders act at once."""

import functools

import casadi as ca
import numpy as np
import pytest

from capsyn import Alphabet, Box, Problem, SsacSettings, Switching, compress, simulate, synthesize
from capsyn.explorer.explore import page
from support.explorer.node import BEGIN, node
from support.explorer.page import OUTPUT, json_of, synthesized

LOOP = (
    'import { makeLookup } from "#page/policy/lookup.js";'
    'import { makeLoop } from "#page/loop/loop.js";'
    'import { model } from "./model.js";'
    + BEGIN
    + "const loop = makeLoop(input.policy, makeLookup(input.policy), model);"
    "print(input.runs.map(({ x0, ...options }) => loop.run(x0, options)));"
)
DURATION, RATE = 60, 2.0


@functools.cache
def room(hold=None, **options):
    """Return the policy of a room and its wall, which is told a setpoint and the outdoor air."""
    problem = Problem(
        name="room",
        dynamics=lambda x, u, w: [
            0.1 * (x[1] - x[0]) + 0.02 * (w[1] - x[0]) + u[0],
            0.05 * (x[0] - x[1]),
        ],
        domain=Box([14, 14], [30, 30], names=["air", "wall"], units=["degC"] * 2),
        exogenous=Box([18, -10], [26, 40], names=["setpoint", "outdoor"], units=["degC"] * 2),
        alphabet=Alphabet([[0.0], [0.8], [-0.8]], names=["off", "heat", "cool"], inputs=["heater"]),
        default=lambda x, w: [0.02 * (w[0] - w[1])],
        horizon=6.0,
        running_cost=lambda x, w: (x[0] - w[0]) ** 2,
        target=lambda x, w: ca.fabs(x[0] - w[0]) < 0.5,
        settings=SsacSettings(control_weight=0.5, rule="steepest", sample_time=1 / RATE),
        outside="nearest",
        partitions=[8, 2, 8, 4],
        max_level=1,
        time_unit="min",
    )
    if hold is not None:
        problem = problem.replace(switching=Switching(price=0.5, hold=hold))
    return synthesize(problem, **options)


def told(run, **signals):
    """Return what `simulate` gives for a track of the page with such exogenous inputs."""
    return simulate(room(), run["start"][:2], DURATION, exogenous=signals)


def assert_same(run, known):
    np.testing.assert_allclose(run["end"][:2], known.states[-1], rtol=1e-9)
    assert run["end"][2:] == known.exogenous[-1].tolist()
    assert run["switches"] == known.switches
    assert run["cost"] == pytest.approx(known.cost, rel=1e-9)


def opened(show, policy, **options):
    """Show a policy with settings that all of these tests have."""
    shown = show(policy, **options)
    shown.page.uncheck("#outlines")
    shown.set("duration", DURATION)
    return shown


@pytest.mark.parametrize("hold", [None, 2.0])
def test_loops_are_told_at_samples_as_in_python(hold, tmp_path):
    policy = room(hold)
    changes = [[0, [20.0, 5.0]], [10.0, [25.0, 5.0]], [20.2, [25.0, -8.0]], [31.0, [18.0, 30.0]]]
    steps = {
        "setpoint": {time: w[0] for time, w in changes},
        "outdoor": {time: w[1] for time, w in changes},
    }
    options = [{}, {"rate": 3.0, "delay": 0.5}, {"stopAtTarget": True}, {"outside": -1}]
    runs = [
        {"x0": [*x0, 0.0, 0.0], "duration": 40, "exogenous": changes, **more}
        for x0 in ([15.0, 16.0], [29.0, 22.0])
        for more in options
    ]
    for run, asked in zip(node(tmp_path, LOOP, policy, runs=runs), runs):
        stop = {"stop_at_target": asked.get("stopAtTarget", False)}
        others = {key: asked[key] for key in ("rate", "delay", "outside") if key in asked}
        known = simulate(policy, asked["x0"][:2], 40, exogenous=steps, **stop, **others)
        last, z = int(known.last), np.reshape(run["x"], (-1, 4))
        assert run["ended"] == known.ended and run["switches"] == known.switches
        np.testing.assert_array_equal(z[:, 2:], known.exogenous[: last + 1])
        np.testing.assert_allclose(z[:, :2], known.states[: last + 1], rtol=1e-9)
        np.testing.assert_array_equal(run["symbols"], known.symbols[:last])
        np.testing.assert_allclose(run["cost"], known.costs[: last + 1], rtol=1e-9)


def test_a_slider_acts_on_the_map_at_once(show):
    shown = opened(show, room())
    labels = shown.page.locator("#told label > span:first-child").all_inner_texts()
    assert labels == ["setpoint [degC]", "outdoor [degC]"]
    assert "told to the controller" in shown.text("#told")
    assert not shown.page.locator("#sliders").is_visible()  # both states are on the map
    before, _ = shown.colors(np.random.default_rng(1).uniform(0.01, 0.99, (300, 2)))
    for setpoint, outdoor in ((25.2, 15.0), (19.0, 35.0)):
        shown.slide("#told-0", setpoint)
        shown.slide("#told-1", outdoor)
        assert shown.state["fixed"][2:] == [setpoint, outdoor]
        assert shown.text("output[for=told-0]") == f"{setpoint:g}"
        shown.assert_map()
        pointed = shown.hover([20.0, 21.0])
        assert pointed["symbol"] == room()(pointed["state"][:2], [setpoint, outdoor])
        told_text = shown.text("#readout .told")
        assert f"setpoint = {setpoint:g} degC, outdoor = {outdoor:g} degC" in told_text
    after, _ = shown.colors(np.random.default_rng(1).uniform(0.01, 0.99, (300, 2)))
    assert (before != after).any()


def test_the_target_and_the_least_cost_are_those_of_the_sliders(show):
    shown = opened(show, room())
    for setpoint in (20.0, 24.0):
        shown.slide("#told-0", setpoint)
        seen = shown.page.evaluate("capsyn.map()")
        air = 14 + 16 * np.array(seen["target"])[:, 0]
        np.testing.assert_allclose(np.abs(air - setpoint), 0.5, atol=0.01)
        least = 14 + 16 * np.array(seen["goal"])[:, 0]
        assert 0.02 < np.abs(least - setpoint).min() and np.abs(least - setpoint).max() < 0.2
    assert "least running cost" in shown.text("#legend")


def test_a_running_trajectory_is_told_from_then_on(show):
    shown = opened(show, room())
    shown.slide("#told-0", 22)
    shown.slide("#told-1", 10)
    shown.click([27.0, 20.0])
    assert shown.active["start"][2:] == [22, 10]
    constant = {"setpoint": 22, "outdoor": 10}
    assert_same(shown.active, told(shown.active, **constant))
    shown.slide("#scrub", 0.335)  # between two samples: the next one takes it
    time = shown.state["time"]
    later = np.ceil(time * RATE) / RATE
    assert later > time
    shown.slide("#told-0", 25)
    assert shown.state["fixed"][2] == 25 and shown.state["time"] == time
    assert shown.active["now"][2] == 22
    assert_same(shown.active, told(shown.active, setpoint={0: 22, later: 25}, outdoor=10))
    shown.slide("#scrub", 0.75)
    shown.slide("#told-1", -5)
    shown.slide("#told-1", 30)  # as a slider is dragged
    known = told(shown.active, setpoint={0: 22, later: 25}, outdoor={0: 10, 45: 30})
    assert_same(shown.active, known)
    assert "setpoint 22, outdoor 10 at first" in shown.text(".chip.active")
    for row, values in zip(("setpoint", "outdoor"), known.exogenous.T):
        (series,) = [one for one in shown.page.evaluate("capsyn.series()")
                     if one["name"] == f"{row} [degC]"]  # fmt: skip
        times, points = np.array(series["points"])
        assert series["kind"] == "told"
        np.testing.assert_array_equal(points, values[np.rint(times * RATE).astype(int)])
        assert set(points) == set(values)
    shown.slide("#scrub", 0.5)  # the sliders show what it is told at the present
    assert shown.state["fixed"][2:] == [25, 10]
    shown.assert_map()
    shown.slide("#told-0", 19)  # what was told later is forgotten
    assert_same(shown.active, told(shown.active, setpoint={0: 22, later: 25, 30: 19}, outdoor=10))
    shown.set("rate", 4)
    known = simulate(room(), shown.active["start"][:2], DURATION, rate=4,
                     exogenous={"setpoint": {0: 22, later: 25, 30: 19}, "outdoor": 10})  # fmt: skip
    assert_same(shown.active, known)
    shown.page.click("#reset")
    assert shown.state["fixed"][2:] == [22, 10]
    shown.slide("#told-0", 24)  # at the start it is all of the trajectory
    known = simulate(room(), shown.active["start"][:2], DURATION, rate=4, exogenous=[24, 10])
    assert_same(shown.active, known)
    assert "at first" not in shown.text(".chip.active")


def test_a_slider_acts_while_it_plays(show):
    shown = opened(show, room(), reduced_motion="no-preference")
    shown.page.select_option("#speed", label="5 min/s")
    shown.click([20.0, 20.0])
    shown.wait_for(lambda state: state["playing"] and state["time"] > 2)
    shown.slide("#told-0", 25.5)
    state = shown.state
    assert state["playing"] and state["fixed"][2] == 25.5
    shown.wait_for(lambda state: state["tracks"][0]["now"][2] == 25.5)
    shown.page.click("#play")
    end = shown.active["end"]
    assert end[2] == 25.5 and abs(end[0] - 25.5) < 1.5 and shown.active["start"][2] == 22


def test_after_the_end_a_slider_waits_for_the_next_start(show):
    shown = opened(show, room())
    before = shown.active
    shown.slide("#told-0", 19)
    assert shown.active == before and shown.state["fixed"][2] == 19
    assert "from the next start on" in shown.text("#told")
    shown.assert_map()
    shown.page.click("#play")
    shown.page.click("#play")
    assert shown.state["fixed"][2] == 19 and "next start" not in shown.text("#told")
    assert shown.active["start"][2:] == [19, 15]
    assert_same(shown.active, told(shown.active, setpoint=19, outdoor=15))
    shown.slide("#scrub", 1)
    shown.slide("#told-0", 23)
    shown.page.check("#keep")
    shown.click([28.0, 28.0])
    assert [track["start"][2] for track in shown.state["tracks"]] == [19, 23]
    shown.page.click(".chip:first-child .choose")  # the sliders are those of the active one
    assert shown.state["fixed"][2] == 19


def test_exogenous_inputs_on_the_axes_of_the_map(show):
    shown = opened(show, room())
    shown.page.select_option("#axis-y", label="setpoint")
    assert shown.state["axes"] == [0, 2]
    rows = shown.page.locator("#sliders label:visible > span:first-child").all_inner_texts()
    assert rows == ["wall [degC]", "follow the trajectory"]
    shown.assert_map()
    shown.slide("#told-0", 20)
    drawn = shown.page.evaluate(
        """([x, y]) => {
          const canvas = document.getElementById("map"), box = canvas.getBoundingClientRect();
          const scale = canvas.width / canvas.clientWidth, context = canvas.getContext("2d");
          const at = [Math.round((x - box.x) * scale), Math.round((y - box.y) * scale)];
          const { data } = context.getImageData(at[0], at[1] - 1, 1, 3);
          return [data[3], data[7], data[11]];
        }""",
        shown.place([14.4, 22, 20, 15]),
    )
    assert max(drawn) == 255  # a line over the map
    shown.click([25.0, 20.0, 24.0, 15.0])  # what it is told comes from the slider
    start = shown.active["start"]
    assert start[0] == pytest.approx(25, abs=0.1) and start[2:] == [20, 15]
    assert_same(shown.active, told(shown.active, setpoint=20, outdoor=15))


def test_a_policy_that_is_told_and_remembers(show):
    policy = room(3.0)
    assert policy.remembers
    shown = opened(show, policy)
    shown.page.select_option("#in-force", label="heat")
    shown.slide("#told-0", 24.5)
    shown.assert_map(current=1)
    shown.click([20.0, 20.0])
    shown.slide("#scrub", 0.5)
    shown.slide("#told-0", 20)
    shown.assert_map(current=1)
    known = simulate(policy, shown.active["start"][:2], DURATION,
                     exogenous={"setpoint": {0: 24.5, 30: 20}, "outdoor": 15})  # fmt: skip
    assert_same(shown.active, known)
    assert "of at least 3 min" in shown.text("#timers")


@pytest.mark.parametrize("kind", ["tree", "affine"])
def test_trees_and_affine_leaves(show, kind):
    policy = compress(room()) if kind == "tree" else room(leaves="affine")
    shown = opened(show, policy)
    shown.slide("#told-0", 25)
    shown.slide("#told-1", -2)
    shown.assert_map()


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_has_room_and_is_looked_at(show, width, scheme):
    shown = show(room(), width=width, height=1000, color_scheme=scheme)
    shown.slide("#scrub", 0.4)
    shown.slide("#told-0", 25)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    shown.page.screenshot(path=OUTPUT / f"told-{scheme}-{width}.png", full_page=True)
    over = shown.page.evaluate("""() => [...document.querySelectorAll("#told label > *")].map(
      one => one.getBoundingClientRect().right
        - document.getElementById("told").getBoundingClientRect().right)""")
    assert max(over) < 0
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= width
    assert shown.text("#summary").startswith("2 states · 2 exogenous inputs · 3 symbols")
    text = shown.text("#facts")
    assert "Exogenous inputs" in text and "its law's in the middle" in text
    topics = shown.page.locator("#formulas h3").all_inner_texts()
    assert topics == ["dynamics", "cost", "target", "default control"]
    assert shown.page.locator("#formulas math").count() == 2 + 2 + 1 + 1


def test_other_pages_have_no_such_sliders(show):
    policy = synthesized("cart-pendulum", max_level=1)
    assert "exogenous" not in json_of(page(policy))
    shown = show(policy)
    assert not shown.page.locator("#told").count()
    assert "least running cost" not in shown.text("#legend")
    assert shown.page.evaluate("capsyn.map().goal") == []
