"""Evidence in sentences."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from typing import Any

DIGITS = 4
"""Digits of a proved figure in a sentence; it is rounded to where it still holds."""


def headlines(evidence: dict[str, Any]) -> dict[str, str]:
    """Return each kind of evidence in one sentence; it may come from a file."""
    return {
        kind.replace("_", " "): sentence(evidence[kind])
        for kind, sentence in _HEADLINES.items()
        if kind in evidence
    }


def _trials(data: dict[str, Any]) -> str:
    return f"{data['successes']:,} of {data['trials']:,} trials succeed {_interval(data)}"


def _proof(data: dict[str, Any]) -> str:
    return (
        f"dV/dt <= 0 proved on {data['proved']:.3%} of the volume (< 0 on "
        f"{data['negative']:.3%}), > 0 on {data['violated']:.3%}, undecided "
        f"{data['undecided']:.3%}, for V = {data.get('function', '?')}"
    ) + _constant(data)


def _constant(data: dict[str, Any]) -> str:
    """Return the exogenous inputs of a proof: for all of them, or part of the volume."""
    told = data.get("exogenous", "")
    if not told:
        return ""
    whole = data["proved"] == 1 and data.get("proved_cells", 0) == data.get("cells")
    return f" and every constant {told}" if whole else f"; the volume is that of states and {told}"


def _agreement(data: dict[str, Any]) -> str:
    mean = ", mean over the symbols in force" if "in_force" in data else ""
    told = f", {data['exogenous']} drawn with them" if data.get("exogenous") else ""
    steps = f", by {data['steps']:,} steps over the horizon" if data.get("steps") else ""
    return f"{data['share']:.3%} of {data['states']:,} states {_interval(data)}{told}{mean}{steps}"


def _optimum(data: dict[str, Any]) -> str:
    starts, lost = data["starts"], data["lost"]
    if data.get("ratio") is None:
        return f"{lost:,} of {starts:,} loops end early: no cost to compare with the least"
    interval = ""
    if data.get("ratio_low") is not None and data.get("ratio_high") is not None:
        interval = (
            f" ({data['ratio_low']:.4g} to {data['ratio_high']:.4g} with "
            f"{data['confidence']:.0%} confidence)"
        )
    bound = "" if data.get("bound", True) else ", which is no bound"
    return (
        f"{data['ratio']:.4g} times the least cost{bound}{interval}, from {starts - lost:,} starts"
    )


def _certificate(data: dict[str, Any]) -> str:
    arrival, staying = data["arrival"], data["staying"]
    conditions = data.get("conditions", {})
    unit = conditions.get("time_unit", "s")
    if arrival == 0:
        said = "no start is proved to arrive"
    else:
        within = _rounded(data["within"], ROUND_CEILING)
        said = f"{proved_share(arrival)} of the starts arrive in the target within {within} {unit}"
        if staying:
            some = " and" if staying == arrival else f" {proved_share(staying)}"
            said += f",{some} then stay in a box"
            said += _ripple(data, unit)
        else:
            said += "; that they stay is not proved"
    if conditions.get("avoid"):
        said += "; until then these do not enter what is to be avoided"
        said += ", nor ever after" if data["avoiding"] else "; that they never do is not proved"
    count = len(data["refuted"])
    more = [f"refuted from {count:,} start{'' if count == 1 else 's'}"] if count else []
    more += [f"open {proved_share(data['open'], ROUND_CEILING)}"] if data["open"] else []
    more += ["stopped before its end"] if data["stopped"] else []
    return "; ".join([said, *more])


def _ripple(data: dict[str, Any], unit: str) -> str:
    """Return where a proved loop stays, and how often it switches there at most."""
    parts = []
    if data.get("ripple") is not None:
        parts.append(f"ripple {', '.join(ripple_texts(data))}")
    if data.get("switch_rate") is not None:
        rate = _rounded(data["switch_rate"], ROUND_CEILING)
        parts.append(f"at most {rate} switches / {unit}")
    return f": {'; '.join(parts)}" if parts else ""


def ripple_texts(data: dict[str, Any]) -> list[str]:
    """Return where each state of a certificate stays, outwards rounded."""
    texts = []
    for name, unit, (low, high) in zip(data["states"], data["units"], data["ripple"], strict=True):
        bounds = f"[{_rounded(low, ROUND_FLOOR)}, {_rounded(high, ROUND_CEILING)}]"
        texts.append(f"{name} in {bounds}" + (f" {unit}" if unit else ""))
    return texts


def _rounded(value: float, rounding: str) -> str:
    """Return a number with `DIGITS` digits, rounded as one says: a bound stays one."""
    return f"{float(Context(DIGITS, rounding).create_decimal(repr(float(value)))):g}"


def proved_share(share: float, rounding: str = ROUND_FLOOR) -> str:
    """Return a proved share, rounded so that it is never said to be more."""
    percent = Decimal(repr(float(share))).scaleb(2).quantize(Decimal("0.001"), rounding)
    return f"{percent.normalize():f}%"


_HEADLINES = {
    "monte_carlo": _trials,
    "lyapunov": _proof,
    "agreement": _agreement,
    "optimum": _optimum,
    "certificate": _certificate,
}


def _interval(data: dict[str, Any]) -> str:
    return f"({data['low']:.3%} to {data['high']:.3%} with {data['confidence']:.0%} confidence)"


def evidence_rows(evidence: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the headlines, and behind some what they were about, without a name."""
    rows: list[tuple[str, str]] = []
    for name, sentence in headlines(evidence).items():
        rows.append((name, sentence))
        conditions = evidence[name.replace(" ", "_")].get("conditions", {})
        if name == "monte carlo":
            units = {"target": "", "within": f" {_short(conditions.get('time_unit', 's'))}"}
        elif name == "certificate":
            units = {"initial": "", "target": "", "avoid": ""}
        else:
            continue
        goal = (f"{k} {_short(conditions[k])}{units[k]}" for k in units if conditions.get(k))
        rows += [("", text) for text in (", ".join(goal), circumstances(conditions)) if text]
    return rows


