"""Pages of policies in Debian's Chromium, and what they show."""

import base64
import contextlib
import functools
import json
import re
import shutil
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from capsyn import explore, problems, synthesize

OUTPUT = Path(__file__).parents[3] / "build" / "explorer"
"""Where screenshots are kept; not part of the repository."""
CHROMIUM = shutil.which("chromium")
QUIET = {"reduced_motion": "reduce"}


@functools.cache
def synthesized(name, **changes):
    """Return the policy of a built-in problem."""
    return synthesize(problems.plain(name), **changes)


def json_of(html):
    """Return what a page knows, but for the values of arrays."""
    (text,) = re.findall(r'id="data">([^<]*)</script>', html)
    data = zlib.decompress(base64.b64decode(text, validate=True))
    size = int.from_bytes(data[:4], "little")
    return json.loads(data[4 : 4 + size])


@contextlib.contextmanager
def chromium():
    """Yield a browser; skip where there is none."""
    if CHROMIUM is None:
        pytest.skip("needs chromium: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield Tabs(browser)
        browser.close()


class Tabs:
    """Tabs of a browser, each used again once it is closed: a new one takes a process of its own.

    A page keeps nothing beyond its own life, neither in storages nor in settings of the tab.
    """

    def __init__(self, browser):
        self.browser, self.free = browser, {}

    def open(self, **options):
        """Return a blank tab, and what closes it."""
        free = self.free.setdefault(tuple(sorted(map(repr, options.items()))), [])
        tab = free.pop() if free else self.browser.new_context(**options).new_page()

        def close():
            tab.mouse.move(0, 0)
            tab.goto("about:blank")
            free.append(tab)

        return tab, close


class Shown:
    """A page of a policy that is open in the browser, and all that it complained about."""

    def __init__(self, browser, policy, directory, width=1280, height=800, **options):
        self.policy = policy
        self.file = explore(policy, directory / "page.html", options.pop("drawing", None))
        size = {"width": width, "height": height}
        self.page, self._close_tab = browser.open(viewport=size, **(QUIET | options))
        self.messages, self.requests = [], []
        self._listeners = {
            "console": self.heard,
            "pageerror": lambda error: self.messages.append(str(error)),
            "dialog": lambda dialog: self.messages.append(f"dialog {dialog.message}"),
            "request": lambda request: self.requests.append(request.url),
        }
        for event, listener in self._listeners.items():
            self.page.on(event, listener)
        self.page.goto(self.file.as_uri())
        self.page.wait_for_function("window.capsyn", timeout=15_000)
        self.settle()

    def close(self):
        """Leave the page."""
        for event, listener in self._listeners.items():
            self.page.remove_listener(event, listener)
        self._close_tab()

    def heard(self, message):
        if "willReadFrequently" not in message.text:  # the tests read the canvas, not the page
            self.messages.append(message.text)

    def wait_for(self, condition, seconds=15):
        """Wait until a condition of the page's state holds."""
        end = time.monotonic() + seconds
        while not condition(self.state):
            assert time.monotonic() < end, self.state
            time.sleep(0.05)

    def settle(self):
        """Wait until what was asked for has been painted."""
        self.page.evaluate(
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )

    @property
    def state(self):
        """What the page says that it shows."""
        self.settle()
        return self.page.evaluate("capsyn.state()")

    @property
    def active(self):
        """The active trajectory."""
        (active,) = [track for track in self.state["tracks"] if track["active"]]
        return active

    def text(self, selector):
        """Return the text of an element as it is shown."""
        return self.page.inner_text(selector)

    def place(self, state):
        """Return where on the screen a state of the plane is."""
        self.page.evaluate("scrollTo(0, 0)")
        shown, box = self.state, self.page.locator("#map").bounding_box()
        frame, (x0, x1, y0, y1) = shown["frame"], shown["bounds"]
        across, up = ((state[a] - low) / (high - low) for a, low, high in
                      zip(shown["axes"], (x0, y0), (x1, y1)))  # fmt: skip
        if len(state) == 1:
            up = 0.5
        return (
            box["x"] + frame["x"] + across * frame["width"],
            box["y"] + frame["y"] + (1 - up) * frame["height"],
        )

    def hover(self, state):
        self.page.mouse.move(*self.place(state))
        return self.state["pointed"]

    def click(self, state):
        self.page.mouse.click(*self.place(state))
        return self.active

    def set(self, name, value):
        """Type a value into a setting of the closed loop."""
        self.page.fill(f"#set-{name}", str(value))
        self.page.locator(f"#set-{name}").blur()
        self.settle()

    def slide(self, selector, value):
        """Move a slider."""
        self.page.locator(selector).evaluate(
            "(slider, value) => { slider.value = value;"
            " slider.dispatchEvent(new Event('input', {bubbles: true})); }",
            value,
        )
        self.settle()

    def colors(self, shares):
        """Return the colours (K, 3) of the map at shares (K, 2) of the plane, from its lower left.

        Also the states (K, n) of the centres of those pixels.
        """
        shown = self.state
        pixels, where = self.page.evaluate(
            """shares => {
              const { frame } = capsyn.state(), canvas = document.getElementById("map-base");
              const scale = canvas.width / canvas.clientWidth, context = canvas.getContext("2d");
              const [w, h] = [Math.round(frame.width * scale), Math.round(frame.height * scale)];
              const [x0, y0] = [Math.round(frame.x * scale), Math.round(frame.y * scale)];
              const all = context.getImageData(x0, y0, w, h).data;
              const pixels = [], where = [];
              for (const [across, up] of shares) {
                const column = Math.floor(across * w), row = Math.floor((1 - up) * h);
                pixels.push([...all.slice(4 * (row * w + column), 4 * (row * w + column) + 3)]);
                where.push([(column + 0.5) / w, 1 - (row + 0.5) / h]);
              }
              return [pixels, where];
            }""",
            shares.tolist(),
        )
        where = np.array(where)
        states = np.tile(np.array(shown["fixed"], dtype=float), (len(where), 1))
        x0, x1, y0, y1 = shown["bounds"]
        states[:, shown["axes"][0]] = x0 + where[:, 0] * (x1 - x0)
        if self.policy.space.n > 1:
            states[:, shown["axes"][1]] = y0 + where[:, 1] * (y1 - y0)
        return np.array(pixels), states

    def assert_map(self, count=400, current=None):
        """Check the map's colours at random pixels against the policy; outlines must be off.

        They are of what follows `current`.
        """
        assert not self.state["outlines"]
        shares = np.random.default_rng(3).uniform(0.001, 0.999, (count, 2))
        pixels, states = self.colors(shares)
        colors = np.array([hex_color(color) for color in self.state["colors"]])
        painted = (pixels == colors[self.policy(states, outside="nearest", current=current)]).all(
            axis=1
        )
        assert painted.mean() > 0.99  # a pixel's centre may round to the other side of a face
        return pixels, states


def hex_color(text):
    """Return red, green and blue of ``#rrggbb``."""
    return [int(text[k : k + 2], 16) for k in (1, 3, 5)]
