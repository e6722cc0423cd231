"""IEC 61131-3 Structured Text: a function block for a PLC."""

from __future__ import annotations

from dataclasses import dataclass

from capsyn.cells.cell_tree import CellTree
from capsyn.errors import ProblemError
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
    style : "nested", "table" or "cells", optional
        The tree as IF statements in functions, or as arrays that a loop walks through; or the
        cells of the policy, with the rows of affine leaves. Default: cells of affine leaves, else
        nested.
    name : str, optional
        Name of the block. Default: that of the policy.
    """

    style: str | None = None
    name: str | None = None


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a function block and the functions that it calls, as one file.

    The inputs are readings in LREAL, the outputs the symbol, the status (0 in the domain, 1
    outside, 2 not finite) and the controls. With a minimum dwell time there is one more input
    ``cycle``, the seconds since the call before.
    """
    style = options.style or ("cells" if plan.as_cells else "nested")
    one_of("style", style, ["nested", "table", "cells"])
    if style == "cells" and not isinstance(plan.policy.cells, CellTree):
        raise ProblemError(f"`style` cells is for policies of cells; got {plan.policy!r}")
    plan = plan.written(style == "cells")
    block = Block.of(plan, style, options.name)
    text = "\n".join(_lines(block)) + "\n"
    files = {f"{block.name}.st": text.encode("ascii")}
    return Exported(files, block.renamed, notes(block), plan=plan, chosen={"style": style})


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
