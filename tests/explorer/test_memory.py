"""The page of a policy that remembers, in a browser."""

from pathlib import Path

import numpy as np

import capsyn.explorer
from capsyn import Switching, problems, simulate, synthesize
from capsyn.explorer.explore import page
from support.explorer.page import OUTPUT, synthesized
from support.exports import remembering

HOME = Path(capsyn.explorer.__file__).parent


def test_a_policy_that_remembers(show):
    policy = remembering.pendulum()
    shown = show(policy, height=1000)
    shown.slide("#scrub", 0.4)
    OUTPUT.mkdir(parents=True, exist_ok=True)
    shown.page.screenshot(path=OUTPUT / "remembers.png", full_page=True)
    start = shown.active["start"]
    known = simulate(policy, start, 10)
    assert shown.active["switches"] == known.switches
    k = int(np.floor(shown.state["time"] * 1000 + 1e-6))
    so_far = np.count_nonzero(np.diff(known.symbols[: k + 1]))
    told = shown.text("#timers")
    assert f"{so_far} switch" in told and f"of {known.switches}" in told
    assert policy.symbol_name(known.symbols[k]) in told
    shown.page.uncheck("#outlines")
    states = policy.domain.sample(4000, 1)
    follow = np.array([policy(states, current=now) for now in (0, 1, -1)])
    depends = states[follow[0] != follow[1]][0]
    for state, words in ((depends, "5 → 5, -5 → -5, start → "), ([2.2, 2.0], "-5 → -5, start → ")):
        shown.hover(state)
        text = shown.text("#readout").replace("\n", "")
        assert words in text and ("5 or -5" in text) == (words[0] == "5")
        steps = policy.domain.locate(
            np.array([shown.state["pointed"]["state"]]), policy.cells.counts
        )
        assert ("mixed" in text) == (policy.cells.find(steps)[0] in policy.cells.mixed_cells)
    for now, value in ((0, "0"), (1, "1"), (None, "-1")):
        shown.page.select_option("#in-force", value)
        shown.assert_map(current=now)
    rows = policy.transitions[-1 - policy.cells.entries[policy.cells.entries < 0]]
    for source, target in ((0, 0), (0, 1), (1, 0), (1, 1)):
        cells = np.count_nonzero(rows[:, source] == target)
        title = shown.page.locator(f"[data-edge='{source}-{target}'] title").text_content()
        assert f": {cells:,} cells, taken" in title
    shown.page.uncheck("#set-own")
    shown.set("dwell", 0.05)
    known = simulate(policy, start, 10, min_dwell=0.05)
    assert shown.active["switches"] == known.switches and "dwell 0.05 s" in shown.text(".chip")


def test_a_policy_that_only_waits(show):
    problem = problems.get("cart-pendulum").replace(switching=Switching(hold={"5": 0.03}))
    policy = synthesize(problem, max_level=2)
    shown = show(policy)
    known = simulate(policy, shown.active["start"], 10)
    assert shown.active["switches"] == known.switches
    shown.slide("#scrub", 0.01)
    assert "for 0.1 s of at least 0.03 s" in shown.text("#timers") or known.symbols[100] == 1
    assert not shown.page.locator("#in-force").count()
    shown.page.uncheck("#outlines")
    shown.assert_map()


def test_pages_of_policies_without_memory_have_nothing_of_it():
    text = page(synthesized("cart-pendulum", max_level=1))
    assert '"memory"' not in text and (HOME / "page.js").read_text().strip() in text
    assert "in-force" in (HOME / "page.memory.js").read_text() and "in-force" not in text
