"""A strict compiler of Structured Text into Python, over the parse tree of tree-sitter.

It takes what edition 2 of IEC 61131-3 surely has, and refuses before anything runs: mixed types,
literals that do not fit, words that are reserved, names before they are declared, arrays in
functions. Running checks the ranges of INT, DINT and TIME; REAL is rounded to single precision.
A unit becomes a Python function, in which a variable ``name`` is the local variable ``v_name``.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import tree_sitter
import tree_sitter_iec61131_3_st as grammar

from capsyn.exports.golden import golden_vectors
from capsyn.exports.sequence import golden_sequence
from capsyn.exports.structured_text.target import TARGET as target
from capsyn.modelling.time_unit import to_seconds
from support.exports.siemens import to_iec

PARSER = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
MS = 1_000_000
"""Of TIME, which is held in nanoseconds."""
WHOLE = {"INT": 1 << 15, "DINT": 1 << 31}
REALS = {"LREAL": float, "REAL": np.float32}
RANGES = WHOLE | {"TIME": (1 << 31) * MS}
ZERO = {"LREAL": 0.0, "REAL": np.float32(0), "BOOL": False, "INT": 0, "DINT": 0, "TIME": 0}
CONVERSIONS = {
    "int_to_dint": ("INT", "DINT", int),
    "dint_to_int": ("DINT", "INT", int),
    "dint_to_lreal": ("DINT", "LREAL", float),
    "dint_to_real": ("DINT", "REAL", np.float32),
    "real_to_lreal": ("REAL", "LREAL", float),
    "lreal_to_real": ("LREAL", "REAL", np.float32),
}
LARGEST_REAL, LEAST_REAL = 3.4028234e38, 1.1754944e-38
TIME_UNITS = {"d": 86_400_000, "h": 3_600_000, "m": 60_000, "s": 1000, "ms": 1}
RESERVED = frozenset(
    """
    action any any_bit any_date any_derived any_elementary any_int any_magnitude any_num any_real
    array at bool by byte case configuration constant date date_and_time dint do dt dword else elsif
    en end_action end_case end_configuration end_for end_function end_function_block end_if
    end_program end_repeat end_resource end_step end_struct end_transition end_type end_var
    end_while eno exit f_edge false for from function function_block if initial_step int lint
    lreal lword mod non_retain not of on or program r_edge read_only read_write real repeat
    resource retain return sint step string struct task then time time_of_day to tod transition
    true type udint uint ulint until usint var var_access var_config var_external var_global
    var_in_out var_input var_output var_temp while with word wstring xor and
    abs sqrt ln log exp sin cos tan asin acos atan add mul sub div expt move shl shr ror rol sel max
    min limit mux gt ge eq le lt ne len left right mid concat insert delete replace find trunc
    sr rs sema r_trig f_trig ctu ctd ctud tp ton tof rtc integral derivative pid ramp hysteresis
    """.split()
)
"""Keywords of edition 2, and functions and blocks that MATIEC knows before a program begins."""
NAME = re.compile(r"([a-z]|_[a-z0-9])(_?[a-z0-9])*")
REAL = re.compile(r"-?\d+\.\d+(E-?\d+)?")
TIME = re.compile(r"T#(\d+)(d|h|m|s|ms)")
Values = dict[str, Any]


class Refused(Exception):
    """What a strict compiler does not take."""


def refuse(wrong: object, why: str) -> None:
    if wrong:
        raise Refused(why)


@dataclass(frozen=True)
class Value:
    """An expression: its type, ``whole`` or ``decimal`` of a literal, and its text in Python."""

    kind: str
    code: str
    literal: Any = None


def _divide(a: int, b: int) -> int:
    return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)


def _modulo(a: int, b: int) -> int:
    return a - _divide(a, b) * b


def _over(kind: str, value: int) -> None:
    raise OverflowError(f"{value} is no {kind}")


def _unsigned(value: int, first: int) -> int:
    """Return a TIME made of a first one and another: some PLCs have it without a sign."""
    if value < min(0, first):
        raise OverflowError(f"{value} ns is no TIME")
    return value


def _place(index: int, size: int) -> int:
    if not 0 <= index < size:
        raise IndexError(index)
    return index


RUNNING = {
    "_divide": _divide, "_modulo": _modulo, "_over": _over, "_unsigned": _unsigned,
    "_place": _place, **{name: convert for name, (_, _, convert) in CONVERSIONS.items()},
}  # fmt: skip
"""What units call."""
COMPARISONS = {"<": "<", "<=": "<=", ">": ">", ">=": ">=", "=": "==", "<>": "!="}


def _in_range(kind: str, value: int) -> int:
    if not -RANGES[kind] <= value < RANGES[kind]:
        _over(kind, value)
    return value


def _literal(value: Value, kind: str) -> Any:
    """Return the number of a literal as a type that it must fit."""
    if value.kind == "whole" and kind in WHOLE:
        refuse(abs(value.literal) >= WHOLE[kind], f"{value.literal} is no literal of {kind}")
        return value.literal
    refuse(value.kind != "decimal" or kind not in REALS, f"{value.kind} is no {kind}")
    size = abs(value.literal)
    refuse(size and not LEAST_REAL <= size <= LARGEST_REAL, f"{size} is no REAL")
    return REALS[kind](value.literal)


def _checked(kind: str, code: str) -> str:
    """Return the text of a value that must be in the range of its type."""
    size = RANGES[kind]
    return f"(t if {-size} <= (t := {code}) < {size} else _over({kind!r}, t))"


Statement = Callable[[], ast.stmt]
"""What makes a statement of Python once it is needed: most mutants are refused before."""


def _made(head: str, body: list[Statement] = (), other: list[Statement] = ()) -> Statement:
    """Return a statement, with what is within it and in its ELSE."""

    def make() -> ast.stmt:
        (made,) = ast.parse(f"{head}: 0" if body else head).body
        if body:
            made.body = [each() for each in body]
            made.orelse = [each() for each in other]
        return made

    return make


def _text(node: Any) -> str:
    return node.text.decode().lower()


def _named(node: Any) -> list[Any]:
    return [child for child in node.named_children if child.type != "comment"]


class Unit:
    """A function or a function block."""

    def __init__(self, program: Program, node: Any) -> None:
        self.program = program
        self.kinds: dict[str, str] = {}
        self.arrays: dict[str, int] = {}
        self.start: Values = {}
        self.inputs: list[str] = []
        self.outputs: list[str] = []
        self.read: set[str] = set()
        self.written: set[str] = set()
        self.names: Values = {}  # of numbers, and of functions that are called
        parts = _named(node)
        self.name = _text(parts[0])
        self.is_function = node.type == "function_declaration"
        refuse(not self.is_function and node.type != "function_block_declaration", node.type)
        refuse(self.name in program.units, f"{self.name} is defined twice")
        _check_name(self.name)
        if self.is_function:
            self._declare(self.name, _kind(parts.pop(1)))
        body = parts[1:]
        while body and body[0].type.startswith("var_"):
            self._variables(body.pop(0))
        refuse(not self.inputs, f"{self.name} has no input")
        self.body = self._block(body)
        inner = set(self.kinds) - {*self.inputs, *self.outputs, self.name}
        refuse(inner - self.read, f"never read: {inner - self.read}")
        needed = {*self.outputs, *([self.name] if self.is_function else [])}
        refuse(needed - self.written, f"never written: {needed - self.written}")

    def _as(self, value: Value, kind: str) -> str:
        """Return the text of an expression as a type, which it must have, or fit as a literal."""
        if (value.kind == "whole" and kind in WHOLE) or (value.kind == "decimal" and kind in REALS):
            name = f"k{len(self.names)}"
            self.names[name] = _literal(value, kind)
            return name
        refuse(value.kind != kind, f"{value.kind} is no {kind}")
        return value.code

    def _start(self, node: Any, kind: str) -> Any:
        """Return the value that a variable begins with."""
        value = self._value(node)
        if value.literal is not None:
            return _literal(value, kind)
        refuse(value.kind != kind, f"{value.kind} is no {kind}")
        return eval(value.code, {})

    def _declare(self, name: str, kind: str, size: int = 0, start: Any = None) -> None:
        _check_name(name)
        refuse(name in self.kinds or name in self.program.units, f"{name} is declared twice")
        refuse(name == self.name and not self.is_function, f"{name} is the block")
        self.kinds[name] = kind
        if size:
            self.arrays[name] = size
        self.start[name] = start if start is not None else [ZERO[kind]] * size or ZERO[kind]

    def _variables(self, block: Any) -> None:
        word = _text(block.children[0])
        wanted = ["var_input", "var"] + ["var_output"] * (not self.is_function)
        refuse(word not in wanted, word)
        declared = _named(block)
        refuse(not declared, "an empty section")
        for part in declared:
            refuse(part.type != "variable_declaration", part.text)
            name, kind, *given = _named(part)
            text, array = _text(name), kind.type == "array_type"
            refuse(array and (self.is_function or word != "var"), f"an array in {self.name}")
            if array:
                ends, element = _named(kind)
                first, last = (int(_text(end)) for end in _named(ends))
                of, size = _kind(element), last - first + 1
                refuse(first != 0 or size < 1, kind.text)
                refuse(given and len(given) != size, f"{text} has {len(given)} values")
                start = [self._start(value, of) for value in given] or None
                self._declare(text, of, size, start)
            else:
                of = _kind(kind)
                refuse(len(given) > 1 or (given and self.is_function), part.text)
                start = self._start(given[0], of) if given else None
                self._declare(text, of, start=start)
            if word != "var":
                (self.inputs if word == "var_input" else self.outputs).append(text)

    def _known(self, node: Any, array: bool = False) -> str:
        name = _text(node)
        refuse(node.type != "identifier" or name not in self.kinds, f"{name} is not declared")
        refuse((name in self.arrays) != array, f"{name}: an array or none")
        return name

    def _block(self, nodes: list[Any]) -> list[Statement]:
        made, k = [], 0
        while k < len(nodes):
            kind = nodes[k].type
            made += self._statement(nodes[k])
            if kind != "assignment_statement":  # has its own
                k += 1
                refuse(k == len(nodes) or nodes[k].type != "empty_statement", f"no ; after {kind}")
            k += 1
        refuse(not made, "no statement")
        return made

    def _statement(self, node: Any) -> list[Statement]:
        found = getattr(self, "_" + node.type, None)
        refuse(found is None, node.type)
        return found(node)

    def _assignment_statement(self, node: Any) -> list[Statement]:
        target, given = _named(node)
        index = ""
        if target.type == "index_expression":
            place, at = _named(target)
            name = self._known(place, array=True)
            index = f"[{self._index(name, at)}]"
        else:
            name = self._known(target)
        refuse(name in self.inputs, f"{name} is an input")
        value = self._as(self._value(given), self.kinds[name])
        self.written.add(name)
        return [_made(f"v_{name}{index} = {value}")]

    def _index(self, name: str, node: Any) -> str:
        value, size = self._value(node), self.arrays[name]
        code = self._as(value, "DINT" if value.kind == "whole" else value.kind)
        refuse(value.kind not in (*WHOLE, "whole"), f"an index of {value.kind}")
        refuse(value.literal is not None and not 0 <= value.literal < size, f"{name} has {size}")
        return f"_place({code}, {size})"

    def _if_statement(self, node: Any) -> list[Statement]:
        condition, *rest = _named(node)
        clauses = [part for part in rest if part.type.endswith("_clause")]
        refuse(any(part.type != "else_clause" for part in clauses), "ELSIF")
        test = self._as(self._value(condition), "BOOL")
        then = self._block(rest[: len(rest) - len(clauses)])
        return [_made(f"if {test}", then, self._block(_named(clauses[0])) if clauses else [])]

    def _while_statement(self, node: Any) -> list[Statement]:
        condition, *rest = _named(node)
        test = self._as(self._value(condition), "BOOL")
        return [_made(f"while {test}", self._block(rest))]

    def _for_statement(self, node: Any) -> list[Statement]:
        variable, first, last, *rest = _named(node)
        name = self._known(variable)
        kind = self.kinds[name]
        refuse(kind not in WHOLE, f"FOR of {kind}")
        start, end = (self._as(self._value(part), kind) for part in (first, last))
        self.written.add(name)
        return [_made(f"for v_{name} in range({start}, {end} + 1)", self._block(rest))]

    def _case_statement(self, node: Any) -> list[Statement]:
        chosen, *rest = _named(node)
        value, cases, other = self._value(chosen), {}, []
        refuse(value.kind not in WHOLE, f"CASE of {value.kind}")
        for part in rest:
            if part.type == "else_clause":
                other = self._block(_named(part))
            else:
                of, *body = _named(part)
                label = self._value(_named(of)[0])
                refuse(label.literal is None, "CASE of what is no literal")
                key = _literal(label, value.kind)
                refuse(key in cases, f"CASE {key}")
                cases[key] = self._block(body)
        keys = sorted(cases)

        def between(first: int, last: int) -> list[Statement]:
            if last - first == 1:
                return [_made(f"if c == {keys[first]}", cases[keys[first]], other)]
            half = (first + last) // 2
            return [_made(f"if c < {keys[half]}", between(first, half), between(half, last))]

        assert keys, node.text
        return [_made(f"c = {value.code}"), *between(0, len(keys))]

    def _value(self, node: Any) -> Value:
        kind, parts = node.type, _named(node)
        text = node.text.decode()
        if kind == "integer_literal":
            refuse(not re.fullmatch(r"-?\d+", text), text)
            return Value("whole", "", int(text))
        if kind == "real_literal":
            refuse(not REAL.fullmatch(text), f"{text} is no real literal")
            return Value("decimal", "", float(text))
        if kind == "time_literal":
            found = TIME.fullmatch(text)
            refuse(not found, f"{text} is no TIME")
            size = _in_range("TIME", int(found[1]) * TIME_UNITS[found[2]] * MS)
            return Value("TIME", f"({size})")
        if kind == "boolean_literal":
            return Value("BOOL", str(_text(node) == "true"))
        if kind == "identifier":
            name = self._known(node)
            refuse(self.is_function and name == self.name, f"{name} is read")
            self.read.add(name)
            return Value(self.kinds[name], f"v_{name}")
        if kind == "parenthesized_expression":
            inner = self._value(parts[0])
            refuse(inner.kind == "whole", "a whole number in brackets")
            return inner
        if kind == "index_expression":
            name = self._known(parts[0], array=True)
            index = self._index(name, parts[1])
            self.read.add(name)
            return Value(self.kinds[name], f"v_{name}[{index}]")
        if kind == "unary_expression":
            return self._unary(_text(node.children[0]), self._value(parts[0]))
        if kind == "binary_expression":
            return self._binary(_text(node.children[1]), *map(self._value, parts))
        if kind == "call_expression":
            return self._call(node)
        raise Refused(f"{kind}: {node.text!r}")

    def _unary(self, sign: str, inner: Value) -> Value:
        if sign == "not":
            return Value("BOOL", f"(not {self._as(inner, 'BOOL')})")
        kind = inner.kind
        refuse(kind not in (*WHOLE, *REALS), f"{sign}{kind}")
        code = f"(-{inner.code})"
        return Value(kind, code if kind in REALS else _checked(kind, code))

    def _binary(self, sign: str, left: Value, right: Value) -> Value:
        if sign in ("and", "or"):
            a, b = self._as(left, "BOOL"), self._as(right, "BOOL")
            # no short cuts: both sides are evaluated
            return Value("BOOL", f"({a} {'&' if sign == 'and' else '|'} {b})")
        kinds = [side.kind for side in (left, right) if side.literal is None]
        refuse(not kinds, f"literals alone around {sign}")
        kind = kinds[0]
        a, b = self._as(left, kind), self._as(right, kind)
        if sign in COMPARISONS:
            refuse(kind == "BOOL", f"BOOL {sign} BOOL")
            code = f"({a} {COMPARISONS[sign]} {b})"
            return Value("BOOL", f"bool{code}" if kind == "REAL" else code)
        refuse(sign not in (*"+-*/", "mod") or kind == "BOOL", f"{kind} {sign}")
        refuse(kind == "TIME" and sign not in "+-", f"TIME {sign} TIME")
        refuse(kind in REALS and sign == "mod", f"{kind} MOD")
        if kind in REALS:
            return Value(kind, f"({a} {sign} {b})")
        if kind == "TIME":
            return Value(kind, f"_unsigned({_checked(kind, f'{a} {sign} {b}')}, {a})")
        whole = {"/": f"_divide({a}, {b})", "mod": f"_modulo({a}, {b})"}
        return Value(kind, _checked(kind, whole.get(sign, f"({a} {sign} {b})")))

    def _call(self, node: Any) -> Value:
        called, arguments = _named(node)
        name, given = _text(called), _named(arguments)
        if name in CONVERSIONS:
            source, kind, _ = CONVERSIONS[name]
            refuse(len(given) != 1, name)
            inner = self._value(given[0])
            refuse(inner.literal is not None, f"{name} of a literal")
            code = f"{name}({self._as(inner, source)})"
            return Value(kind, _checked(kind, code) if kind in RANGES else code)
        unit = self.program.units.get(name)  # declared before: no recursion
        refuse(unit is None or not unit.is_function, f"{name} is no function")
        refuse(any(part.type != "named_argument" for part in given), f"{name}: no formal call")
        pairs = [_named(part) for part in given]
        refuse([_text(place) for place, _ in pairs] != unit.inputs, f"{name} takes {unit.inputs}")
        codes = [
            self._as(self._value(value), unit.kinds[place])
            for place, (_, value) in zip(unit.inputs, pairs)
        ]
        self.names[f"f_{name}"] = unit.function
        return Value(unit.kinds[name], f"f_{name}({', '.join(codes)})")

    @functools.cached_property
    def function(self) -> Callable[..., Any]:
        """Return a function of the inputs to the value, or of the values of all variables."""
        inputs = ", ".join(f"v_{name}" for name in self.inputs)
        inner = [name for name in self.kinds if name not in self.inputs]
        starts = {f"s_{name}": self.start[name] for name in inner}
        if self.is_function:
            begin = [f"v_{name} = s_{name}" for name in inner]
            text = [f"def made({inputs}):", *begin, f"return v_{self.name}"]
        else:
            begin = [f"v_{name} = values[{name!r}]" for name in self.kinds]
            scalars = [name for name in self.written if name not in self.arrays]
            text = ["def made(values):", *begin, *(f"values[{x!r}] = v_{x}" for x in scalars)]
        module = ast.parse("\n    ".join(text))
        (made,) = module.body
        assert isinstance(made, ast.FunctionDef)
        made.body[len(begin) : len(begin)] = [each() for each in self.body]
        found = RUNNING | self.names | starts
        exec(compile(ast.fix_missing_locations(module), self.name, "exec"), found)
        return found["made"]

    def run(self, values: Values) -> None:
        """Run once with the values of all variables, which it changes."""
        if self.is_function:
            values[self.name] = self.function(*(values[name] for name in self.inputs))
        else:
            self.function(values)


def _kind(node: Any) -> str:
    kind = node.text.decode()
    refuse(kind not in ZERO, f"{kind} is no type")
    return kind


def _check_name(name: str) -> None:
    wrong = not NAME.fullmatch(name) or name in RESERVED or "_to_" in name
    refuse(wrong, f"{name} is no name")


class Program:
    """The units of a source text; the last is a function block.

    Before it there may be one more, of its name with ``_next``.
    """

    def __init__(self, source: bytes) -> None:
        text = source.decode("ascii")
        refuse("(*" in re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL), "a comment without end")
        for found in re.findall(r"\(\*(.*?)\*\)", text, flags=re.DOTALL):
            refuse("(*" in found, "a comment in another")
        root = PARSER.parse(source).root_node
        if root.has_error:
            raise Refused("\n".join(errors(root)))
        self.units: dict[str, Unit] = {}
        for node in _named(root):
            refuse(node.type == "empty_statement", "; after a unit")
            unit = Unit(self, node)
            self.units[unit.name] = unit
        self.block = unit
        blocks = {k for k, unit in self.units.items() if not unit.is_function} - {
            f"{unit.name}_next"
        }
        refuse(blocks != {unit.name}, "one block, at the end")

    def interface(self) -> list[tuple[str, str]]:
        """Return names and types of the inputs and the outputs of the block."""
        block = self.block
        return [(name, block.kinds[name]) for name in (*block.inputs, *block.outputs)]

    def instance(self, end: str = "") -> Callable[..., Values]:
        """Return a new instance of the block: called with inputs, it returns all its variables.

        A TIME is given in milliseconds. Of another unit with an `end` to the block's name likewise.
        """
        block = self.units[self.block.name + end]
        values = {k: list(v) if isinstance(v, list) else v for k, v in block.start.items()}

        def call(*inputs: float) -> Values:
            for name, value in zip(block.inputs, inputs, strict=True):
                kind = block.kinds[name]
                if kind in WHOLE:
                    assert value == int(value)
                    values[name] = _in_range(kind, int(value))
                elif kind == "TIME":
                    values[name] = _in_range(kind, round(value * MS))
                else:
                    values[name] = REALS[kind](value)
            with np.errstate(all="ignore"):
                block.run(values)
            return values

        return call


def errors(node: Any) -> list[str]:
    """Return the places where the parser found no sense, or something missing."""
    found = [f"{node.start_point}: {node.text[:60]!r}"] if node.is_error or node.is_missing else []
    return found + [text for child in node.children for text in errors(child)]


def source(plan, **options):
    """Return the text of an export, in its dialect."""
    return _text_of(target.files(plan, golden_vectors(plan), **options))


def _text_of(exported):
    (text,) = (text for name, text in exported.files.items() if not name.endswith(".xml"))
    return text


def program(plan, **options):
    """Return the strictly compiled text of an export; of Siemens SCL what it is in IEC 61131-3."""
    return _compiled(source(plan, **options), options)


def _compiled(text, options):
    assert max(map(len, text.decode("ascii").splitlines())) < 100
    return Program(to_iec(text) if options.get("dialect") == "siemens" else text)


def check(plan, golden=None, **options):
    """Compare symbols, statuses and controls with golden vectors.

    Return how many there were, and which symbols.
    """
    vectors = golden_vectors(plan)
    exported = target.files(plan, vectors, **options)
    golden = exported.golden or vectors if golden is None else golden
    made = _compiled(_text_of(exported), options)
    real, reading = options.get("real", "LREAL"), options.get("readings", "real")
    inputs = plan.policy.alphabet.inputs
    kinds = [kind for _, kind in made.interface()]
    timed = ["TIME"] * plan.waits
    expected = [real if reading == "real" else reading] * plan.n + timed + ["INT", "INT"]
    assert kinds == expected + [real] * len(inputs)
    names = made.block.outputs[2:]
    controls = plan.policy.controls
    controls = controls.astype(np.float32 if real == "REAL" else float).tolist()
    if plan.has_state:
        return len(golden), next_symbols(made, plan, golden)
    cycle = [10**9] * plan.waits
    call = made.instance()
    seen = set()
    for state, label, status in zip(golden.readings.tolist(), golden.labels, golden.statuses):
        found = call(*state, *cycle)
        assert (found["symbol"], found["status"]) == (label, status), state
        assert [float(found[name]) for name in names] == controls[label]
        seen.add(int(label))
    return len(golden), seen


def next_symbols(made, plan, golden):
    """Compare what follows symbols in force with golden vectors; return which symbols there are."""
    call, unit = made.instance("_next"), made.units[made.block.name + "_next"]
    in_force = np.full(len(golden), plan.default) if golden.in_force is None else golden.in_force
    for now, reading, label, status in zip(
        in_force.tolist(), golden.readings.tolist(), golden.labels, golden.statuses
    ):
        found = call(now, *reading)
        if unit.is_function:
            assert found[unit.name] == label, reading
        else:
            assert (found["symbol"], found["status"]) == (label, status), reading
    outputs = [unit.name] if unit.is_function else unit.outputs

    def told(now):
        found = call(now, *reading)
        return [found[name] for name in outputs]

    for wrong in (-1, plan.labels, -(1 << 15), (1 << 15) - 1):  # the default control
        assert told(wrong) == told(plan.default)
    return set(golden.labels.tolist())


def check_sequence(plan, **options):
    """Compare symbols, statuses and controls with some golden sequences; return their labels."""
    exported = target.files(plan, golden_vectors(plan), **options)
    sequence = exported.sequence or golden_sequence(plan)
    made = _compiled(_text_of(exported), options)
    cycle = [1000 * to_seconds(sequence.period, plan.policy.time_unit)] * plan.waits
    names, controls = made.block.outputs[2:], plan.policy.controls
    controls = controls.astype(REALS[options.get("real", "LREAL")]).tolist()
    runs = list(zip(sequence.readings, sequence.labels, sequence.statuses))[::3]
    for readings, labels, statuses in runs:
        call = made.instance()
        for reading, label, status in zip(readings.tolist(), labels, statuses):
            found = call(*reading, *cycle)
            assert (found["symbol"], found["status"]) == (label, status)
            assert [found[name] for name in names] == controls[label]
    return np.stack([labels for _, labels, _ in runs])
