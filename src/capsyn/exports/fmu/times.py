"""The parameters of an FMU: least times in seconds, and what is held for which of them."""

from __future__ import annotations

from dataclasses import dataclass

from capsyn.exports.c.language import KEYWORDS
from capsyn.exports.identifiers import identifiers
from capsyn.exports.plan import Plan
from capsyn.modelling.time_unit import to_seconds

OWN = ("symbol", "status", "min_dwell", "time")
"""Variables beside states and inputs, and the independent one."""
HOLD_OFF = "hold_off"
"""The parameter of the time after the start."""


@dataclass(frozen=True)
class Times:
    """Times by number, T of them [s]; T itself is the number of what is not held."""

    texts: tuple[str, ...]  # (T,) what they are called, before they are made identifiers
    about: tuple[str, ...]  # (T,)
    seconds: tuple[float, ...]  # (T,)
    of_labels: tuple[int, ...]  # (N + 1,) which one each label is held for once it is entered
    of_inputs: tuple[int, ...]  # (m,) which one each input is held for once it has changed
    hold_off: int  # which one the safe symbol is in force for after the start


def times_of(plan: Plan) -> Times:
    """Return the times of a plan: one for all symbols where these have the same, else of each."""
    policy, rules = plan.policy, plan.policy.rules
    held, locked = rules.holds.tolist(), rules.input_holds.tolist()
    found: list[tuple[str, str, float]] = []
    labels = [0] * plan.labels
    if len(set(held)) == 1:
        about = "How long each symbol is held once it is entered"
        if not plan.has_state:
            about, held = "Least time between switches of the control", [plan.dwell]
        found.append(("min_dwell", about, held[0]))
    else:
        numbers: dict[object, int] = {}
        for k, (name, time) in enumerate(zip(plan.symbol_names, held)):
            key = (plan.first_alike[k], time)  # the default control is held as its like
            if time and key not in numbers:
                numbers[key] = len(found)
                about = f"How long symbol {k} ({name}) is held once it is entered"
                found.append((f"hold_{name}", about, time))
            labels[k] = numbers[key] if time else -1
    inputs = [-1] * policy.alphabet.m
    for k, (name, time) in enumerate(zip(policy.alphabet.inputs, locked)):
        if time:
            inputs[k] = len(found)
            about = f"How long input {name} is held once it has changed"
            found.append((f"hold_{name}", about, time))
    off = len(found) if plan.hold_off else -1
    if plan.hold_off:
        about = f"How long symbol {plan.safe} is in force after the start, whatever the state"
        found.append((HOLD_OFF, about, plan.hold_off))
    texts, about_all, times = zip(*found)
    none = len(found)
    return Times(
        texts,
        about_all,
        tuple(to_seconds(time, policy.time_unit) for time in times),
        tuple(none if k < 0 else k for k in labels),
        tuple(none if k < 0 else k for k in inputs),
        none if off < 0 else off,
    )


def variable_names(plan: Plan) -> tuple[str, ...]:
    """Return the names of the variables of states, inputs, and times."""
    policy, times = plan.policy, times_of(plan)
    fixed = {"min_dwell", HOLD_OFF} if plan.hold_off else {"min_dwell"}
    own = [text for text in times.texts if text not in fixed]
    others = [*policy.space.names, *policy.alphabet.inputs]
    reserved = [*KEYWORDS, *OWN, *([HOLD_OFF] if plan.hold_off else [])]
    names = identifiers([*others, *own], reserved)
    made = iter(names[len(others) :])
    return (
        *names[: len(others)],
        *(text if text in fixed else next(made) for text in times.texts),
    )
