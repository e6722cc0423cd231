"""How large pages of policies are, how fast they open, and how fast their maps are drawn again."""

import json
import shutil
import statistics
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from capsyn import explore, problems, synthesize

OPENINGS = 7
DRAWINGS = 60
WARM = 20


def opening(browser, path):
    """Return the seconds from asking for a page until it has been painted, with its trajectory."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(path.as_uri())
    painted = "done => requestAnimationFrame(() => setTimeout(() => done(performance.now())))"
    milliseconds = page.evaluate(f"new Promise({painted})")
    page.close()
    return milliseconds / 1000


def redrawing(browser, path):
    """Return the median milliseconds of a map of 900 x 600 pixels, with outlines."""
    page = browser.new_page(reduced_motion="reduce")
    page.goto(path.as_uri())
    times = page.evaluate(f"Array.from({{ length: {DRAWINGS} }}, () => capsyn.redraw(900, 600))")
    page.close()
    return statistics.median(times[WARM:])


def measure():
    """Return rows of figures."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("chromium is not installed: apt-get install chromium")
    rows = []
    with tempfile.TemporaryDirectory() as directory, sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for name, level in (("cart-pendulum", 4), ("cart-pole", 3)):
            policy = synthesize(problems.plain(name), max_level=level)
            path = explore(policy, Path(directory) / f"{name}.html")
            small = name == "cart-pendulum"
            cells = f"page of {name}, {policy.cells.leaf_count:,} cells"
            seconds = [opening(browser, path) for _ in range(OPENINGS)]
            rows += [
                {
                    "what": f"{cells}: size",
                    "value": path.stat().st_size / 1000,
                    "unit": "kB",
                    **({"wanted": "<= 500"} if small else {}),
                },
                {
                    "what": f"{cells}: opens in Chromium, with a first trajectory",
                    "value": statistics.median(seconds),
                    "unit": "s",
                    **({"wanted": "<= 1"} if small else {}),
                },
                {
                    "what": f"{cells}: map of 900 x 600 drawn again, with outlines",
                    "value": redrawing(browser, path),
                    "unit": "ms",
                    "wanted": "<= 30",
                },
            ]
        browser.close()
    return rows


if __name__ == "__main__":
    print(json.dumps(measure()))
