"""IEC 61131-3 Structured Text: a function block for a PLC."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from capsyn.cells.split_tree import LEAF
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import identifiers, renamed, wanted_name
from capsyn.exports.long_lines import WIDTH, broken
from capsyn.exports.plan import NOT_FINITE, OK, OUTSIDE, Files, Plan
from capsyn.exports.structured_text.lines import KEYWORDS, comment, condition, declared, real
from capsyn.exports.sums import signed_sum
from capsyn.exports.target import Exported, Target
from capsyn.validation import one_of

NESTING = 8
"""Most IFs in one another; deeper subtrees are functions of their own."""
LONGEST_NAME = 32
"""Most characters of a name that are kept."""
SHORT = 32767
"""Largest INT; tables with larger numbers are of DINT, which is twice the size."""
LARGEST = 1.7976931348623157e308
"""Largest finite LREAL."""
FIXED = ("symbol", "status", "cycle")
"""Names that are the same in every block."""
LOCAL = ("z", "wanted", "started", "elapsed", "node", "value", "axis", "i")
TABLES = ("splits", "thresholds", "seconds", "planes")


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
    block = _Block(plan, options.style, options.name)
    return Exported(block.files(), block.renamed, block.notes)


TARGET = Target(export, Options)


class _Block:
    def __init__(self, plan: Plan, style: str, name: str | None) -> None:
        self.plan, self.table = plan, style == "table"
        domain, alphabet = plan.policy.domain, plan.policy.alphabet
        wanted = wanted_name(name, plan.policy.name)
        self.name = identifiers([wanted[:LONGEST_NAME]], KEYWORDS, fold=True)[0]
        n = plan.n
        self.steps = [f"z{i}" for i in range(n)]
        self.calls = {part: f"{self.name}_{part}" for part in ("wrap", "step", "tree")}
        more = (f"{self.calls['tree']}{k}" for k in range(1, plan.tree.node_count))
        kept = {*KEYWORDS, *FIXED, *LOCAL, *TABLES, *self.steps, self.name, *self.calls.values()}
        kept.update(more)
        names = [*domain.names, *alphabet.inputs]
        own_names = identifiers([text[:LONGEST_NAME] for text in names], kept, fold=True)
        self.readings, self.controls = own_names[:n], own_names[n:]
        self.states = identifiers([f"state_{i}" for i in range(n)], {*kept, *own_names}, fold=True)
        self.renamed = renamed([wanted, *names], [self.name, *own_names])

    def files(self) -> Files:
        lines = list(comment(self.plan.header))
        if self.renamed:
            lines += comment(f"Renamed: {old!r} is {new}" for old, new in self.renamed.items())
        domain = self.plan.policy.domain
        if any(domain.periodic):
            lines += ["", *self._wrap()]
        lines += ["", *self._step()]
        if not self.table:
            lines += self._functions()
        lines += ["", *self._declarations(), *self._body(), "END_FUNCTION_BLOCK"]
        return {f"{self.name}.st": ("\n".join(lines) + "\n").encode("ascii")}

    def _wrap(self) -> list[str]:
        return f"""\
(* x brought into [low, high) by whole turns, exactly: only differences that do not round *)
FUNCTION {self.calls["wrap"]} : LREAL
VAR_INPUT
    x : LREAL;
    low : LREAL;
    high : LREAL;
END_VAR
VAR
    rest : LREAL;
    turns : LREAL;
    doublings : DINT;
    negative : BOOL;
END_VAR
{self.calls["wrap"]} := x;
IF (x < low) OR (x >= high) THEN
    rest := x - low;
    negative := rest < 0.0;
    IF negative THEN
        rest := -rest;
    END_IF;
    turns := high - low;
    doublings := 0;
    WHILE turns <= 0.5 * rest DO
        turns := 2.0 * turns;
        doublings := doublings + 1;
    END_WHILE;
    WHILE doublings >= 0 DO
        IF rest >= turns THEN
            rest := rest - turns;
        END_IF;
        turns := 0.5 * turns;
        doublings := doublings - 1;
    END_WHILE;
    IF negative AND (rest > 0.0) THEN
        rest := (high - low) - rest;
    END_IF;
    rest := low + rest;
    IF rest >= high THEN
        rest := low;
    END_IF;
    {self.calls["wrap"]} := rest;
