"""IEC 61131-3 Structured Text: a function block for a PLC."""

from __future__ import annotations

from dataclasses import dataclass

from capsyn.exports.golden import Golden
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text.block import Block
from capsyn.exports.structured_text.functions import step, tree_functions, wrap
from capsyn.exports.structured_text.lines import comment
from capsyn.exports.structured_text.source import body, declarations, notes
from capsyn.exports.target import Exported, Target
from capsyn.validation import one_of


@dataclass(frozen=True)
class Options:
    """Options of target ``structured-text``.

    Parameters
    ----------
    style : "nested" or "table"
        The tree as IF statements in functions, or as arrays that a loop walks through.
    name : str, optional
        Name of the block. Default: that of the policy.
    """

    style: str = "nested"
    name: str | None = None


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a function block and the functions that it calls, as one file.

    The inputs are readings in LREAL, the outputs the symbol, the status (0 in the domain, 1
    outside, 2 not finite) and the controls. With a minimum dwell time there is one more input
    ``cycle``, the seconds since the call before.
    """
    one_of("style", options.style, ["nested", "table"])
    block = Block.of(plan, options.style, options.name)
    text = "\n".join(_lines(block)) + "\n"
    return Exported({f"{block.name}.st": text.encode("ascii")}, block.renamed, notes(block))


def _lines(block: Block) -> list[str]:
    """Return the lines of the file: each function after those that it calls, then the block."""
    lines = list(comment(block.plan.header))
    if block.renamed:
        lines += comment(f"Renamed: {old!r} is {new}" for old, new in block.renamed.items())
    if any(block.plan.policy.domain.periodic):
        lines += ["", *wrap(block)]
    lines += ["", *step(block)]
    if not block.table:
        lines += tree_functions(block)
    return [*lines, "", *declarations(block), *body(block), "END_FUNCTION_BLOCK"]


TARGET = Target(export, Options)
