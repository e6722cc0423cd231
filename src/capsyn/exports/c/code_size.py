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
    """Bytes of flash of a decision as C, style table: code and tables from lattice steps on.

    That is ``decision`` of what an export says is measured; what makes steps of readings, which is
    the same for all trees of a policy, is not counted.

    Parameters
    ----------
    processor : "cortex-m0", "cortex-m4", "avr" or "host"
        Whose compiler measures.

    Raises
    ------
    ProblemError
        Another processor, or one whose compiler is not here.
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
        """What is counted."""
        return f"bytes of C on {self.processor}"

    def __call__(self, policy: Policy) -> int:
        """Return the bytes of a `policy`; `ProblemError` where the compiler fails for it."""
        code = Code.of(Plan.of(policy), "table", "lattice", "real", "tree", 1e-6)
        texts = {f"{code.prefix}.h": header(code), f"{code.prefix}.c": source(code)}
        files = {name: text.encode() for name, text in texts.items()}
        measured = sizes(files, code.prefix, [self.processor])
        if self.processor not in measured:
            raise ProblemError(f"`target` {self.processor} has a compiler that fails for this tree")
        return int(measured[self.processor]["decision"])