END_IF;
END_FUNCTION""".splitlines()

    def _step(self) -> list[str]:
        return f"""\
(* The lattice step that holds x: the last k with face(k) <= x, from 0 to count - 1, where *)
(* face(k) = low + (high - low) * (k / count), every operation rounded to LREAL. *)
FUNCTION {self.calls["step"]} : DINT
VAR_INPUT
    x : LREAL;
    low : LREAL;
    high : LREAL;
    count : DINT;
END_VAR
VAR
    first : DINT;
    last : DINT;
    middle : DINT;
    face : LREAL;
END_VAR
first := 0;
last := count - 1;
WHILE first < last DO
    middle := last - (last - first) / 2;
    face := DINT_TO_LREAL(middle) / DINT_TO_LREAL(count);
    face := (high - low) * face;
    face := low + face;
    IF face <= x THEN
        first := middle;
    ELSE
        last := middle - 1;
    END_IF;
END_WHILE;
{self.calls["step"]} := first;
END_FUNCTION""".splitlines()

    def _functions(self) -> list[str]:
        """Return the functions of the nested style, each after those that it calls."""
        tree = self.plan.tree.cells
        roots, functions = {0: self.calls["tree"]}, []
        waiting = [0]
        arguments = ", ".join(self.steps)

        def emit(node: int, depth: int, into: str) -> Iterable[str]:
            indent = 4 * depth * " "
            if tree.split[node] == LEAF:
                yield f"{indent}{into} := {tree.threshold[node]};"
            elif depth == NESTING:
                roots[node] = f"{self.calls['tree']}{len(roots)}"
                waiting.append(node)
                yield from broken(f"{indent}{into} := {roots[node]}({arguments});")
            else:
                yield from broken(f"{indent}IF {self._compared(node)} THEN")
                yield from emit(int(tree.second[node]), depth + 1, into)
                yield f"{indent}ELSE"
                yield from emit(node + 1, depth + 1, into)
                yield f"{indent}END_IF;"

        while waiting:
            node = waiting.pop()
            lines = ["", f"FUNCTION {roots[node]} : INT", "VAR_INPUT"]
            lines += [f"    {step} : DINT;" for step in self.steps]
            lines += ["END_VAR", *emit(node, 0, roots[node]), "END_FUNCTION"]
            functions.append(lines)
        return [line for lines in reversed(functions) for line in lines]

    def _compared(self, node: int) -> str:
        tree = self.plan.tree.cells
        split, threshold = int(tree.split[node]), int(tree.threshold[node])
        if split < tree.n:
            return f"{self.steps[split]} >= {threshold}"
        plane = tree.planes[split - tree.n].tolist()
        products = (f"{abs(factor)} * {step}" for factor, step in zip(plane, self.steps))
        return f"{signed_sum(plane, products) or '0'} >= {threshold}"

    def _declarations(self) -> list[str]:
        plan, domain = self.plan, self.plan.policy.domain
        alphabet, raw = plan.policy.alphabet, self._raw
        lines = [f"FUNCTION_BLOCK {self.name}", "VAR_INPUT"]
        for i, reading in enumerate(self.readings):
            unit = f" [{domain.units[i]}]" if domain.units[i] else ""
            is_state = f"{domain.names[i]}{unit}"
            if raw[i]:
                scale, offset = float(plan.scale[i]), float(plan.offset[i])
                is_state = f"reading of {is_state} = reading * {scale!r} + {offset!r}"
            lines += declared(f"{reading} : LREAL;", is_state)
        if plan.dwell > 0:
            lines += declared("cycle : LREAL;", "time since the call before [s]")
        lines += ["END_VAR", "VAR_OUTPUT"]
        lines += declared("symbol : INT;", f"0 to {plan.default}, see the head of the file")
        lines += declared("status : INT;", "0 in the domain, 1 outside, 2 not finite")
        for k, control in enumerate(self.controls):
            unit = f" [{alphabet.units[k]}]" if alphabet.units[k] else ""
            lines += declared(f"{control} : LREAL;", f"{alphabet.inputs[k]}{unit}")
        lines.append("END_VAR")
        if self.table:
            lines += ["VAR CONSTANT", *self._tables(), "END_VAR"]
        lines.append("VAR")
        lines += [f"    {state} : LREAL;" for state in self.states]
        if self.table:
            lines.append(f"    z : ARRAY[0..{plan.n - 1}] OF DINT;")
            lines += [f"    {text} : DINT;" for text in ("node", "axis", "value")]
            if len(plan.tree.cells.planes):
                lines.append("    i : DINT;")
        else:
            lines += [f"    {step} : DINT;" for step in self.steps]
        lines.append("    wanted : INT;")
        if plan.dwell > 0:
            lines += declared("started : BOOL := FALSE;", "whether there was a call")
            lines += declared("elapsed : LREAL := 0.0;", "time since the last switch [s]")
        return [*lines, "END_VAR"]

    @property
    def _raw(self) -> list[bool]:
        return ((self.plan.scale != 1) | (self.plan.offset != 0)).tolist()

    @property
    def _arrays(self) -> dict[str, np.ndarray]:
        """The tables by name."""
        tree = self.plan.tree.cells
        arrays = [tree.split, tree.threshold, tree.second]
        return dict(zip(TABLES, arrays + [tree.planes.ravel()] * bool(len(tree.planes))))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user must be told."""
        wide = [name for name, values in self._arrays.items() if _wide(values)] * self.table
        return (f"tables of 32-bit numbers (DINT): {', '.join(wide)}",) if wide else ()

    def _tables(self) -> list[str]:
        lines = []
        for name, values in self._arrays.items():
            wide = _wide(values)
            kind = "DINT" if wide else "INT"
            if wide:
                lines.append("    (* numbers beyond 16 bits *)")
            lines.append(f"    {name} : ARRAY[0..{len(values) - 1}] OF {kind} := [")
            text = ", ".join(map(str, values.tolist()))
            lines += textwrap.wrap(
                text, WIDTH - 8, initial_indent=" " * 8, subsequent_indent=" " * 8
            )
            lines[-1] += "];"
        return lines

    @property
    def _label(self) -> str:
        wide = self.plan.tree.cells.threshold.max() > SHORT
        return "DINT_TO_INT(thresholds[node])" if wide else "thresholds[node]"

    def _body(self) -> list[str]:
        plan, domain, lines = self.plan, self.plan.policy.domain, []
        for i, (state, reading) in enumerate(zip(self.states, self.readings)):
            lines.append(f"{state} := {reading};")
            if self._raw[i]:
                lines.append(f"{state} := {state} * ({real(plan.scale[i])});")
                lines.append(f"{state} := {state} + ({real(plan.offset[i])});")
        bounds = [
            f"({state} >= {real(domain.lower[i])}) AND ({state} <= {real(domain.upper[i])})"
            for i, state in enumerate(self.states)
            if not domain.periodic[i]
        ]
        limit = real(LARGEST)
        finite = [f"({state} >= -{limit}) AND ({state} <= {limit})" for state in self.states]
        lines += ["(* a comparison with NaN is false *)"]
        lines += condition("IF NOT (", finite, ") THEN")
        lines += [f"    status := {NOT_FINITE};", f"    wanted := {plan.safe};", "ELSE"]
        lines.append(f"    status := {OK};")
        if bounds:
            lines += condition("    IF NOT (", bounds, ") THEN")
            lines += [f"        status := {OUTSIDE};", "    END_IF;"]
        if plan.nearest or not bounds:
            lines += ["    " + line for line in self._decision()]
        else:
            lines += [f"    IF status = {OK} THEN"]
            lines += ["        " + line for line in self._decision()]
            lines += ["    ELSE", f"        wanted := {plan.safe};", "    END_IF;"]
        lines.append("END_IF;")
        lines += self._dwelling() if plan.dwell > 0 else ["symbol := wanted;"]
        lines.append("CASE symbol OF")
        for k, row in enumerate(plan.policy.controls.tolist()):
            lines.append(f"    {k}:" if k + 1 < plan.labels else "ELSE")
            lines += [f"        {u} := {real(v)};" for u, v in zip(self.controls, row)]
        return [*lines, "END_CASE;"]

    def _decision(self) -> list[str]:
        domain, tree, lines = self.plan.policy.domain, self.plan.tree.cells, []
        for i, (state, count) in enumerate(zip(self.states, tree.counts)):
            box = f"low := {real(domain.lower[i])}, high := {real(domain.upper[i])}"
            if domain.periodic[i]:
                lines.append(f"{state} := {self.calls['wrap']}(x := {state}, {box});")
            step = f"z[{i}]" if self.table else self.steps[i]
            lines.append(f"{step} := {self.calls['step']}(x := {state}, {box}, count := {count});")
        lines = [part for line in lines for part in broken(line, WIDTH - 8)]
        if not self.table:
            call = f"wanted := {self.calls['tree']}({', '.join(self.steps)});"
            return [*lines, *broken(call, WIDTH - 8), *self._gap()]
        lines += ["node := 0;", "axis := splits[0];", "WHILE axis >= 0 DO"]
        if len(tree.planes):
            lines += [f"    IF axis < {tree.n} THEN", "        value := z[axis];", "    ELSE"]
            lines += ["        value := 0;", f"        FOR i := 0 TO {tree.n - 1} DO"]
            lines.append(
                f"            value := value + planes[(axis - {tree.n}) * {tree.n} + i] * z[i];"
            )
            lines += ["        END_FOR;", "    END_IF;"]
        else:
            lines.append("    value := z[axis];")
        lines += ["    IF value >= thresholds[node] THEN", "        node := seconds[node];"]
        lines += ["    ELSE", "        node := node + 1;", "    END_IF;"]
        lines += ["    axis := splits[node];", "END_WHILE;", f"wanted := {self._label};"]
        return lines + self._gap()

    def _gap(self) -> list[str]:
        """Return what makes the label of gaps the safe symbol, and the state outside."""
        if not self.plan.policy.gaps:
            return []
        test = f"IF wanted = {self.plan.gap} THEN"
        outside = [f"    wanted := {self.plan.safe};", f"    status := {OUTSIDE};"]
        return [test, *outside, "END_IF;"]

    def _dwelling(self) -> list[str]:
        """Return the rule of the closed loop for the minimum dwell time."""
        plan = self.plan
        lines = [
            f"(* A control is held for {plan.dwell!r} s at least, rounded up to whole calls, *)",
            "(* whatever the status; a millionth of a call is forgiven for rounding. *)",
            "IF NOT started THEN",
            "    started := TRUE;",
            "    elapsed := 0.0;",
            "    symbol := wanted;",
            "ELSE",
            "    IF cycle > 0.0 THEN",
            "        elapsed := elapsed + cycle;",
            "    END_IF;",
        ]
        if plan.same_control:
            pairs = (f"((wanted = {k}) AND (symbol = {j}))" for k, j in plan.same_control)
            lines += condition("    IF", pairs, "THEN", "OR")
            lines += ["        symbol := wanted;", "    END_IF;"]
        limit = f"{real(plan.dwell)} - 1.0E-6 * cycle"
        lines.append(f"    IF (wanted <> symbol) AND (elapsed >= {limit}) THEN")
        return [
            *lines,
            "        symbol := wanted;",
            "        elapsed := 0.0;",
            "    END_IF;",
            "END_IF;",
        ]


def _wide(values: np.ndarray) -> bool:
    """Return whether numbers need more than 16 bits."""
    return bool(np.abs(values.astype(np.int64)).max() > SHORT)
