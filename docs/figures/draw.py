"""Draw the figures of README and guides."""

import dataclasses
import re
import runpy
import tempfile
from pathlib import Path

from capsyn import problems, synthesize
from capsyn.compression.curve import size_curve
from capsyn.curve_plot import save_curve_plot
from capsyn.plots import save_policy_plot

HERE = Path(__file__).parent


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


if __name__ == "__main__":
    for name in ("cart-pendulum", "double-tank-a"):
        save_policy_plot(synthesize(problems.get(name)), HERE / f"{name}.png")
    pendulum = synthesize(problems.get("cart-pendulum"))
    save_curve_plot(size_curve(pendulum), pendulum.name, HERE / "curve.png")
    satellite = of_page("own-system.md", "satellite.py")["problem"]
    settings = dataclasses.replace(satellite.settings, control_weight=100.0)  # as on the page
    policy = synthesize(satellite, settings=settings)
    save_policy_plot(policy, HERE / "satellite.png", ("wx", "wy"), {"wz": 0.05})