def circumstances(conditions: dict[str, Any]) -> str:
    """Return what was unusual about trials: all but 0, None and what the policy says itself.

    Another unit of time than s is said with each time.
    """
    usual = set(
        "controller duration within hold target initial avoid stay_in substeps time_unit".split()
    )
    units, parts = {}, []
    if "time_unit" in conditions:
        unit = _short(conditions["time_unit"])
        units = {"rate": f" 1/{unit}", "min_dwell": f" {unit}", "delay": f" {unit}"}
    for name, value in conditions.items():
        if name in usual or not value or value == "its own" or not isinstance(name, str):
            continue
        if isinstance(value, dict) and set(value) == {"low", "high"}:
            value = f"{_short(value['low'])} to {_short(value['high'])}"
        elif isinstance(value, dict) and name == "holds":
            unit = units.get("min_dwell", "")
            value = ", ".join(f"{key} for {_short(time)}{unit}" for key, time in value.items())
        elif isinstance(value, dict) and name == "exogenous":
            value = ", ".join(f"{key} {_signal(one)}" for key, one in value.items())
        elif isinstance(value, dict):
            value = circumstances(value)
        said = "" if value is True else f" {_short(value)}{units.get(name, '')}"
        parts.append(f"{name.replace('_', ' ')}{said}")
    return ", ".join(parts)


def failing_trial(trial: dict[str, Any], time_unit: str) -> str:
    """Return where a failing trial began, and what was drawn for it."""
    parts = [f"{name} {value:.6g}" for name, value in trial["parameters"].items()]
    if "exogenous" in trial:
        told = trial["exogenous"]
        named = told.items() if isinstance(told, dict) else enumerate(told, 1)
        parts = [f"{name} {_steps(value)}" for name, value in named] + parts
    if trial["delay"]:
        parts.append(f"delay {trial['delay']:.6g} {time_unit}")
    parts += [
        f"{name} {vector(trial[name])}" for name in ("disturbance", "noise") if any(trial[name])
    ]
    return vector(trial["initial"]) + (f" with {', '.join(parts)}" if parts else "")


def simulate_line(file: str, trial: dict[str, Any], options: Mapping[str, Any]) -> str:
    """Return the command that repeats a trial of ``capsyn verify``, from `MonteCarlo.trial`.

    `options` are what both commands take in the same way; None and False were not given, a list
    was given once for each of its values.
    """

    def values(numbers: list[float]) -> str:
        return ",".join(map(repr, numbers))

    words = ["capsyn", "simulate", file, "--x0", values(trial["initial"])]
    told = trial.get("exogenous", {})
    for name, value in told.items() if isinstance(told, dict) else ():
        words += ["--exogenous", f"{name}={_steps(value, repr)}"]
    for name, value in trial["parameters"].items():
        words += ["--parameter", f"{name}={value!r}"]
    if trial["delay"]:
        words += ["--delay", repr(trial["delay"])]
    for name in ("disturbance", "noise"):
        if any(trial[name]):
            words += [f"--{name}", values(trial[name])]
    for option, value in options.items():
        for one in value if isinstance(value, list) else [value]:
            if one is not None and one is not False:
                words += [option] if one is True else [option, str(one)]
    return shlex.join(words)


def _signal(value: Any) -> str:
    """Return what an exogenous input does in trials: drawn, steps, or the same."""
    if isinstance(value, dict) and set(value) == {"low", "high"}:
        return f"{_short(value['low'])} to {_short(value['high'])}"
    return _steps(value) if isinstance(value, dict) else _short(value)


def _steps(value: Any, text: Callable[[float], str] = "{:.6g}".format) -> str:
    """Return an exogenous input as text: a number, or steps by their times."""
    if isinstance(value, dict):
        return ",".join(f"{time}:{text(step)}" for time, step in value.items())
    return text(value)


def vector(values: list[float]) -> str:
    """Return numbers in brackets."""
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
