"""Options of a closed loop, what their texts mean, and the command that simulates one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from capsyn.cli.console import show, working
from capsyn.cli.options import (
    Backend,
    File,
    Json,
    MinDwell,
    Outside,
    OutsideAtOnce,
    Seed,
    Threads,
    assignments,
    flat,
    number,
    number_list,
    one_or_list,
    option,
    region,
)
from capsyn.errors import ProblemError

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.policies.policy import Policy
    from capsyn.simulation.options import LoopOptions

MOST_STEPS = 6
"""Most steps of an exogenous input that are printed."""


@dataclass(frozen=True)
class LoopTexts:
    """`capsyn.simulation.options.LoopOptions` as texts."""

    duration: float | None = option(
        "Time to simulate, as all times in the model's time unit.", default=20.0
    )
    rate: float | None = option("Samples per time unit [default: by the policy's settings, 1000].")
    target: str | None = option(
        "NAME=LOW:HIGH[,..], NAME=VALUE[,..] with --tolerance, or FILE.py:NAME of a function of x "
        "(and w) that says whether it has arrived.",
        metavar="SET",
    )
    tolerance: float | None = option("Radius of the target.")
    model: str | None = option(
        "Another plant: a problem as for synth, or FILE.py:NAME of a function of x and u, then w "
        "where there are exogenous inputs, then p where there are parameters; a policy without a "
        "model, such as an imported one, takes a problem only.",
        metavar="PLANT",
    )
    parameter: list[str] | None = option(
        "A component of p, in the order of p; verify and certify take a range, too. May be "
        "repeated.",
        metavar="NAME=P[:P]",
    )
    exogenous: list[str] | None = option(
        "What the policy is told beside the state: a value, steps TIME:VALUE,TIME:VALUE, or a CSV "
        "file of steps with a column time and one for each input. NAME=A:B alone is the step to B "
        "at time A in simulate, the range from A to B in certify, and in verify, which draws from "
        "it, and from the box what is not given. May be repeated.",
        metavar="NAME=W|NAME=T:W,T:W[,..]|FILE.csv",
    )
    disturbance: str | None = option(
        "Added to the rates, of all states or of each; verify takes a range D[,D..]:D[,D..], too.",
        metavar="D[,D..]",
    )
    noise: str | None = option(
        "Standard deviation of the measured states, of all or of each, or of each and of each "
        "exogenous input after them; verify takes a range "
        "S[,S..]:S[,S..], too.",
        metavar="S[,S..]",
    )
    delay: str | None = option("Input delay; verify takes a range T:T, too.", metavar="T")
    min_dwell: MinDwell = None
    outside: Outside = None
    outside_at_once: OutsideAtOnce = None
    seed: Seed = 0
    backend: Backend = "auto"
    threads: Threads = None


@dataclass(frozen=True)
class ControllerTexts(LoopTexts):
    """Options of a loop, what is told of it, and which controller runs it."""

    track: list[str] | None = option(
        "Say how closely a state follows an exogenous input, or a number; in verify until a trial "
        "arrives, unless there is --hold. Once for each state.",
        metavar="STATE=NAME|W",
        before="disturbance",
    )
    online: str | None = option(
        "ssac or sac: solve online in receding horizon instead of the policy.", before="seed"
    )
    background: bool = option(
        "Let the policy be the default control of the online controller.",
        default=False,
        before="seed",
    )


def loop_options(
    policy: Policy | Problem,
    texts: LoopTexts,
    *,
    one: Callable[[str, str], Any] = number,
    each: Callable[[str, str], Any] = one_or_list,
    **more: Any,
) -> LoopOptions:
    """Return the options that texts mean for a policy, or that of a problem, and `more`.

    What is None is left out. `one` and `each` give the meaning of a text for one quantity, and for
    each state.
    """
    from capsyn.simulation.options import LoopOptions

    def meant(name: str) -> Any:
        text = getattr(texts, name)
        return None if text is None else each(f"--{name}", text)

    plain = "duration outside outside_at_once backend".split()
    values = {name: getattr(texts, name) for name in plain} | {
        "disturbance": meant("disturbance"),
        "noise": meant("noise"),
    }
    chosen = {name: value for name, value in values.items() if value is not None}
    return LoopOptions(**sampled_options(policy, texts, one), **chosen, **more)


def sampled_options(
    policy: Policy | Problem, texts: Any, one: Callable[[str, str], Any] = number
) -> dict[str, Any]:
    """Return what texts mean that simulated and proved loops share; what is None is left out.

    `texts` has fields of `LoopTexts`; of `one` see `loop_options`.
    """
    plain = "rate min_dwell seed threads".split()
    parameters = assignments("--parameter", texts.parameter or [])
    values = {name: getattr(texts, name) for name in plain} | {
        "model": _model(texts.model),
        "parameters": {name: one(name, text) for name, text in parameters.items()},
        "delay": None if texts.delay is None else one("--delay", texts.delay),
        "target": _target(policy, texts.target, texts.tolerance),
        "exogenous": _exogenous(texts.exogenous, one),
    }
    return {name: value for name, value in values.items() if value is not None}


def _exogenous(texts: list[str] | None, one: Callable[[str, str], Any]) -> Any:
    """Return what exogenous inputs are by name; None for nothing. `one` gives that of one text."""
    if not texts:
        return None
    from capsyn.simulation.exogenous import steps_from_csv

    values: dict[str, Any] = {}
    for text in texts:
        if "=" in text:
            ((name, value),) = assignments("--exogenous", [text]).items()
            label = f"exogenous {name}"
            meant = _steps(name, value) if _is_steps(value, one) else one(label, value)
            if isinstance(meant, list):
                raise ProblemError(f"--exogenous {name} must be one value; got '{value}'")
            given = {name: meant}
        else:
            given = steps_from_csv(text)
        if twice := [name for name in given if name in values]:
            raise ProblemError(f"--exogenous must give each input once; got '{twice[0]}' again")
        values |= given
    return values


def _is_steps(text: str, one: Callable[[str, str], Any]) -> bool:
    """Return whether a text is steps; a pair alone is a range where there are ranges."""
    return ":" in text and ("," in text or one is number)


def _steps(name: str, text: str) -> dict[float, float]:
    """Return the steps of a text such as ``0:20,60:22``."""
    pairs = [part.split(":") for part in text.split(",")]
    if any(len(pair) != 2 for pair in pairs):
        raise ProblemError(f"--exogenous {name} must be TIME:VALUE,TIME:VALUE; got '{text}'")
    label = f"exogenous {name}"
    steps = {number(label, time): number(label, value) for time, value in pairs}
    if len(steps) < len(pairs):
        raise ProblemError(f"--exogenous {name} must have each time once; got '{text}'")
    return steps


def tracked(texts: list[str] | None) -> dict[str, str | float] | None:
    """Return what states should follow, by name; None for nothing."""
    if not texts:
        return None
    pairs = assignments("--track", texts)
    return {state: _name_or_number(text.strip()) for state, text in pairs.items()}


def _name_or_number(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


def controller_of(policy: Policy, texts: ControllerTexts) -> Any:
    """Return what acts in the loop: the policy, or an online controller for its model."""
    if texts.online is None:
        if texts.background:
            raise ProblemError("--background needs --online")
        return policy
    from capsyn.controllers.online import online_controller

    default = policy if texts.background else None
    return online_controller(policy, texts.online, default=default, backend=texts.backend)


def _model(text: str | None) -> Any:
    if text is None:
        return None
    from capsyn.cli.problem_finder import find_function, find_problem
    from capsyn.modelling.problem import Problem
    from capsyn.policies.policy import Policy

    place, _, name = text.rpartition(":")
    if name.isidentifier() and place:
        return find_function(text, (Problem,))
    return Policy.load(text) if text.endswith(".cap") else find_problem(text)


def _target(policy: Policy | Problem, text: str | None, tolerance: float | None) -> Any:
    from capsyn.modelling.targets import with_tolerance

    if text is None:
        return with_tolerance(policy.target, tolerance)
    return region_or_function("--target", text, policy.space.names, tolerance)


def region_or_function(
    name: str, text: str, known: Sequence[str], tolerance: float | None = None
) -> Any:
    """Return the set of states that a text says, or the function of FILE.py:NAME."""
    from capsyn.cli.problem_finder import find_function
    from capsyn.modelling.targets import with_tolerance

    if ".py:" in text or ("=" not in text and ":" in text):
        return with_tolerance(find_function(text), tolerance)
    return region(name, text, known, tolerance)


@dataclass(frozen=True)
class SimulateOptions(ControllerTexts):
    """Options of ``capsyn simulate``."""

    x0: list[str] | None = option(
        "Initial state; may be repeated [default: random].", metavar="X[,X..]", before="duration"
    )
    output: str | None = option(
        ".csv, .json, .png, .pdf or .svg.", "--output", "-o", metavar="FILE", before="target"
    )
    stop_at_target: bool = option("End where the target is reached.", default=False, before="model")
    band: float | None = option(
        "Largest error of a tracked state that has settled [state unit] [default: 2 % of the "
        "largest at a change].",
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
    told = _told_sentences(loop.exogenous or {}, trajectory.time_unit)
    band = f"{BAND:.0%} of the largest step" if options.band is None else f"{options.band:g}"
    text = "\n".join([*told, *(_sentence(row, band) for row in rows)])
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


def _sentence(row: dict[str, Any], band: str) -> str:
    def state(values: list[float | None]) -> str:
        return "(" + ", ".join("nan" if v is None else f"{v:g}" for v in values) + ")"

    unit, arrived = row.get("time_unit", "s"), row["arrived"]
    reached = "" if arrived is None else f"; in the target first at {arrived:g} {unit}"
    lost = f"; {row['outside']:,} samples outside the domain" if row["outside"] else ""
    cost = "not finite" if row["cost"] is None else f"{row['cost']:.6g}"
    return (
        f"from {state(row['initial'])} to {state(row['final'])} in {row['duration']:g} {unit}, "
        f"ended: {row['ended']}; {row['switches']:,} switches, cost {cost}{reached}{lost}"
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
