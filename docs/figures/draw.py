"""Draw the figures of the README."""

from pathlib import Path

from capsyn import problems, synthesize
from capsyn.plots import save_policy_plot

HERE = Path(__file__).parent

if __name__ == "__main__":
    for name in ("cart-pendulum", "double-tank-a"):
        save_policy_plot(synthesize(problems.get(name)), HERE / f"{name}.png")
