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
from capsyn.exports.text import spoken

KEYWORDS = {*keyword.kwlist, *keyword.softkwlist, *sys.stdlib_module_names}
"""Names that the module cannot have, or that would hide another."""

QUANTISE = '''

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
'''
DECIDE = '''

def decide(state):
    """Return (symbol, status) of a state: an index into CONTROLS, and OK, OUTSIDE or NOT_FINITE."""
'''
NEXT = '''

def next_symbol(in_force, state):
    """Return (symbol, status): what follows a symbol in force at a state, DEFAULT at first.

    They are an index into CONTROLS, as that in force is, and OK, OUTSIDE or NOT_FINITE.
    """
    if not 0 <= in_force <= DEFAULT:
        raise ValueError("a symbol in force is 0 to {}".format(DEFAULT))
'''
STEPS = """\
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
"""
WALK = """\
    i = 0
    while SPLIT[i] >= 0:
        if SPLIT[i] < len(z):
            value = z[SPLIT[i]]
        else:
            value = sum(a * b for a, b in zip(PLANES[SPLIT[i] - len(z)], z))
        i = SECOND[i] if value >= THRESHOLD[i] else i + 1
"""
"""Through the nodes of a tree."""
LABEL = """\
    if THRESHOLD[i] == GAP:
        return SAFE, OUTSIDE
    return THRESHOLD[i], OK if inside else OUTSIDE
"""
SYMBOL = """\
    if symbol == GAP:
        return SAFE, OUTSIDE
    return symbol, OK if inside else OUTSIDE
"""
CONTROL = '''

def control(state):
    """Return the control vector of a state [input units]."""
    return CONTROLS[decide(state)[0]]
'''
SAME_FOR_ALL = '''

def next_symbol(in_force, state):
    """Return `decide` of a state: here the symbol in force does not matter."""
    return decide(state)
'''
CONTROLLER = '''

class Controller:
    """The policy with a least time between switches, MIN_DWELL by default [time unit]."""

    def __init__(self, min_dwell=MIN_DWELL):
        self.min_dwell = float(min_dwell)
        self.reset()

    def reset(self):
        """Forget what is held: the next step takes its symbol at once."""
        self.symbol = None
        self.since = 0.0

    def step(self, state, time):
        """Return (symbol, status) at a time [time unit]; a control is held before another is taken.

        Times do not decrease; a millionth of the dwell time is allowed for their rounding. The
        symbol of a state whose status is in AT_ONCE does not wait, and is held anew.
        """
        symbol, status = decide(state)
        if self.symbol is None:
            self.symbol, self.since = symbol, time
        elif CONTROLS[symbol] == CONTROLS[self.symbol]:
            self.symbol = symbol
        elif status in AT_ONCE or time - self.since >= self.min_dwell * (1 - 1e-6):
            self.symbol, self.since = symbol, time
        return self.symbol, status
'''
REMEMBERING = '''

class Controller:
    """The symbol in force from step to step, and what its change waits for [time unit].

    A symbol is held once it is entered, an input once it has changed, and SAFE is in force for the
    time `hold_off` after the first step.
    """

    def __init__(self, holds=HOLDS, input_holds=INPUT_HOLDS, hold_off=HOLD_OFF):
        self.holds, self.input_holds, self.hold_off = holds, input_holds, hold_off
        self.reset()

    def reset(self):
        """Forget what is in force: the next step is the first."""
        self.symbol = None
        self.start = self.since = 0.0
        self.changes = [0.0] * len(INPUTS)

    def step(self, state, TIME):
        """Return (symbol, status) at a time [time unit]: the symbol in force, the state's status.

        Times do not decrease; a millionth of each least time is allowed for their rounding. The
        symbol of a state whose status is in AT_ONCE does not wait, and is held anew.
        """
        first = self.symbol is None
        now = DEFAULT if first else self.symbol
        symbol, status = next_symbol(now, state)
        if first:
            self.start = time
        if time - self.start < self.hold_off * (1 - 1e-6):
            symbol = SAFE
        if not first and status not in AT_ONCE and KINDS[symbol] != KINDS[now]:
            symbol = self._permitted(symbol, time)
        if first or KINDS[symbol] != KINDS[now]:
            self.since = time
        for i, (old, new) in enumerate(zip(CONTROLS[now], CONTROLS[symbol])):
            if first or old != new:
                self.changes[i] = time
        self.symbol = symbol
        return symbol, status

    def _permitted(self, wanted, time):
        """Return what is taken where another symbol than that in force is wanted.

        Inputs whose time is not over keep their values, if a symbol that may follow has these;
        where no other is left to change, the symbol in force stays.
        """
        now = self.symbol
        if time - self.since < self.holds[now] * (1 - 1e-6):
            return now
        kept = [time - t < h * (1 - 1e-6) for t, h in zip(self.changes, self.input_holds)]
        mixed = tuple(CONTROLS[now if k else wanted][i] for i, k in enumerate(kept))
        if mixed == CONTROLS[wanted]:
            return wanted
        if mixed == CONTROLS[now]:
            return now
        for symbol in range(DEFAULT):
            if CONTROLS[symbol] == mixed and (now, symbol) not in FORBIDDEN:
                return symbol
        return now
'''
HELD = '''
    def control(self):
        """Return the control vector that is held [input units]; the default before any step."""
        return CONTROLS[DEFAULT if self.symbol is None else self.symbol]
'''
LEAF = '''

def leaf(z):
    """Return the number of the leaf that holds lattice steps."""
    at, sizes = 0, list(ROOT_SIZES)
    for k, size, parts in zip(z, sizes, PARTITIONS):
        at = at * parts + k // size
    while ENTRIES[at] >= 0:
        child = 0
        for i, parts in enumerate(REFINEMENT):
            if not SPLITS or SPLITS[at] >> i & 1:
                sizes[i] //= parts
                child = child * parts + z[i] // sizes[i] % parts
        at = ENTRIES[at] + child
    return -1 - ENTRIES[at]
'''
LARGEST = '''

def largest(leaf, z):
    """Return the symbol of a leaf at lattice steps: of equal rows that of the first."""
    if leaf <= DEFAULT:
        return leaf
    place = leaf - DEFAULT - 1
    best, most = 0, -math.inf
    for row in range(ROW_STARTS[place], ROW_STARTS[place + 1]):
        slopes = ROW_SLOPES[row * len(z) : (row + 1) * len(z)]
        value = ROW_CONSTANTS[row] + sum(a * b for a, b in zip(slopes, z))
        if value > most:
            best, most = ROW_SYMBOLS[row], value
    return best
'''
FOLLOWING = '''

def following(leaf, z, in_force):
    """Return the symbol that follows that in force in a leaf at lattice steps.

    A row counts less by the price of its symbol. Of equals that in force comes first.
    """
    if leaf < len(TRANSITIONS):
        return TRANSITIONS[leaf][in_force]
    place = leaf - len(TRANSITIONS)
    best, most = in_force, -math.inf
    for row in range(ROW_STARTS[place], ROW_STARTS[place + 1]):
        ratio = ROW_RATIOS[in_force * (DEFAULT + 1) + ROW_SYMBOLS[row]]
        slopes = ROW_SLOPES[row * len(z) : (row + 1) * len(z)]
        value = ROW_CONSTANTS[row] + sum(a * b for a, b in zip(slopes, z))
        value -= ROW_PRICES[place] * ratio
        if ratio >= 0 and (value > most or value == most and ROW_SYMBOLS[row] == in_force):
            best, most = ROW_SYMBOLS[row], value
    return best
'''
"""Functions of the module, and parts of them."""


