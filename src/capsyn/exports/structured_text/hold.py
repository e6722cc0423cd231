"""The least time between switches: a TIME that runs down."""

from __future__ import annotations

import math
from decimal import Decimal

from capsyn.errors import ProblemError
from capsyn.exports.plan import NOT_FINITE, Plan
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.lines import comment, condition, indented, time

MOST = (1 << 31) - 1
"""Largest TIME of all tools [ms]: those that count milliseconds have 32 bits."""


def least(plan: Plan) -> tuple[int, bool]:
    """Return the least time in whole milliseconds, and whether it had to be rounded up."""
    exact = Decimal(f"{plan.dwell_s:.12g}") * 1000  # 0.1 * 3 is 0.3
    if exact > MOST:
        raise ProblemError(
            f"`dwell` must be at most {MOST / 1000} s in TIME; got {plan.dwell_s!r} s"
        )
    return math.ceil(exact), exact != math.ceil(exact)


def hold(block: Block, siemens: bool) -> list[str]:
    """Return the rule of the closed loop for the minimum dwell time."""
    plan = block.plan
    shortest, rounded = least(plan)
    dwell, zero = time(shortest), time(0)
    about = [f"A control is held for {dwell} at least{', rounded up' * rounded}."]
    at_once = {code for code in plan.at_once if not (code == NOT_FINITE and block.axes)}
    now = [f"(status = {code})" for code in sorted(at_once)]
    if now:
        codes = " and ".join(map(str, sorted(at_once)))
        about.append(f"The symbol of status {codes} does not wait.")
    lines = ["IF cycle > T#0ms THEN", "    IF rest > cycle THEN"]
    lines += ["        rest := rest - cycle;", "    ELSE", f"        rest := {zero};"]
    lines += ["    END_IF;", "END_IF;"]
    if not siemens:
        lines += comment(["Where TIME is finer, less than half a millisecond is rounding."])
        lines += ["IF rest < T#1ms THEN", "    IF (rest + rest) < T#1ms THEN"]
        lines += [f"        rest := {zero};", "    END_IF;", "END_IF;"]
    if plan.same_control:
        pairs = (f"((wanted = {k}) AND (symbol = {j}))" for k, j in plan.same_control)
        lines += [*condition("IF (", pairs, ") THEN", "OR"), "    symbol := wanted;", "END_IF;"]
    free = " OR ".join([f"(rest <= {zero})", *now])
    free = f"({free})" if now else free
    lines += [f"IF (wanted <> symbol) AND {free} THEN", "    symbol := wanted;"]
    lines += [f"    rest := {dwell};", "END_IF;"]
    return [
        *comment([" ".join(about)]),
        "IF NOT started THEN",
        *indented(["started := TRUE;", "symbol := wanted;", f"rest := {dwell};"]),
        "ELSE",
        *indented(lines),
        "END_IF;",
    ]
