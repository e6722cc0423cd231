"""Programs: straight-line lists of elementary operations, as plain data.

A program is what a model becomes once CasADi has done its work. It is evaluated with NumPy,
emitted as C, kept in policy files, and never executed as Python.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import PolicyFormatError
from capsyn.programs.operations import OPERATIONS

MAX_INSTRUCTIONS = 1_000_000
"""Most instructions that a program read from a file may have."""
Instruction = tuple[Any, ...]
Ports = tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Program:
    """A straight-line program.

    Values are numbered: first the components of all inputs, then one per instruction. These are
    ``("const", number)`` or ``(operation, operand, ..)`` with operands that are earlier values.
    """

    name: str  # what the program computes
    inputs: Ports  # names and sizes of the vectors that go in
    outputs: Ports
    instructions: tuple[Instruction, ...]
    results: tuple[int, ...]  # the values that make the outputs, one after the other

    @property
    def input_count(self) -> int:
        """Number of input components."""
        return sum(size for _, size in self.inputs)

    @property
    def first(self) -> Program:
        """The program of its first output alone."""
        size = self.outputs[0][1]
        return Program(
            self.name, self.inputs, self.outputs[:1], self.instructions, self.results[:size]
        )

    @functools.cached_property
    def _dying(self) -> list[list[int]]:
        """For each instruction the computed values that nobody needs after it."""
        first = self.input_count
        last: dict[int, int] = {}
        for i, (name, *operands) in enumerate(self.instructions):
            if name != "const":
                last.update(dict.fromkeys(operands, i))
        dying: list[list[int]] = [[] for _ in self.instructions]
        kept = set(self.results)
        for value, i in last.items():
            if value >= first and value not in kept:
                dying[i].append(value)
        return dying

    def used_inputs(self) -> set[int]:
        """Return the numbers of the input components that instructions or results use."""
        used = set(self.results)
        for name, *operands in self.instructions:
            if name != "const":
                used.update(operands)
        return {k for k in used if k < self.input_count}

    def evaluate(self, *inputs: Any, dtype: Any = np.float64) -> list[np.ndarray]:
        """Return the outputs (size, ...) for inputs (size, ...), in the arithmetic of a type.

        The axes after the first are broadcast against each other. Invalid operations give NaN or
        infinity, never a warning.
        """
        dtype = np.dtype(dtype).type
        values: list[Any] = []
        for (name, size), data in zip(self.inputs, inputs, strict=True):
            with np.errstate(over="ignore"):
                array = np.asarray(data, dtype)
            if array.shape[:1] != (size,):
                raise ValueError(f"`{name}` must have shape ({size}, ...); got {array.shape}")
            values += [array[k] for k in range(size)]
        shape = np.broadcast_shapes(*(np.shape(v) for v in values))
        buffers: list[np.ndarray] = []
        with np.errstate(all="ignore"):
            for i, (name, *operands) in enumerate(self.instructions):
                if name == "const":
                    values.append(dtype(operands[0]))
                    continue
                arguments = [values[k] for k in operands]
                if all(np.ndim(a) == 0 for a in arguments):
                    values.append(dtype(OPERATIONS[name].numpy(*arguments)))
                else:
                    out = buffers.pop() if buffers else np.empty(shape, dtype)
                    values.append(OPERATIONS[name].numpy(*arguments, out=out))
                for k in self._dying[i]:
                    if np.ndim(values[k]):
                        buffers.append(values[k])
                    values[k] = None
        outputs, start = [], 0
        for _, size in self.outputs:
            rows = np.empty((size, *shape), dtype)
            for k in range(size):
                rows[k] = values[self.results[start + k]]
            outputs.append(rows)
            start += size
        return outputs

    def to_c(self, function: str, uniform: Sequence[str] = ()) -> str:
        """Return a C function that runs the program on ``LANES`` states at once.

        The function takes one pointer per input, ``const real (*)[LANES]``, or ``const real *``
        for the `uniform` inputs that all lanes share, then one per output. The text names the
        types and functions that `capsyn.native` declares before it.
        """
        parameters = [
            f"const real *restrict {name}"
            if name in uniform
            else f"const real (*restrict {name})[LANES]"
            for name, _ in self.inputs
        ] + [f"real (*restrict {name})[LANES]" for name, _ in self.outputs]
        body = []
        names = [
            f"{name}[{k}]" if name in uniform else f"{name}[{k}][lane]"
            for name, size in self.inputs
            for k in range(size)
        ]
        for name, *operands in self.instructions:
            value = f"v{len(names)}"
            if name == "const":
                text = c_number(operands[0])
            else:
                text = OPERATIONS[name].c.format(*(names[k] for k in operands))
            body.append(f"        const real {value} = {text};")
            names.append(value)
        targets = [f"{name}[{k}][lane]" for name, size in self.outputs for k in range(size)]
        body += [f"        {t} = {names[k]};" for t, k in zip(targets, self.results)]
        lines = [
            f"static void {function}({', '.join(parameters)})",
            "{",
            "    EACH_LANE {",
            *body,
            "    }",
            "}",
        ]
        return "\n".join(lines) + "\n"

    def to_json(self) -> dict[str, Any]:
        """Return the program as plain data."""
        return {
            "name": self.name,
            "inputs": [list(port) for port in self.inputs],
            "outputs": [list(port) for port in self.outputs],
            "instructions": [
                ["const", _number_to_json(operands[0])] if name == "const" else [name, *operands]
                for name, *operands in self.instructions
            ],
            "results": list(self.results),
        }

    @staticmethod
    def from_json(data: Any) -> Program:
        """Return the program that `to_json` described; `PolicyFormatError` for anything else."""
        try:
            name = data["name"]
            inputs, outputs = (_ports(data[key]) for key in ("inputs", "outputs"))
            rows, results = data["instructions"], tuple(data["results"])
            if not isinstance(name, str) or not isinstance(rows, list):
                raise ValueError("name or instructions")
            if len(rows) > MAX_INSTRUCTIONS:
                raise ValueError(f"{len(rows)} instructions")
            known = sum(size for _, size in inputs)
            instructions = []
            for row in rows:
                instructions.append(_instruction(row, known))
                known += 1
            if len(results) != sum(size for _, size in outputs) or not all(
                type(k) is int and 0 <= k < known for k in results
            ):
                raise ValueError("results")
        except (TypeError, KeyError, ValueError, IndexError, OverflowError) as error:
            raise PolicyFormatError(f"a program in the file is malformed: {error}") from None
        return Program(name, inputs, outputs, tuple(instructions), results)


def _ports(data: Any) -> Ports:
    ports = tuple((name, size) for name, size in data)
    for name, size in ports:
        if not isinstance(name, str) or not name.isidentifier() or not name.isascii():
            raise ValueError(f"port name {name!r}"[:80])
        if type(size) is not int or not 0 < size <= 10_000:
            raise ValueError(f"port size {size!r}"[:80])
    return ports


def _instruction(row: Any, known: int) -> Instruction:
    name, *operands = row
    if name == "const":
        (number,) = operands
        if isinstance(number, str):
            if number not in ("inf", "-inf"):
                raise ValueError(f"constant {number!r}"[:80])
        elif isinstance(number, bool) or not isinstance(number, (int, float)):
            raise ValueError("constant")
        value = float(number)
        if math.isnan(value):
            raise ValueError("constant NaN")
        return ("const", value)
    if name not in OPERATIONS:
        raise ValueError(f"unknown operation {name!r}"[:80])
    if len(operands) != OPERATIONS[name].arity or not all(
        type(k) is int and 0 <= k < known for k in operands
    ):
        raise ValueError(f"operands of {name!r}")
    return (name, *operands)


def _number_to_json(number: float) -> float | str:
    return number if math.isfinite(number) else ("inf" if number > 0 else "-inf")


def c_number(number: float) -> str:
    """Return an exact C literal of type ``real``."""
    if math.isinf(number):
        return "(real)INFINITY" if number > 0 else "(real)-INFINITY"
    return f"(real){number.hex()}"


def is_affine(program: Program, name: str) -> bool:
    """Return whether the results are affine in one input, as far as their operations show."""
    degrees: list[float] = []
    for port, size in program.inputs:
        degrees += [1.0 if port == name else 0.0] * size
    for operation, *operands in program.instructions:
        of = [] if operation == "const" else [degrees[k] for k in operands]
        if operation in ("add", "sub", "neg"):
            degrees.append(max(of))
        elif operation == "mul":
            degrees.append(sum(of))
        elif operation in ("div", "select"):  # affine in the numerator, in what is selected
            fixed, free = (of[1], of[0]) if operation == "div" else of
            degrees.append(math.inf if fixed else free)
        else:
            degrees.append(math.inf if any(of) else 0.0)
    return all(degrees[k] <= 1 for k in program.results)
