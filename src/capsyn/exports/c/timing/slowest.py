"""How long a decision of an export takes at most on emulated processors, and where."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from capsyn.errors import warn
from capsyn.exports.c.code import Code
from capsyn.exports.c.readings.counts import limit_of
from capsyn.exports.c.sizes import version_of
from capsyn.exports.c.timing.emulators import MACHINES, longest
from capsyn.exports.c.timing.states import longest_steps
from capsyn.exports.golden import Golden
from capsyn.exports.plan import NOT_FINITE, Files

SEEN = 1000
"""Golden vectors, and states of the deepest leaves, at which decisions from readings are timed."""

KNOWN = ("table", "nested", "grid", "cells")
"""Styles of which is known what their time depends on."""


def slowest(code: Code, files: Files, golden: Golden) -> dict[str, Any]:
    """Return the longest decisions, by processor; those whose tools are missing are left out.

    Parameters
    ----------
    code : Code
        What was written.
    files : Files
        Header and source.
    golden : Golden
        Vectors of readings as the code takes them.

    Returns
    -------
    dict
        Of each processor ``on`` (chip or board), ``unit`` (cycles or instructions), ``compiler``,
        ``emulator``, and ``symbol``, from lattice steps, and ``decide``, or ``next`` before the
        first decision, from readings, where the code has them there: ``most``, the time of the
        call, with the return; ``at``, its steps or readings; ``symbol``, what it gives; ``of``, how
        many were tried; ``exact``, whether none can take longer. From readings that is never known,
        since the time of arithmetic that a library does depends on the numbers.
    """
    if not any(machine.here for machine in MACHINES.values()):
        pairs = (f"{m.compiler[0]} with {m.emulator[0]}" for m in MACHINES.values())
        warn(f"`cycles` needs {' or '.join(pairs)}; nothing was timed")
    asked = list(_asked(code, golden))
    found: dict[str, Any] = {}
    for name, machine in MACHINES.items():
        if not machine.here:
            continue
        times = {}
        for function, kind, given, exact in asked:
            before = None if code.memory is None else code.plan.default
            most = longest(machine, files, code.prefix, function, kind, given, before)
            if most is not None and _right(code, function, given[most.row], most.symbol):
                times[function] = {
                    "most": most.time,
                    "at": given[most.row].tolist(),
                    "symbol": most.symbol,
                    "of": len(given),
                    "exact": exact,
                }
        if times:
            about = {"on": machine.chip, "unit": machine.unit}
            tools = {"compiler": version_of(machine.compiler[0]), "emulator": machine.emulator[0]}
            found[name] = {**about, **tools, **times}
    return found


def _right(code: Code, function: str, at: np.ndarray, symbol: int) -> bool:
    """Return whether a symbol of steps is the tree's, as it is if no table is out of reach."""
    tree, plan = code.plan.cells, code.plan
    if function != "symbol":
        return True
    within = np.clip(at[None], 0, np.array(tree.counts) - 1)
    transitions = plan.transitions if plan.as_cells else plan.tree.transitions
    return int(transitions[tree.labels(within)[0], plan.default]) == symbol


def _asked(code: Code, golden: Golden) -> Iterator[tuple[str, str, np.ndarray, bool]]:
    """Yield what is called: the function, the type of its inputs, these, and whether they do."""
    plan, memory = code.plan, code.memory
    tree = plan.cells if memory is None else memory.cells
    steps, exact = longest_steps(tree, code.style, memory is not None)
    exact &= memory is None or memory.kept is None
    if code.arithmetic == "lattice":
        yield "symbol", code.integer, steps, exact and code.style in KNOWN
    domain = plan.policy.space
    within = np.clip(steps[:SEEN], 0, np.array(tree.counts) - 1)
    states = domain.lower + (within + 0.5) / tree.counts * domain.widths
    centres = (states - plan.offset) / plan.scale
    finite = golden.readings[golden.statuses != NOT_FINITE]
    readings = np.concatenate([centres, finite[:: -(-len(finite) // SEEN)]])
    if code.axes:
        limit = limit_of(code.readings)
        readings = np.clip(np.rint(readings), -limit, limit - 1).astype(np.int64)
    elif code.real == "float":
        readings = readings.astype(np.float32).astype(np.float64)
    yield code.asked, code.reading, readings, False
