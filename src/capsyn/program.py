"""Programs: straight-line lists of elementary operations, as plain data.

A program is what a model becomes once CasADi has done its work. It is evaluated with NumPy,
emitted as C, kept in policy files, and never executed as Python.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.errors import PolicyFormatError

MAX_INSTRUCTIONS = 1_000_000
"""Most instructions that a program read from a file may have."""


@dataclass(frozen=True)
class Operation:
    """One elementary operation: its NumPy form ``f(*operands, out=)`` and its C expression.

    `libm` is True where the C expression calls a function of the C library, `boolean` where the
    value is always 0 or 1.
    """

    arity: int
    numpy: Callable[..., Any]
    c: str
    libm: bool = False
    boolean: bool = False


def _select(condition: Any, value: Any, out: np.ndarray | None = None) -> Any:
    result = np.where(np.not_equal(condition, 0), value, 0.0)
    if out is None:
        return result
    out[...] = result
    return out


def _erf(value: Any, out: np.ndarray | None = None) -> Any:
    from scipy.special import erf  # heavy, and few models use it

    return erf(value, out=out)


def _remainder(a: Any, b: Any, out: np.ndarray | None = None) -> Any:
    return np.subtract(a, b * np.rint(a / b), out=out)


def _function(name: str, numpy: Callable[..., Any], arity: int = 1) -> Operation:
    operands = ", ".join(f"{{{i}}}" for i in range(arity))
    return Operation(arity, numpy, f"m_{name}({operands})", libm=True)


def _comparison(numpy: Callable[..., Any], c: str) -> Operation:
    return Operation(len(c.split("{")) - 1, numpy, f"(({c}) ? ONE : ZERO)", boolean=True)


OPERATIONS: dict[str, Operation] = {
    "add": Operation(2, np.add, "{0} + {1}"),
    "sub": Operation(2, np.subtract, "{0} - {1}"),
    "mul": Operation(2, np.multiply, "{0} * {1}"),
    "div": Operation(2, np.divide, "{0} / {1}"),
    "neg": Operation(1, np.negative, "-{0}"),
    "sqrt": _function("sqrt", np.sqrt),
    "fabs": _function("fabs", np.fabs),
    "floor": _function("floor", np.floor),
    "ceil": _function("ceil", np.ceil),
    "copysign": _function("copysign", np.copysign, 2),
    "sign": Operation(1, np.sign, "({0} > ZERO ? ONE : ({0} < ZERO ? -ONE : {0}))"),
    "fmin": Operation(2, np.fmin, "({0} < {1} ? {0} : ({1} == {1} ? {1} : {0}))"),
    "fmax": Operation(2, np.fmax, "({0} > {1} ? {0} : ({1} == {1} ? {1} : {0}))"),
    "select": Operation(2, _select, "({0} != ZERO ? {1} : ZERO)"),
    "lt": _comparison(np.less, "{0} < {1}"),
    "le": _comparison(np.less_equal, "{0} <= {1}"),
    "eq": _comparison(np.equal, "{0} == {1}"),
    "ne": _comparison(np.not_equal, "{0} != {1}"),
    "not": _comparison(np.logical_not, "{0} == ZERO"),
    "and": _comparison(np.logical_and, "({0} != ZERO) & ({1} != ZERO)"),
    "or": _comparison(np.logical_or, "({0} != ZERO) | ({1} != ZERO)"),
    "exp": _function("exp", np.exp),
    "expm1": _function("expm1", np.expm1),
    "log": _function("log", np.log),
    "log1p": _function("log1p", np.log1p),
    "pow": _function("pow", np.power, 2),
    "sin": _function("sin", np.sin),
    "cos": _function("cos", np.cos),
    "tan": _function("tan", np.tan),
    "asin": _function("asin", np.arcsin),
    "acos": _function("acos", np.arccos),
    "atan": _function("atan", np.arctan),
    "atan2": _function("atan2", np.arctan2, 2),
    "sinh": _function("sinh", np.sinh),
    "cosh": _function("cosh", np.cosh),
    "tanh": _function("tanh", np.tanh),
    "asinh": _function("asinh", np.arcsinh),
    "acosh": _function("acosh", np.arccosh),
    "atanh": _function("atanh", np.arctanh),
    "hypot": _function("hypot", np.hypot, 2),
    "erf": _function("erf", _erf),
    "fmod": _function("fmod", np.fmod, 2),
    "remainder": Operation(2, _remainder, "{0} - {1} * m_rint({0} / {1})"),
}
"""Every operation of a program, beside ``const``. ``select(c, y)`` is ``y`` where ``c != 0``, else
0, whatever `y` is there; ``remainder(a, b)`` is ``a - b round(a / b)``, ties to even."""

Instruction = tuple[Any, ...]
Ports = tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Program:
    """A straight-line program.

    Values are numbered: first the components of all inputs, then one per instruction.

    Parameters
    ----------
    name : str
        What the program computes.
    inputs, outputs : tuple of (name, size)
        Vectors that go in and come out.
    instructions : tuple of tuples
        ``("const", number)`` or ``(operation, operand, ..)`` with operands that are earlier values.
    results : tuple of int
        The values that make the outputs, one after the other.
    """

    name: str
    inputs: Ports
    outputs: Ports
    instructions: tuple[Instruction, ...]
    results: tuple[int, ...]

    @property
    def input_count(self) -> int:
        """Number of input components."""
        return sum(size for _, size in self.inputs)

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

    def evaluate(self, *inputs: Any, dtype: Any = np.float64) -> list[np.ndarray]:
        """Return the outputs for inputs with the component first.

        Parameters
        ----------
        *inputs : (size, ...)
            One array per input; the axes after the first are broadcast against each other.
        dtype : NumPy dtype
            Arithmetic to use.

        Returns
        -------
        list of (size, ...)
            One array per output. Invalid operations give NaN or infinity, never a warning.
        """
        dtype = np.dtype(dtype).type
        values: list[Any] = []
        for (_, size), data in zip(self.inputs, inputs, strict=True):
            array = np.asarray(data, dtype)
            values += [array[k] for k in range(size)]
        shape = np.broadcast_shapes(*(np.shape(v) for v in values))
        first = len(values)
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
        assert len(values) == first + len(self.instructions)
        outputs, start = [], 0
        for _, size in self.outputs:
            rows = np.empty((size, *shape), dtype)
            for k in range(size):
                rows[k] = values[self.results[start + k]]
            outputs.append(rows)
            start += size
        return outputs

    def bind(self, **constants: Any) -> Program:
        """Return the program with some inputs fixed to constants, folded and simplified."""
        builder = ProgramBuilder()
        remaining = tuple(port for port in self.inputs if port[0] not in constants)
        free = {name: [builder.input() for _ in range(size)] for name, size in remaining}
        values: list[int] = []
        for name, size in self.inputs:
            if name in free:
                values += free[name]
            else:
                numbers = np.asarray(constants[name], dtype=float).reshape(size)
                values += map(builder.constant, numbers)
        for name, *operands in self.instructions:
            if name == "const":
                values.append(builder.constant(operands[0]))
            else:
                values.append(builder.apply(name, *(values[k] for k in operands)))
        return builder.build(self.name, remaining, self.outputs, [values[k] for k in self.results])

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
        """Return the program that `to_json` described.

        Raises
        ------
        PolicyFormatError
            Anything that is not a well-formed program.
        """
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
        except (TypeError, KeyError, ValueError, IndexError) as error:
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


class ProgramBuilder:
    """Collects operations into a `Program`, each distinct one once.

    Constants are folded and neutral elements removed (``0 * x`` is 0 here, as in CasADi). A
    selection or a 0/1 factor is moved outwards through products, quotients and sums of the same
    condition, ``select(c, y) * p -> select(c, y * p)``: in a derivative this keeps the branch that
    is not taken, where `p` may be infinite or NaN, from leaking into the result.
    """

    def __init__(self) -> None:
        self._inputs = 0
        self._instructions: list[Instruction] = []
        self._known: dict[Instruction, int] = {}

    def input(self) -> int:
        """Return the value of the next input component; all inputs come before any operation."""
        if self._instructions:
            raise ValueError("inputs must be declared before operations")
        self._inputs += 1
        return self._inputs - 1

    def constant(self, number: float) -> int:
        """Return the value of a constant."""
        number = float(number)
        if math.isnan(number):
            raise ValueError("a constant of the model is NaN")
        return self._emit(("const", number + 0.0))

    def apply(self, name: str, *operands: int) -> int:
        """Return the value of an operation on earlier values, simplified."""
        numbers = [self._number(k) for k in operands]
        if all(number is not None for number in numbers):
            with np.errstate(all="ignore"):
                folded = float(OPERATIONS[name].numpy(*map(np.float64, numbers)))
            if not math.isnan(folded):
                return self.constant(folded)
        rule = _SIMPLIFICATIONS.get(name)
        value = rule(self, *operands) if rule else None
        if value is not None:
            return value
        if name in ("add", "mul", "eq", "ne", "and", "or"):
            operands = tuple(sorted(operands))
        return self._emit((name, *operands))

    def build(self, name: str, inputs: Ports, outputs: Ports, results: Sequence[int]) -> Program:
        """Return the program of the operations that the `results` need."""
        first, needed = self._inputs, set(results)
        for k in range(len(self._instructions) - 1, -1, -1):
            op, *operands = self._instructions[k]
            if first + k in needed and op != "const":
                needed.update(operands)
        number = {k: k for k in range(first)}
        kept: list[Instruction] = []
        for k, (op, *operands) in enumerate(self._instructions):
            if first + k in needed:
                number[first + k] = first + len(kept)
                kept.append((op, *operands) if op == "const" else (op, *map(number.get, operands)))
        return Program(name, inputs, outputs, tuple(kept), tuple(number[k] for k in results))

    def _emit(self, instruction: Instruction) -> int:
        if instruction not in self._known:
            self._known[instruction] = self._inputs + len(self._instructions)
            self._instructions.append(instruction)
        return self._known[instruction]

    def _definition(self, value: int) -> Instruction:
        return self._instructions[value - self._inputs] if value >= self._inputs else ("input",)

    def _number(self, value: int) -> float | None:
        name, *operands = self._definition(value)
        return operands[0] if name == "const" else None

    def _selection(self, value: int) -> tuple[int, int | None] | None:
        """Return (condition, selected) of a selection; selected is None for a 0/1 value."""
        name, *operands = self._definition(value)
        if name == "select":
            return operands[0], operands[1]
        if name in OPERATIONS and OPERATIONS[name].boolean:
            return value, None
        return None

    def _sum(self, name: str, a: int, b: int) -> int | None:
        one, two = self._selection(a), self._selection(b)
        if one and two and one[0] == two[0] and None not in (one[1], two[1]):
            return self.apply("select", one[0], self.apply(name, one[1], two[1]))  # type: ignore[arg-type]
        return None

    def _add(self, a: int, b: int) -> int | None:
        if self._number(a) == 0:
            return b
        if self._number(b) == 0:
            return a
        return self._sum("add", a, b)

    def _sub(self, a: int, b: int) -> int | None:
        if self._number(b) == 0:
            return a
        if self._number(a) == 0:
            return self.apply("neg", b)
        return self._sum("sub", a, b)

    def _mul(self, a: int, b: int) -> int | None:
        for one, two in ((a, b), (b, a)):
            number = self._number(one)
            if number == 0:
                return self.constant(0.0)
            if number == 1:
                return two
            if number == -1:
                return self.apply("neg", two)
        for one, two in ((a, b), (b, a)):
            selection = self._selection(one)
            if selection:
                condition, chosen = selection
                product = two if chosen is None else self.apply("mul", chosen, two)
                return self.apply("select", condition, product)
        return None

    def _div(self, a: int, b: int) -> int | None:
        if self._number(b) == 1:
            return a
        if self._number(a) == 0:
            return self.constant(0.0)
        selection = self._selection(a)
        if selection:
            condition, chosen = selection
            numerator = self.constant(1.0) if chosen is None else chosen
            return self.apply("select", condition, self.apply("div", numerator, b))
        return None

    def _neg(self, a: int) -> int | None:
        name, *operands = self._definition(a)
        if name == "neg":
            return operands[0]
        selection = self._selection(a)
        if selection and selection[1] is not None:
            return self.apply("select", selection[0], self.apply("neg", selection[1]))
        return None

    def _choose(self, condition: int, value: int) -> int | None:
        number = self._number(condition)
        if number is not None:
            return value if number != 0 else self.constant(0.0)
        if self._number(value) == 0:
            return value
        selection = self._selection(value)
        if selection and selection[0] == condition:
            return value
        return None


_SIMPLIFICATIONS: Mapping[str, Callable[..., int | None]] = {
    "add": ProgramBuilder._add,
    "sub": ProgramBuilder._sub,
    "mul": ProgramBuilder._mul,
    "div": ProgramBuilder._div,
    "neg": ProgramBuilder._neg,
    "select": ProgramBuilder._choose,
}
