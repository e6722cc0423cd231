"""The command that simulates closed loops."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from capsyn.cli.console import show, working
from capsyn.cli.loop import ControllerTexts, controller_of, loop_options, tracked
from capsyn.cli.options import File, Json, flat, number_list, option
from capsyn.errors import ProblemError

if TYPE_CHECKING:
    from capsyn.policies.policy import Policy

MOST_STEPS = 6
"""Most steps of an exogenous input that are printed."""


@dataclass(frozen=True)
class SimulateOptions(ControllerTexts):
    """Options of ``capsyn simulate``."""

    x0: list[str] | None = option(
        "Initial state [default: a random state]. May be repeated.",
        metavar="X[,X..]",
        before="duration",
    )
    output: str | None = option(
        "The file of the trajectories: .csv, .json, .png, .pdf or .svg.",
        "--output",
        "-o",
        metavar="FILE",
        before="target",
    )
    stop_at_target: bool = option(
        "Whether a trajectory ends when it reaches the target.", default=False, before="model"
    )
    band: float | None = option(
        "Largest error of a tracked state that counts as settled [state unit] [default: 2 % "
        "of the largest error at a change].",
        before="disturbance",
    )


@flat
def simulate(file: File, options: SimulateOptions, as_json: Json = False) -> None:
    """Simulate the closed loop of a policy."""
    from capsyn.policies.policy import Policy
    from capsyn.simulation.simulate import trajectories
    from capsyn.simulation.tracking import BAND, check_followed, tracking
    from capsyn.validation import whole_number

    track = tracked(options.track) or {}
    save = _saving(options.output, track)
    seed = whole_number("--seed", options.seed, least=0)
    policy = Policy.load(file)
    states = _initial_states(policy, options.x0, seed)
    check_followed(track, policy.domain.names, policy.space.names[policy.domain.n :])
    for name in ("noise", "delay", "disturbance"):
        if ":" in (getattr(options, name) or ""):
            raise ProblemError(f"--{name} must be one value here; ranges are for verify")
    with working("simulating"):
        controller = controller_of(policy, options)
        loop = loop_options(policy, options, stop_at_target=options.stop_at_target)
        trajectory = trajectories(controller, states[0] if len(states) == 1 else states, loop)
    save(trajectory)
    rows = trajectory.summary()
    for state, reference in track.items():
        figures = tracking(trajectory, state, reference, options.band).to_json()
        for k, row in enumerate(rows):
            of_trial = {name: values[k] for name, values in figures.items()}
            row.setdefault("tracking", {})[f"{state} - {reference}"] = of_trial
    told = list(_told_sentences(loop.exogenous or {}, trajectory.time_unit))
    if options.rate is None:
        period = trajectory.times[1] - trajectory.times[0]
        told.append(f"sampled every {period:g} {trajectory.time_unit}, as the policy says")
    band = f"{BAND:.0%} of the largest step" if options.band is None else f"{options.band:g}"
    text = "\n".join([*told, *(_sentence(row, band, trajectory.figures) for row in rows)])
    end = None if options.output is None else f"wrote {options.output}"
    show(as_json, rows if len(rows) > 1 else rows[0], lambda: typer.echo(text), end)


def _saving(output: str | None, track: dict[str, str | float]) -> Callable[[Any], None]:
    """Return what writes a trajectory to a file, by its ending; nothing for None.

    A picture has what is tracked beside the states that should follow it.
    """
    if output is None:
        return lambda trajectory: None
    from capsyn.execution.files import check_writable
    from capsyn.plots.figure import FORMATS, check_format
    from capsyn.plots.trajectory import save_trajectory_plot

    kind = check_format(output, ("csv", "json", *FORMATS), "the output")
    check_writable(output)
    if kind in FORMATS:
        return lambda trajectory: save_trajectory_plot(trajectory, output, track)
    return lambda trajectory: trajectory.save(output)


def _initial_states(policy: Policy, texts: list[str] | None, seed: int) -> Any:
    """Return initial states (B, n) [state units]: those of the texts, else a random one."""
    import numpy as np

    states = [number_list("--x0", text) for text in texts or []] or policy.domain.sample(1, seed)
    if len({len(state) for state in states} | {policy.domain.n}) > 1:
        names = ", ".join(policy.domain.names)
        raise ProblemError(f"--x0 must be {policy.domain.n} number(s) ({names}); got {texts}")
    return np.array(states)


def _sentence(row: dict[str, Any], band: str, figures: Iterable[str]) -> str:
    def state(values: list[float | None]) -> str:
        return "(" + ", ".join("nan" if v is None else f"{v:g}" for v in values) + ")"

    unit, arrived = row.get("time_unit", "s"), row["arrived"]
    told = {name: row[name] for name in figures}
    reached = "" if arrived is None else f"; in the target first at {arrived:g} {unit}"
    lost = f"; {row['outside']:,} samples outside the domain" if row["outside"] else ""
    cost = "not finite" if row["cost"] is None else f"{row['cost']:.6g}"
    more = "".join(f", {name} {'nan' if v is None else f'{v:.6g}'}" for name, v in told.items())
    if row.get("entered") is not None:
        lost += f"; where it must not be first at {row['entered']:g} {unit}"
    return (
        f"from {state(row['initial'])} to {state(row['final'])} in {row['duration']:g} {unit}, "
        f"ended: {row['ended']}; {row['switches']:,} switches, cost {cost}{more}{reached}{lost}"
        + "".join(f"\n{text}" for text in _tracking_sentences(row, unit, band))
    )


def _told_sentences(exogenous: Mapping[str, Any], unit: str) -> Iterator[str]:
    """Yield how each exogenous input was read."""
    for name, value in exogenous.items():
        if not isinstance(value, dict):
            yield f"{name}: {value:g} throughout"
            continue
        steps = [f"{step:g} from {time:g} {unit}" for time, step in value.items()]
        if len(steps) > MOST_STEPS:
            steps[MOST_STEPS - 1 : -1] = [".."]
        yield f"{name}: {', '.join(steps)}" + (f" ({len(value):,} steps)" if ".." in steps else "")


def _tracking_sentences(row: dict[str, Any], unit: str, band: str) -> Iterator[str]:
    for name, figures in row.get("tracking", {}).items():
        values = {key: figures[key] for key in ("rms", "bias", "overshoot")}
        parts = [f"{key} {'nan' if v is None else f'{v:.4g}'}" for key, v in values.items()]
        time = figures["settling"]
        settled = "not settled" if time is None else f"settled within {time:.4g} {unit}"
        settled += f" (to {band})"
        yield f"  {name}: {', '.join(parts)}, {settled}"
