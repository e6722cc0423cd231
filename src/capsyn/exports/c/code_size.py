"""What a tree takes as C on a processor: a measure of `capsyn.compress` with a budget of bytes."""

from __future__ import annotations

import shutil
from dataclasses import dataclass

from capsyn.errors import ProblemError
from capsyn.exports.c.code import Code
from capsyn.exports.c.header import header
from capsyn.exports.c.sizes import COMPILERS, sizes
from capsyn.exports.c.source import source
from capsyn.exports.plan import Plan
from capsyn.policies.policy import Policy
from capsyn.validation import one_of


@dataclass(frozen=True)
class CodeSize:
    """A function that counts the bytes of flash of a decision as C, in style table.

    The count is of code and tables from lattice steps on, which an export reports as ``decision``.
    The code that makes steps of readings is not counted, because all trees of a policy share it.

    Parameters
    ----------
    processor : "cortex-m0", "cortex-m4", "avr" or "host"
        The processor whose compiler measures.

    Raises
    ------
    ProblemError
        An unknown processor, or one whose compiler is not installed.
    """

    processor: str

    def __post_init__(self) -> None:
        one_of("target", self.processor, list(COMPILERS))
        compiler = COMPILERS[self.processor][0]
        if not shutil.which(compiler):
            raise ProblemError(
                f"`target` {self.processor} needs {compiler}, which is not installed: without a "
                "target, bytes are those of the tree's arrays"
            )

    @property
    def name(self) -> str:
        """What the function counts, in words."""
        return f"bytes of C on {self.processor}"

    def __call__(self, policy: Policy) -> int:
        """Return the bytes of a `policy`; `ProblemError` if its compiler fails."""
        code = Code.of(Plan.of(policy), "table", "lattice", "real", "tree", 1e-6)
        texts = {f"{code.prefix}.h": header(code), f"{code.prefix}.c": source(code)}
        files = {name: text.encode() for name, text in texts.items()}
        measured = sizes(files, code.prefix, [self.processor])
        if self.processor not in measured:
            raise ProblemError(f"`target` {self.processor} has a compiler that fails for this tree")
        return int(measured[self.processor]["decision"])
