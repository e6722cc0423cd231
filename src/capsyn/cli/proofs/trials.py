"""How trials went, printed."""

from __future__ import annotations

from typing import Any

from capsyn.cli.console import print_line
from capsyn.modelling.time_unit import NAMES
from capsyn.verification.sentences import circumstances, failing_trial


def print_monte_carlo(data: dict[str, Any], headline: str, again: str | None) -> None:
    """Print how trials went, and the command that repeats the first that failed."""
    conditions = data["conditions"]
    unit = conditions.get("time_unit", "s")
    stay = f", and stay there the last {conditions['hold']:g} {unit}" if conditions["hold"] else ""
    print_line("monte carlo", headline)
    print_line("from", conditions["initial"])
    print_line("to", f"{conditions['target']}, within {conditions['within']:g} {unit}{stay}")
    for key in ("avoid", "stay_in"):
        if key in conditions:
            print_line(key.replace("_", " "), conditions[key])
    print_line("by", f"{conditions['controller']}; {circumstances(conditions)}")
    how = {"time": "ran until the time limit", "target": "arrived"}
    ends = (f"{count:,} {how.get(name, name)}" for name, count in data["ended"].items())
    print_line("ended", ", ".join(ends))
    for key, name, what in (
        ("time_to_target", "time", f"{unit} until the target"),
        (f"switches_per_{NAMES[unit]}", "switches", f"per {NAMES[unit]}"),
        ("cost_left", "cost left", "of the cost J at the start"),
    ):
        if data[key]:
            spread = ", ".join(f"{k} {v:.3g}" for k, v in data[key].items())
            print_line(name, f"{spread} {what}")
    for name, figure in data["figures"].items():
        if figure:
            print_line(name, _figure(figure, data["confidence"]))
    for name, figures in data.get("tracking", {}).items():
        for key in ("rms", "bias", "overshoot", "settling"):
            if figures[key]:
                spread = _figure(figures[key], data["confidence"])
                what = f"{name}, {key}" if key == "rms" else key
                print_line("tracking" if key == "rms" else "", f"{what}: {spread}")
        if figures["unsettled"]:
            where = "" if conditions["hold"] else " (without --hold, where they arrive)"
            said = f"{figures['unsettled']:,} trials had not settled when they ended{where}"
            print_line("", said)
        if figures["not_finite"]:
            print_line("", f"{figures['not_finite']:,} trials have no figures: not finite")
    if entered := data.get("trials_entered"):
        print_line("entered", f"{entered:,} trials were where they must not be on the way")
    if outside := data["trials_outside_domain"]:
        print_line("outside", f"{outside:,} trials left the domain on the way")
    trials, failed = data["failing_trials"], data["trials"] - data["successes"]
    for trial in trials[:5]:
        print_line("failed from", failing_trial(trial, unit))
    if failed > 5:
        print_line("", f"and {failed - 5:,} more")
    if again is not None:
        anew = ", but for its noise, which is drawn anew" if any(trials[0]["noise"]) else ""
        print_line("again", f"the first of them{anew}: {again}")


def _figure(figure: dict[str, float], confidence: float) -> str:
    """Return the spread of a figure over trials, with the interval of its mean if there is one."""
    spread = {k: v for k, v in figure.items() if k not in ("low", "high")}
    text = ", ".join(f"{k} {v:.3g}" for k, v in spread.items())
    if "low" not in figure:
        return text
    return (
        f"{text}; mean {figure['low']:.4g} to {figure['high']:.4g} with {confidence:.0%} confidence"
    )
