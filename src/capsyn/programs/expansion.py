"""The expanded form of a program: polynomials of atoms, added up in exact rational arithmetic.

Interval arithmetic treats every operand as if it varied on its own and so does not see that terms
cancel, as those of gravity do in the derivative of an energy. Here they are gone: sums, products
and quotients by constants are multiplied out, whatever else is an atom, known by its operands.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from capsyn.programs.operations import OPERATIONS
from capsyn.programs.program import Instruction, Program

MAX_TERMS = 200
"""Most terms of a polynomial; a sum or product that would have more is an atom."""
MAX_BITS = 4000
"""Most bits of a coefficient's numerator and denominator, likewise."""
MAX_POWER = 16
"""Largest constant exponent that is multiplied out."""

Monomial = tuple[tuple[int, int], ...]
"""Pairs (atom, exponent > 0), atoms ascending; ``()`` is 1."""
Polynomial = tuple[tuple[Monomial, Fraction], ...]
"""Terms with coefficients that are not 0, monomials ascending; ``()`` is 0."""

_ONE: Polynomial = (((), Fraction(1)),)
_ODD = {"sin", "tan", "asin", "atan", "sinh", "tanh", "asinh", "atanh", "erf", "sign"}
_EVEN = {"cos", "cosh", "fabs"}


@dataclass(frozen=True)
class Expansion:
    """A program in expanded form.

    It is equal to the original in real arithmetic wherever that one is defined; where terms cancel
    or factors are taken out it may be defined elsewhere too.
    """

    program: Program
    inexact: frozenset[int]  # its values that are constants which had to be rounded


def expand(program: Program) -> Expansion:
    """Return the expanded form of a program, common factors taken out of every sum."""
    atoms = _Atoms()
    values = _values(program, atoms)
    return _Writer(program, atoms).write([values[k] for k in program.results])


def polynomials(program: Program) -> list[Polynomial]:
    """Return all values of a program as polynomials of the same atoms."""
    return _values(program, _Atoms())


def _values(program: Program, atoms: _Atoms) -> list[Polynomial]:
    values = [atoms.atom("input", k) for k in range(program.input_count)]
    for name, *operands in program.instructions:
        if name == "const":
            values.append(atoms.constant(operands[0]))
        else:
            values.append(atoms.apply(name, *(values[k] for k in operands)))
    return values


class _Atoms:
    """The atoms of a program, each distinct one once, and the operations on polynomials."""

    def __init__(self) -> None:
        self.definitions: list[tuple[Any, ...]] = []
        self._known: dict[tuple[Any, ...], int] = {}

    def atom(self, *definition: Any) -> Polynomial:
        """Return an operation on polynomials, ``("input", k)``, or ``("const", infinity)``."""
        if definition not in self._known:
            self._known[definition] = len(self.definitions)
            self.definitions.append(definition)
        return ((((self._known[definition], 1),), Fraction(1)),)

    def constant(self, number: float) -> Polynomial:
        if abs(number) == float("inf"):
            return self.atom("const", number)
        return _polynomial({(): Fraction(number)})

    def apply(self, name: str, *operands: Polynomial) -> Polynomial:
        """Return the value of an operation."""
        result = self._polynomial(name, *operands)
        if result is None or len(result) > MAX_TERMS or _bits(result) > MAX_BITS:
            return self._atom(name, *operands)
        return result

    def _polynomial(self, name: str, a: Polynomial, *rest: Polynomial) -> Polynomial | None:
        """Return the polynomial that an operation gives, or None."""
        if name == "neg":
            return _scale(a, Fraction(-1))
        if not rest:
            return None
        (b,) = rest
        number = _number(b)
        if name in ("add", "sub"):
            return _add(a, b if name == "add" else _scale(b, Fraction(-1)))
        if name == "mul":
            return _multiply(a, b)
        if name == "div" and number is not None:
            return _scale(a, 1 / number) if number else None
        if name == "div" and a != _ONE:
            return _multiply(a, self.apply("div", _ONE, b))
        if name == "pow" and number in range(1, MAX_POWER + 1):
            power: Polynomial | None = _ONE
            for _ in range(int(number or 0)):
                power = power and _multiply(power, a)
            return power
        if name == "select":
            return _multiply(b, self._condition(a))
        return None

    def _condition(self, a: Polynomial) -> Polynomial:
        """Return 1 where a value is not 0, else 0."""
        if len(a) == 1 and a[0][1] == 1 and len(a[0][0]) == 1:
            ((atom, exponent),) = a[0][0]
            operation = OPERATIONS.get(self.definitions[atom][0])
            if exponent == 1 and operation is not None and operation.boolean:
                return a
        return self.atom("ne", a, ())

    def _atom(self, name: str, *operands: Polynomial) -> Polynomial:
        if name in _ODD | _EVEN and operands[0] and operands[0][0][1] < 0:
            value = self.atom(name, _scale(operands[0], Fraction(-1)))
            return value if name in _EVEN else _scale(value, Fraction(-1))
        return self.atom(name, *operands)


def _polynomial(terms: dict[Monomial, Fraction]) -> Polynomial:
    return tuple(sorted((monomial, c) for monomial, c in terms.items() if c))


