"""Dynamics and costs of a model as MathML, which browsers draw without any script.

The MathML is written from the programs themselves: they are already trees of known operations, and
every name goes through one function that escapes it. LaTeX in between would have to be escaped and
parsed again.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from capsyn.explorer.expression import Node, combine, condition, fold, number, size_of
from capsyn.explorer.mathml import equation, integral, rate, render, row, symbol, word
from capsyn.policy import Policy
from capsyn.program import Program

LONGEST = 250
"""Most operations of a program that is shown as a formula."""
LARGE = 8
"""Leaves of a formula from which it gets a name of its own where it is used more than once."""


def formulas(policy: Policy) -> dict[str, list[str]]:
    """Return what a policy's model says, as ``<math>`` elements by topic.

    The topics are ``dynamics``, ``cost``, and ``target`` where it is a condition of its own; without
    a model there are none. The equations of a topic come first, then what its abbreviations stand
    for. A program of more than `LONGEST` operations is left out. Names are escaped.
    """
    if policy.model is None:
        return {}
    states, inputs = policy.domain.names, policy.alphabet.inputs
    model = policy.model
    found = {
        "dynamics": _equations(model.dynamics, (*states, *inputs), [rate(name) for name in states]),
        "cost": _cost(model.running_cost, model.terminal_cost, states),
    }
    if isinstance(policy.target, Program):
        found["target"] = _equations(policy.target, states, [None])
    return {topic: lines for topic, lines in found.items() if lines}


def _cost(running: Program, terminal: Program, states: tuple[str, ...]) -> list[str]:
    """Return eq. (3) with the costs that there are, and the costs."""
    parts, lines = [], []
    for name, program, of_time in (
        ("l", running, lambda cost: integral(cost)),
        ("m", terminal, lambda cost: cost),
    ):
        left = row(word(name), "<mo>(</mo>", word("x"), "<mo>)</mo>")
        body = _equations(program, states, [left], name)
        if not body or fold_first(program) == number(0.0):
            continue
        parts.append((name, of_time))
        lines += body
    return ([integral([name for name, _ in parts])] if parts else []) + lines
