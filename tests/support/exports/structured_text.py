"""A small interpreter of Structured Text over the parse tree of tree-sitter."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import tree_sitter
import tree_sitter_iec61131_3_st as grammar

from capsyn.exports.golden import golden_vectors
from capsyn.exports.structured_text.target import TARGET as target

PARSER = tree_sitter.Parser(tree_sitter.Language(grammar.language()))
RANGES = {"INT": 2**15, "DINT": 2**31}
Values = dict[str, Any]
Run = Callable[[Values], Any]


def _divide(a: Any, b: Any) -> Any:
    if isinstance(a, int):
        return abs(a) // abs(b) * (1 if (a < 0) == (b < 0) else -1)
    return a / b


OPERATORS = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": _divide,
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
    "=": operator.eq, "<>": operator.ne,
}  # fmt: skip


def _converted(kind: str, value: Any) -> Any:
    """Return a value as a variable of a type takes it; nothing is converted silently."""
    if kind == "LREAL":
        if type(value) is not float:
            raise TypeError(f"{value!r} is no LREAL")
    elif kind == "BOOL":
        if type(value) is not bool:
            raise TypeError(f"{value!r} is no BOOL")
    elif type(value) is not int or not -RANGES[kind] <= value < RANGES[kind]:
        raise TypeError(f"{value!r} is no {kind}")
    return value


def _text(node: Any) -> str:
    return node.text.decode().lower()


def _named(node: Any) -> list[Any]:
    return [child for child in node.named_children if child.type != "comment"]


class Unit:
    """A function or a function block."""

    def __init__(self, program: Program, node: Any) -> None:
        self.program, self.kinds, self.start = program, {}, {}
        self.inputs: list[str] = []
        self.constants: set[str] = set()
        parts = _named(node)
        self.name = _text(parts[0])
        self.is_function = node.type == "function_declaration"
        if self.is_function:
            self._declare(self.name, parts.pop(1).text.decode(), None)
        body = []
        for part in parts[1:]:
            if part.type in ("var_input", "var_output", "var_block"):
                self._variables(part)
            else:
                body.append(part)
        self.run = self._block(body)

    def _declare(self, name: str, kind: str, value: Any) -> None:
        if name in self.kinds or (name in self.program.units and name != self.name):
            raise NameError(f"{name} is declared twice")
        zero = {"LREAL": 0.0, "BOOL": False}.get(kind, 0)
        self.kinds[name], self.start[name] = kind, zero if value is None else value

    def _variables(self, block: Any) -> None:
        for part in _named(block):
            if part.type != "variable_declaration":
                continue
            name, kind, *values = _named(part)
            if block.type == "var_input":
                self.inputs.append(_text(name))
            if b"CONSTANT" in block.text[:20]:
                self.constants.add(_text(name))
            given = [self._value(value)({}) for value in values]
            if kind.type == "array_type":
                ends, element = _named(kind)
                first, last = (int(_text(end)) for end in _named(ends))
                size, of = last - first + 1, element.text.decode()
                if first != 0 or (given and len(given) != size):
                    raise ValueError(f"{_text(name)} has {len(given)} values")
                start = [_converted(of, value) for value in given] or [0] * size
                self._declare(_text(name), of, start)
            else:
                of = kind.text.decode()
                self._declare(_text(name), of, _converted(of, given[0]) if given else None)

    def _known(self, name: str) -> str:
        if name not in self.kinds:
            raise NameError(name)
        return name

    def _block(self, nodes: list[Any]) -> Run:
        runs = [self._statement(node) for node in nodes if node.type != "empty_statement"]
        if len(runs) == 1:
            return runs[0]

        def run(values: Values) -> None:
            for each in runs:
                each(values)

        return run

    def _statement(self, node: Any) -> Run:
        return getattr(self, "_" + node.type)(node)

    def _assignment_statement(self, node: Any) -> Run:
        target, given = _named(node)
        value = self._value(given)
        place = target if target.type == "identifier" else _named(target)[0]
        name = self._known(_text(place))
        kind = self.kinds[name]
        if name in self.constants or (self.is_function and name in self.inputs):
            raise NameError(f"{name} is not to be changed")
        if target.type == "identifier":

            def run(values: Values) -> None:
                values[name] = _converted(kind, value(values))

        else:
            index = self._value(_named(target)[1])

            def run(values: Values) -> None:
                values[name][_at(values[name], index(values))] = _converted(kind, value(values))

        return run

    def _if_statement(self, node: Any) -> Run:
        condition, *rest = _named(node)
        clauses = [part for part in rest if part.type in ("else_clause", "elsif_clause")]
        assert all(part.type == "else_clause" for part in clauses)
        test, then = self._value(condition), self._block(rest[: len(rest) - len(clauses)])
        other = self._block(_named(clauses[0])) if clauses else None

        def run(values: Values) -> None:
            if _converted("BOOL", test(values)):
                then(values)
            elif other is not None:
                other(values)

        return run

    def _while_statement(self, node: Any) -> Run:
        condition, *rest = _named(node)
        test, body = self._value(condition), self._block(rest)

        def run(values: Values) -> None:
            while _converted("BOOL", test(values)):
                body(values)

        return run

    def _for_statement(self, node: Any) -> Run:
        variable, first, last, *rest = _named(node)
        name = self._known(_text(variable))
        start, end, body = self._value(first), self._value(last), self._block(rest)

        def run(values: Values) -> None:
            for value in range(start(values), end(values) + 1):
                values[name] = value
                body(values)

        return run

    def _case_statement(self, node: Any) -> Run:
        chosen, *rest = _named(node)
        value, cases, other = self._value(chosen), {}, None
        for part in rest:
            if part.type == "else_clause":
                other = self._block(_named(part))
            else:
                of, *body = _named(part)
                cases[int(_text(of))] = self._block(body)

        def run(values: Values) -> None:
            body = cases.get(value(values), other)
            if body is not None:
                body(values)

        return run

    def _value(self, node: Any) -> Run:
        kind, parts = node.type, _named(node)
        if kind == "integer_literal":
            whole = int(_text(node))
            return lambda values: whole
        if kind == "real_literal":
            real = float(_text(node))
            return lambda values: real
        if kind == "boolean_literal":
            truth = _text(node) == "true"
            return lambda values: truth
        if kind == "identifier":
            name = self._known(_text(node))
            return lambda values: values[name]
        if kind == "parenthesized_expression":
            return self._value(parts[0])
        if kind == "index_expression":
            name, index = self._known(_text(parts[0])), self._value(parts[1])
            return lambda values: values[name][_at(values[name], index(values))]
        if kind == "unary_expression":
            inner = self._value(parts[0])
            if _text(node.children[0]) == "not":
                return lambda values: not _converted("BOOL", inner(values))
            return lambda values: -inner(values)
        if kind == "binary_expression":
            return self._binary(_text(node.children[1]), *map(self._value, parts))
        if kind == "call_expression":
            return self._call(node)
        raise SyntaxError(f"{kind}: {node.text!r}")

    def _binary(self, sign: str, left: Run, right: Run) -> Run:
        if sign in ("and", "or"):

            def both(values: Values) -> bool:  # no short cuts: both sides are evaluated
                a, b = _converted("BOOL", left(values)), _converted("BOOL", right(values))
                return a and b if sign == "and" else a or b

            return both
        operation = OPERATORS[sign]

        def run(values: Values) -> Any:
            a, b = left(values), right(values)
            if type(a) is not type(b):
                raise TypeError(f"{a!r} {sign} {b!r}")
            found = operation(a, b)
            return _converted("DINT", found) if type(found) is int else found

        return run

    def _call(self, node: Any) -> Run:
        called, arguments = _named(node)
        if _text(called) == "dint_to_lreal":
            inner = self._value(_named(arguments)[0])
            return lambda values: float(_converted("DINT", inner(values)))
        if _text(called) == "int_to_dint":
            inner = self._value(_named(arguments)[0])
            return lambda values: _converted("INT", inner(values))
        if _text(called) == "dint_to_int":
            inner = self._value(_named(arguments)[0])
            return lambda values: _converted("INT", inner(values))
        unit = self.program.units[_text(called)]  # declared before: no recursion
        given = {}
        for name, argument in zip(unit.inputs, _named(arguments), strict=True):
            if argument.type == "named_argument":
                place, argument = _named(argument)
                name = _text(place)
            given[name] = self._value(argument)
        assert list(given) == unit.inputs

        def run(values: Values) -> Any:
            return unit.call({name: value(values) for name, value in given.items()})

        return run

    def call(self, given: Values) -> Any:
        values = self.start | {k: _converted(self.kinds[k], v) for k, v in given.items()}
        self.run(values)
        return values[self.name]


def _at(values: list[Any], index: int) -> int:
    if not 0 <= index < len(values):
        raise IndexError(index)
    return index


class Program:
    """The units of a source text; the last is a function block."""

    def __init__(self, source: bytes) -> None:
        root = PARSER.parse(source).root_node
        if root.has_error:
            raise SyntaxError("\n".join(errors(root)))
        self.units: dict[str, Unit] = {}
        for node in _named(root):
            if node.type != "empty_statement":
                unit = Unit(self, node)
                self.units[unit.name] = unit
        self.block = unit

    def instance(self) -> Callable[..., Values]:
        """Return a new instance of the block: called with inputs, it returns all its variables."""
        values = {k: list(v) if isinstance(v, list) else v for k, v in self.block.start.items()}

        def call(*inputs: float) -> Values:
            for name, value in zip(self.block.inputs, inputs, strict=True):
                values[name] = _converted(self.block.kinds[name], value)
            self.block.run(values)
            return values

        return call


def errors(node: Any) -> list[str]:
    """Return the places where the parser found no sense, or something missing."""
    found = [f"{node.start_point}: {node.text[:60]!r}"] if node.is_error or node.is_missing else []
    return found + [text for child in node.children for text in errors(child)]


def source(plan, **options):
    (text,) = target.files(plan, golden_vectors(plan), **options).files.values()
    return text


def check(plan, golden=None, **options):
    golden = golden_vectors(plan) if golden is None else golden
    text = source(plan, **options)
    assert max(map(len, text.decode("ascii").splitlines())) < 100
    call = Program(text).instance()
    controls = plan.policy.controls.tolist()
    outputs = None
    for state, label, status in zip(golden.readings.tolist(), golden.labels, golden.statuses):
        found = call(*state)
        if outputs is None:
            outputs = list(found)[plan.n + 2 : plan.n + 2 + len(controls[0])]
        assert (found["symbol"], found["status"]) == (label, status), state
        assert [found[name] for name in outputs] == controls[label]
