"""Options of a closed loop, what their texts mean, and the command that simulates one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from capsyn.cli.options import (
    Backend,
    MinDwell,
    Outside,
    OutsideAtOnce,
    Seed,
    Threads,
    assignments,
    number,
    one_or_list,
    option,
    option_name,
    region,
)
from capsyn.errors import ProblemError

if TYPE_CHECKING:
    from capsyn.modelling.problem import Problem
    from capsyn.policies.policy import Policy
    from capsyn.simulation.options import LoopOptions


@dataclass(frozen=True)
class LoopTexts:
    """`capsyn.simulation.options.LoopOptions` as texts."""

    duration: float | None = option(
        "Time to simulate [time unit of the model, as all times].", default=20.0
    )
    rate: float | None = option(
        "Samples per time unit [default: 1 over the policy's sample time, which is about a "
        "hundredth of the horizon if the problem gives none]."
    )
    target: str | None = option(
        "States that count as arrived: NAME=LOW:HIGH[,..], NAME=VALUE[,..] with "
        "--tolerance, or FILE.py:NAME of a function of x (and w) that is true there.",
        metavar="SET",
    )
    tolerance: float | None = option("Radius of a target that is given by values.")
    model: str | None = option(
        "Another plant than the policy's model: a problem as for synth, or FILE.py:NAME of "
        "a function of x and u. The function takes w after these if there are exogenous "
        "inputs, and then p if there are parameters. A policy without a model, such as an "
        "imported one, takes a problem only.",
        metavar="PLANT",
    )
    parameter: list[str] | None = option(
        "A parameter of the plant, in the order of p. verify and certify also take a range. "
        "May be repeated.",
        metavar="NAME=P[:P]",
    )
    exogenous: list[str] | None = option(
        "What the policy is told beside the state: a value, steps TIME:VALUE,TIME:VALUE, or "
        "a CSV file of steps with a column time and a column for each input. NAME=A:B alone "
        "is a step to B at time A in simulate, and the range from A to B in verify and "
        "certify. verify draws from this range, and from the box of inputs that are not "
        "given. May be repeated.",
        metavar="NAME=W|NAME=T:W,T:W[,..]|FILE.csv",
    )
    disturbance: str | None = option(
        "Disturbance that is added to the rates: one number for all states, or one for "
        "each. verify also takes a range D[,D..]:D[,D..].",
        metavar="D[,D..]",
    )
    noise: str | None = option(
        "Standard deviation of the noise on measured states: one for all states, one for "
        "each, or one for each state and then each exogenous input. verify also takes a "
        "range S[,S..]:S[,S..].",
        metavar="S[,S..]",
    )
    delay: str | None = option(
        "Time from a sample until its control acts [time unit]. verify also takes a range T:T.",
        metavar="T",
    )
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
        "Tell how closely a state follows an exogenous input or a number. In verify, this "
        "counts until a trial arrives, unless there is --hold. Give it once for each state.",
        metavar="STATE=NAME|W",
        before="disturbance",
    )
    avoid: str | None = option(
        "States that a loop must never reach: NAME=LOW:HIGH[,..], or FILE.py:NAME of a "
        "function of x (and w) that is true there.",
        metavar="SET",
        before="model",
    )
    stay_in: str | None = option(
        "States that a loop must never leave, written as for --avoid.",
        metavar="SET",
        before="model",
    )
    cost: list[str] | None = option(
        "Another running cost whose sum is reported, a function of x (and w) [cost / time "
        "unit]. May be repeated.",
        metavar="FILE.py:NAME",
        before="disturbance",
    )
    online: str | None = option(
        "Solve online in receding horizon in place of the policy: ssac or sac.", before="seed"
    )
    background: bool = option(
        "Whether the policy is the default control of the online controller.",
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
    if isinstance(texts, ControllerTexts):
        values |= _judged(policy, texts)
    chosen = {name: value for name, value in values.items() if value is not None}
    return LoopOptions(**sampled_options(policy, texts, one), **chosen, **more)


def _judged(policy: Policy | Problem, texts: ControllerTexts) -> dict[str, Any]:
    """Return the sets to avoid and to stay in, and the costs by name, that texts mean."""
    from capsyn.cli.problem_finder import find_function

    known, costs = policy.space.names, {}
    for text in texts.cost or []:
        name = text.rpartition(":")[2]
        if name in costs:
            raise ProblemError(f"--cost must give each name once; got '{name}' again")
        costs[name] = find_function(text)
    sets = {"avoid": texts.avoid, "stay_in": texts.stay_in}
    return {"costs": costs or None} | {
        name: None if text is None else region_or_function(option_name(name), text, known)
        for name, text in sets.items()
    }


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
        "exogenous": exogenous_inputs(texts.exogenous, one),
    }
    return {name: value for name, value in values.items() if value is not None}


def exogenous_inputs(texts: list[str] | None, one: Callable[[str, str], Any] = number) -> Any:
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
