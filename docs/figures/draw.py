"""Draw the figures of the README."""

from pathlib import Path

from capsyn import problems, synthesize
from capsyn.compression.curve import size_curve
from capsyn.curve_plot import save_curve_plot
from capsyn.plots import save_policy_plot

HERE = Path(__file__).parent

if __name__ == "__main__":
    for name in ("cart-pendulum", "double-tank-a"):
        save_policy_plot(synthesize(problems.get(name)), HERE / f"{name}.png")
    pendulum = synthesize(problems.get("cart-pendulum"))
    save_curve_plot(size_curve(pendulum), pendulum.name, HERE / "curve.png")
