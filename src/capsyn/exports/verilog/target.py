"""Synthesizable Verilog-2005: a module for an FPGA, with a test bench that checks itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from capsyn.compression.trees import WAYS_OUT
from capsyn.errors import ProblemError
from capsyn.exports.golden import Golden
from capsyn.exports.plan import MOST_NODES, Plan, tree_within
from capsyn.exports.target import Exported, Target
from capsyn.exports.verilog.bench import bench, sequence_bench
from capsyn.exports.verilog.memory import shell
from capsyn.exports.verilog.module import Module
from capsyn.exports.verilog.ports import Port, fixed_port
from capsyn.exports.verilog.source import source
from capsyn.validation import describe, finite_number, one_of, whole_number


@dataclass(frozen=True)
class Options:
    """Options of target ``verilog``.

    Parameters
    ----------
    inputs : "lattice" or "fixed"
        Lattice steps, unsigned, of states in the domain; or readings in signed fixed point.
    pipeline : bool or int
        Stages that the tree is cut into, with registers between them; True for 4 levels a stage.
        A new state is taken at every clock. Default: a circuit without a clock, unless there is a
        minimum dwell time.
    bits, fraction : int, or one a state and exogenous input, optional
        Of fixed-point ports: width, and bits behind the point. Default: a lattice step is 64 units
        of the last place or more, and there is room beyond the bounds.
    clock_hz : float
        Default of the parameter ``CLOCK_HZ``, which the minimum dwell time is counted with.
    name : str, optional
        Name of the module. Default: that of the policy.
    """

    inputs: str = "lattice"
    pipeline: bool | int = False
    bits: int | Sequence[int | None] | None = None
    fraction: int | Sequence[int | None] | None = None
    clock_hz: float = 50e6
    name: str | None = None

    def ports(self, plan: Plan) -> tuple[Port, ...] | None:
        """Return the fixed-point ports; None for inputs lattice."""
        if self.inputs == "fixed":
            bits = _per_state("bits", self.bits, plan.n, 2)
            fraction = _per_state("fraction", self.fraction, plan.n, 0)
            return tuple(map(fixed_port, [plan] * plan.n, range(plan.n), bits, fraction))
        if self.bits is not None or self.fraction is not None:
            raise ProblemError("`bits` and `fraction` must be given for inputs fixed only")
        return None


def _per_state(name: str, value: object, n: int, least: int) -> tuple[int | None, ...]:
    values = list(value) if isinstance(value, (list, tuple)) else [value] * n
    if len(values) != n:
        raise ProblemError(f"`{name}` must be one number or {n}; got {describe(value)}")
    return tuple(None if v is None else whole_number(name, v, least=least, most=64) for v in values)


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return a module, its test bench and the golden vectors that this reads.

    Of a plan that remembers, the test bench is that of a module beside it, which tells what follows
    a symbol in force; there is one more, with sequences, of the module itself.
    """
    one_of("inputs", options.inputs, ["lattice", "fixed"])
    if plan.policy.cells.priced:
        raise ProblemError(
            "target verilog writes trees alone, and affine leaves with prices on switching have "
            "none: compress in mode linear, or take constant leaves"
        )
    ports = options.ports(plan)
    clock = math.ceil(finite_number("clock_hz", options.clock_hz, above=0.0))
    if tree_within(plan.source, MOST_NODES) is None:
        raise ProblemError(
            "target verilog writes trees alone, and that of this policy with affine leaves has "
            f"more than {MOST_NODES:,} nodes: {WAYS_OUT}"
        )
    plan = plan.written(as_cells=False)
    module = Module.of(plan, ports, options.pipeline, clock, options.name)
    test_bench, vectors, about, at_ports = bench(module, golden)
    files = {
        f"{module.core}.v": _joined(source(module, about)),
        f"{module.name}_tb.v": test_bench,
        f"{module.name}.mem": vectors,
    }
    sequence = None
    if module.has_state:
        test_bench, vectors, about, sequence = sequence_bench(module)
        files = {f"{module.name}.v": _joined(shell(module, about)), **files}
        files[f"{module.name}_sequence_tb.v"] = test_bench
        files[f"{module.name}_sequence.mem"] = vectors
    return Exported(
        files,
        module.renamed,
        changed=module.changed,
        golden=at_ports,
        plan=plan,
        sequence=sequence,
    )


def _joined(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode("ascii")


TARGET = Target(export, Options, cells=False, remembers=True)