def export(plan: Plan, golden: Golden, options: NameOption) -> Exported:
    """Return a module of Python 3.8 or later."""
    lines = ["# -*- coding: utf-8 -*-", *(f"# {line}" for line in plan.header)]
    title = f"Control alphabet policy {plan.policy.name}: "
    title += spoken(plan.policy, "states to symbols.")
    lines += [repr(title), "", "import math", ""]
    for constant, value, note in constants(plan) + tables(plan):
        lines += [f"# {note}"] * bool(note)
        whole = isinstance(value, (list, tuple))
        lines.append(_tuple(constant, value) if whole else f"{constant} = {value!r}")
    file = f"{file_name(options.name, plan.policy.name, KEYWORDS)}.py"
    code = spoken(plan.policy, _code(plan)).replace("[time unit]", f"[{plan.policy.time_unit}]")
    if features := features_of(plan.cells):
        code = python_ranks(features) + code.replace("quantise(x)", "with_ranks(quantise(x))")
    return Exported({file: ("\n".join(lines) + code).encode()})


def _code(plan: Plan) -> str:
    """Return the functions."""
    remembers = plan.policy.remembers
    if plan.as_cells:
        found = "following(leaf(z), z, in_force)" if remembers else "largest(leaf(z), z)"
        cells, walk = (
            LEAF + (FOLLOWING if remembers else LARGEST),
            f"    symbol = {found}\n{SYMBOL}",
        )
    elif remembers:
        cells, walk = "", f"{WALK}    symbol = TRANSITIONS[THRESHOLD[i]][in_force]\n{SYMBOL}"
    else:
        cells, walk = "", WALK + LABEL
    decision = NEXT + STEPS + walk if remembers else DECIDE + STEPS + walk + CONTROL
    if not plan.has_state:
        return cells + QUANTISE + decision + CONTROLLER + HELD
    time = "time" if plan.waits else "time=0.0"
    controller = REMEMBERING.replace("TIME", time)
    return cells + QUANTISE + decision + SAME_FOR_ALL * (not remembers) + controller + HELD


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


TARGET = Target(export, features=True, remembers=True)
