"""Target ``python``: one module that needs nothing but the standard library."""

from __future__ import annotations

import keyword
import sys
import textwrap
from collections.abc import Sequence
from typing import Any

from capsyn.exports.constants import constants, tables
from capsyn.exports.feature_texts import features_of, python_ranks
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name
from capsyn.exports.plan import Plan
from capsyn.exports.target import Exported, NameOption, Target

KEYWORDS = {*keyword.kwlist, *keyword.softkwlist, *sys.stdlib_module_names}
"""Names that the module cannot have, or that would hide another."""

CODE = '''

def quantise(state):
    """Return the lattice steps of a state of finite numbers; beyond the bounds the nearest."""
    steps = []
    for x, low, high, periodic, count in zip(state, LOWER, UPPER, PERIODIC, COUNTS):
        width = high - low
        if periodic and not low <= x < high:
            rest = math.fmod(x - low, width)
            if rest < 0:
                rest += width
            rest += low
            x = low if rest >= high else rest
        x = min(max(x, low), high)
        k = int(min((x - low) * (count / width), count - 1))
        if x < low + width * (k / count):
            k -= 1
        if k + 1 < count and x >= low + width * ((k + 1) / count):
            k += 1
        steps.append(k)
    return steps


def decide(state):
    """Return (symbol, status) of a state: an index into CONTROLS, and OK, OUTSIDE or NOT_FINITE."""
    if len(state) != len(LOWER):
        raise ValueError("a state is {} numbers".format(len(LOWER)))
    x = [float(v) * scale + offset for v, scale, offset in zip(state, SCALE, OFFSET)]
    if not all(map(math.isfinite, x)):
        return SAFE, NOT_FINITE
    inside = all(
        periodic or low <= v <= high for v, low, high, periodic in zip(x, LOWER, UPPER, PERIODIC)
    )
    if not inside and not NEAREST:
        return SAFE, OUTSIDE
    z = quantise(x)
    i = 0
    while SPLIT[i] >= 0:
        if SPLIT[i] < len(z):
            value = z[SPLIT[i]]
        else:
            value = sum(a * b for a, b in zip(PLANES[SPLIT[i] - len(z)], z))
        i = SECOND[i] if value >= THRESHOLD[i] else i + 1
    if THRESHOLD[i] == GAP:
        return SAFE, OUTSIDE
    return THRESHOLD[i], OK if inside else OUTSIDE


def control(state):
    """Return the control vector of a state [input units]."""
    return CONTROLS[decide(state)[0]]


class Controller:
    """The policy with a least time between switches, MIN_DWELL by default [s]."""

    def __init__(self, min_dwell=MIN_DWELL):
        self.min_dwell = float(min_dwell)
        self.reset()

    def reset(self):
        """Forget what is held: the next step takes its symbol at once."""
        self.symbol = None
        self.since = 0.0

    def step(self, state, time):
        """Return (symbol, status) at a time [s]; a control is held for MIN_DWELL before another.

        Times do not decrease; a millionth of the dwell time is allowed for their rounding.
        """
        symbol, status = decide(state)
        if self.symbol is None:
            self.symbol, self.since = symbol, time
        elif CONTROLS[symbol] == CONTROLS[self.symbol]:
            self.symbol = symbol
        elif time - self.since >= self.min_dwell * (1 - 1e-6):
            self.symbol, self.since = symbol, time
        return self.symbol, status

    def control(self):
        """Return the control vector that is held [input units]; the default before any step."""
        return CONTROLS[DEFAULT if self.symbol is None else self.symbol]
'''


def export(plan: Plan, golden: Golden, options: NameOption) -> Exported:
    """Return a module of Python 3.8 or later."""
    lines = ["# -*- coding: utf-8 -*-", *(f"# {line}" for line in plan.header)]
    title = f"Control alphabet policy {plan.policy.name}: states to symbols."
    lines += [repr(title), "", "import math", ""]
    for constant, value, note in constants(plan) + tables(plan):
        lines += [f"# {note}"] * bool(note)
        whole = isinstance(value, (list, tuple))
        lines.append(_tuple(constant, value) if whole else f"{constant} = {value!r}")
    code, features = CODE, features_of(plan.tree.cells)
    if features:
        code = python_ranks(features) + code.replace("quantise(x)", "with_ranks(quantise(x))")
    file = f"{file_name(options.name, plan.policy.name, KEYWORDS)}.py"
    return Exported({file: ("\n".join(lines) + code).encode()})


def _tuple(name: str, values: Sequence[Any]) -> str:
    """Return an assignment of a tuple, in lines that are short where items are."""
    items = [repr(tuple(v) if isinstance(v, list) else v) for v in values]
    line = f"{name} = ({', '.join(items)}{',' * (len(items) == 1)})"
    if len(line) <= 100:
        return line
    if all(isinstance(v, int) for v in values):
        items = textwrap.wrap(", ".join(items), 95)
        return "\n    ".join([f"{name} = (", *items]) + ",\n)"
    return "\n    ".join([f"{name} = (", *(f"{item}," for item in items)]) + "\n)"


TARGET = Target(export, features=True)