def _number(a: Polynomial) -> Fraction | None:
    """Return the value of a constant, or None."""
    if not a:
        return Fraction(0)
    return a[0][1] if len(a) == 1 and not a[0][0] else None


def _bits(a: Polynomial) -> int:
    return max((max(abs(c.numerator), c.denominator).bit_length() for _, c in a), default=0)


def _scale(a: Polynomial, factor: Fraction) -> Polynomial:
    return tuple((monomial, c * factor) for monomial, c in a)


def _add(a: Polynomial, b: Polynomial) -> Polynomial:
    terms = dict(a)
    for monomial, c in b:
        terms[monomial] = terms.get(monomial, Fraction(0)) + c
    return _polynomial(terms)


def _multiply(a: Polynomial, b: Polynomial) -> Polynomial | None:
    """Return a product, or None where multiplying out would be too much work."""
    if len(a) * len(b) > 4 * MAX_TERMS:
        return None
    terms: dict[Monomial, Fraction] = {}
    for one, c in a:
        for two, d in b:
            powers = dict(one)
            for atom, exponent in two:
                powers[atom] = powers.get(atom, 0) + exponent
            monomial = tuple(sorted(powers.items()))
            terms[monomial] = terms.get(monomial, Fraction(0)) + c * d
    return _polynomial(terms)


class _Writer:
    """Writes polynomials as instructions; constants are not folded, that would round them."""

    def __init__(self, program: Program, atoms: _Atoms) -> None:
        self._program = program
        self._definitions = atoms.definitions
        self._instructions: list[Instruction] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self._inexact: set[int] = set()
        self._atoms: dict[int, int] = {}

    def write(self, results: list[Polynomial]) -> Expansion:
        definitions = self._definitions
        needed = {atom for a in results for monomial, _ in a for atom, _ in monomial}
        for atom in range(len(definitions) - 1, -1, -1):  # operands come before what needs them
            name, *operands = definitions[atom]
            if atom in needed and name not in ("input", "const"):
                needed |= {k for a in operands for monomial, _ in a for k, _ in monomial}
        for atom in sorted(needed):
            name, *operands = definitions[atom]
            if name == "input":
                self._atoms[atom] = operands[0]
            elif name == "const":
                self._atoms[atom] = self._emit(name, operands[0])
            else:
                self._atoms[atom] = self._emit(name, *map(self._polynomial, operands))
        values = tuple(map(self._polynomial, results))
        old = self._program
        program = Program(old.name, old.inputs, old.outputs, tuple(self._instructions), values)
        return Expansion(program, frozenset(self._inexact))

    def _emit(self, *instruction: Any) -> int:
        if instruction not in self._known:
            self._known[instruction] = self._program.input_count + len(self._instructions)
            self._instructions.append(instruction)
        return self._known[instruction]

    def _constant(self, number: Fraction) -> int:
        try:
            rounded = float(number)
        except OverflowError:  # beyond the largest number, which is a neighbour of infinity
            rounded = float.fromhex("0x1.fffffffffffffp1023") * (1 if number > 0 else -1)
        if Fraction(rounded) == number:
            return self._emit("const", rounded)
        if ("inexact", number) not in self._known:
            value = self._program.input_count + len(self._instructions)
            self._known["inexact", number] = value
            self._inexact.add(value)
            self._instructions.append(("const", rounded))
        return self._known["inexact", number]

    def _polynomial(self, a: Polynomial) -> int:
        """Return the value of a polynomial: its common factor times the rest."""
        if not a:
            return self._constant(Fraction(0))
        if len(a) == 1:
            return self._plus(None, self._monomial(a[0][0]), a[0][1])
        common = dict(a[0][0])
        for monomial, _ in a[1:]:
            powers = dict(monomial)
            common = {k: min(e, powers[k]) for k, e in common.items() if k in powers}
        total: int | None = None
        for monomial, c in a:
            rest = tuple((k, e - common.get(k, 0)) for k, e in monomial if e > common.get(k, 0))
            total = self._plus(total, self._monomial(rest), c)
        factor = self._monomial(tuple(common.items()))
        assert total is not None
        return total if factor is None else self._emit("mul", *sorted((factor, total)))

    def _plus(self, total: int | None, value: int | None, c: Fraction) -> int:
        """Return ``total + c value``; None stands for 0 and for 1."""
        term = self._constant(abs(c)) if value is None else value
        if value is not None and abs(c) != 1:
            term = self._emit("mul", *sorted((self._constant(abs(c)), value)))
        if total is None:
            return term if c > 0 else self._emit("neg", term)
        return self._emit("add" if c > 0 else "sub", total, term)

    def _monomial(self, monomial: Monomial) -> int | None:
        """Return the value of a product of powers; None stands for 1."""
        product: int | None = None
        for atom, exponent in monomial:
            value = self._atoms[atom]
            if exponent == 2:
                value = self._emit("mul", value, value)
            elif exponent > 2:
                value = self._emit("pow", value, self._constant(Fraction(exponent)))
            product = value if product is None else self._emit("mul", product, value)
        return product
