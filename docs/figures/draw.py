"""Draw the figures of README and guides."""

import dataclasses
import re
import runpy
import shutil
import tempfile
from pathlib import Path

import loops

from capsyn import Box, certify, explore, problems, synthesize
from capsyn.compression.curve import size_curve
from capsyn.plots.certificate import save_certificate_plot
from capsyn.plots.curve import save_curve_plot
from capsyn.plots.policy import save_policy_plot

HERE = Path(__file__).parent


def save_screenshot(policy, path):
    """Write a picture of a policy's page, some seconds into two closed loops."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print(f"{path.name} is left as it is: chromium is not installed (apt-get install chromium)")
        return
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as directory, sync_playwright() as tools:
        page_file = explore(policy, Path(directory) / "page.html")
        browser = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        size = {"width": 1280, "height": 800}
        page = browser.new_page(viewport=size, device_scale_factor=1.5, reduced_motion="reduce")
        page.goto(page_file.as_uri())
        page.check("#keep")
        page.evaluate("scrollTo(0, 0)")
        box = page.locator("#map").bounding_box()
        page.mouse.click(box["x"] + 0.55 * box["width"], box["y"] + 0.62 * box["height"])
        page.locator("#scrub").evaluate(
            "bar => { bar.value = 0.3; bar.dispatchEvent(new Event('input')); }"
        )
        page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.3 * box["height"])
        page.wait_for_timeout(200)
        page.screenshot(path=path)
        browser.close()


def of_page(page, name):
    """Return what the file of some name in a guide's code defines."""
    text = (HERE.parent / page).read_text()
    (code,) = re.findall(
        rf"^```python\n(# {re.escape(name)}\n.*?)^```$", text, re.DOTALL | re.MULTILINE
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_text(code)
        return runpy.run_path(str(path))


def save_guide_pictures():
    """Write the pictures that open guides."""
    for name in ("alphabets", "choosing", "good", "references", "switching", "limits", "evidence"):
        getattr(loops, name)(HERE / f"{name}.png")
    loops.dwell(HERE / "dwell.png", of_page("dwell.md", "room.py")["problem"])
    loops.discrete_time(
        HERE / "discrete-time.png", of_page("discrete-time.md", "stock.py")["problem"]
    )
    loops.models(HERE / "models.png", of_page("models.md", "spring.py"))
    loops.coordinates(HERE / "coordinates.png", of_page("coordinates.md", "axes.py"))
    loops.actuators(
        HERE / "actuators.png", lambda name: of_page("actuators.md", f"{name}.py")["problem"]
    )


if __name__ == "__main__":
    save_guide_pictures()
    save_policy_plot(synthesize(problems.get("double-tank-a")), HERE / "double-tank-a.png")
    pendulum = synthesize(problems.get("cart-pendulum"))
    save_policy_plot(pendulum, HERE / "cart-pendulum.png", current="5")
    loops.in_few_colors(HERE / "cart-pendulum.png", HERE / "cart-pendulum.png")
    plain = synthesize(problems.plain("cart-pendulum"))
    tanks = synthesize(problems.get("double-tank-b"))
    certificate = certify(tanks, Box([0.1, 0.1], [0.9, 0.9]))
    save_certificate_plot(certificate, tanks.name, HERE / "proved.png")
    save_curve_plot(size_curve(plain), plain.name, HERE / "curve.png")
    dimensions = runpy.run_path(str(HERE.parents[1] / "benchmarks" / "dimensions.py"))
    dimensions["save_growth_plot"](HERE / "growth.png")
    sparsity = runpy.run_path(str(HERE.parents[1] / "benchmarks" / "sparsity.py"))
    sparsity["save_plot"](HERE / "sparsity.png")
    save_screenshot(pendulum, HERE / "explorer.png")
    satellite = of_page("own-system.md", "satellite.py")["problem"]
    settings = dataclasses.replace(satellite.settings, control_weight=100.0)  # as on the page
    policy = synthesize(satellite, settings=settings)
    save_policy_plot(policy, HERE / "satellite.png", ("wx", "wy"), {"wz": 0.05})
    runpy.run_path(str(HERE / "guides.py"))["draw"]()  # the pictures at the heads of guides
