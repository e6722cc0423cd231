"""The command that says how often a policy switches, and tries prices and least times."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capsyn.cli.console import print_table, show, working
from capsyn.cli.options import (
    Backend,
    File,
    Json,
    Seed,
    Threads,
    flat,
    listed,
    number_list,
    option,
    price,
)
from capsyn.errors import ProblemError


@dataclass(frozen=True)
class CurveOptions:
    """Options of ``capsyn switching``."""

    curve: bool = option(
        "Try prices and least times, and write a table and a picture.", "--curve", default=False
    )
    prices: str | None = option(
        "Prices to try, such as 0,0.3%,1%,3% [default: 0 to 10%].", metavar="P[,P..]"
    )
    holds: str | None = option(
        "Least times to try, each for all symbols [time unit] [default: the policy's own].",
        metavar="T[,T..]",
    )
    trials: int = option(
        "Number of closed loops from random states for each price and least time.", default=200
    )
    duration: float | None = option("Time of a closed loop [time unit] [default: 20 horizons].")
    rate: float | None = option("Samples per time unit [default: by the policy's sample time].")
    output: str | None = option(
        "The picture: .png, .svg or .pdf. The table has its name with .csv.", "--output", "-o",
        metavar="FILE",
    )  # fmt: skip
    seed: Seed = 0
    backend: Backend = "auto"
    threads: Threads = None


@flat
def switching(file: File, options: CurveOptions, as_json: Json = False) -> None:
    """Say how often a policy switches, at which cost, and, with --curve, at other prices."""
    from capsyn.policies.policy import Policy
    from capsyn.verification.switching_curve import switching_point

    names = "trials duration rate seed backend threads".split()
    loop = {name: getattr(options, name) for name in names}
    if options.curve:
        _switching_curve(file, options, loop, as_json)
        return
    for name in ("prices", "holds", "output"):
        if getattr(options, name) is not None:
            raise ProblemError(f"--{name} needs --curve")
    with working("simulating"):
        row = switching_point(Policy.load(file), **loop).to_json()
    del row["recommended"]  # nothing to compare with
    show(as_json, row, lambda: print_table([row]), None)


def _switching_curve(file: str, options: CurveOptions, loop: dict[str, Any], as_json: bool) -> None:
    from capsyn.execution.files import check_writable, save_points
    from capsyn.plots.figure import check_format
    from capsyn.plots.switching import save_switching_plot
    from capsyn.policies.policy import Policy
    from capsyn.verification.switching_curve import PRICES, switching_curve

    picture = f"{Path(file).stem}-switching.png" if options.output is None else options.output
    check_format(picture)
    table = str(Path(picture).with_suffix(".csv"))
    for path in (picture, table):
        check_writable(path)
    policy = Policy.load(file)
    prices = PRICES
    if options.prices is not None:
        prices = tuple(price("--prices", text) for text in listed(options.prices))
    holds = None if options.holds is None else number_list("--holds", options.holds)
    with working("trying prices") as say:
        points = switching_curve(policy, prices, holds, **loop, progress=say)
    save_points(points, table)
    save_switching_plot(points, policy.name, policy.time_unit, picture)
    rows = [point.to_json() for point in points]
    shown = [row | {"recommended": "*" if row["recommended"] else ""} for row in rows]
    data = {"points": rows, "table": table, "picture": picture}
    show(as_json, data, lambda: print_table(shown), f"wrote {table} and {picture}")
