"""Dynamics and costs of a model as MathML, which browsers draw without any script.

The MathML is written from the programs themselves, which are trees of known operations already;
LaTeX in between would have to be escaped and parsed again. All names are escaped in one place.
"""

from __future__ import annotations

import html
import itertools
import re
from collections.abc import Iterator, Sequence

from capsyn.explorer.expression import Expression, expressions, number, signed
from capsyn.policies.policy import Policy
from capsyn.programs.model import Model
from capsyn.programs.program import Program

LONGEST = 250
"""Most operations of a program that is shown as a formula."""
MOST_CHARACTERS = 100_000
"""Most characters of MathML of a program that is shown."""
CONDITION, SUM, PRODUCT, CALL, ATOM = range(5)
"""How tightly a formula holds together."""
SMALL = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho - "
    "sigma tau upsilon phi chi psi omega"
).split()
GREEK = {name: chr(0x3B1 + k) for k, name in enumerate(SMALL)}
GREEK |= {name.capitalize(): chr(0x391 + k) for k, name in enumerate(SMALL)}
FUNCTIONS = {
    "log": "ln", "asin": "arcsin", "acos": "arccos", "atan": "arctan", "asinh": "arsinh",
    "acosh": "arcosh", "atanh": "artanh", "fmin": "min", "fmax": "max", "sign": "sgn",
    "fmod": "mod", "remainder": "rem",
}  # fmt: skip
RELATIONS = {"lt": "&lt;", "le": "≤", "eq": "=", "ne": "≠", "gt": "&gt;", "ge": "≥"}
FENCES = {"fabs": "||", "floor": "⌊⌋", "ceil": "⌈⌉"}
THIN = "<mspace width='0.17em'/>"


def formulas(policy: Policy) -> dict[str, list[str]]:
    """Return what a policy's model says, as ``<math>`` elements by topic.

    The topics are ``dynamics``, ``cost``, ``target`` where it is a condition of its own, and
    ``default control`` where that is a law; without a model there are none. In each, what
    abbreviations stand for comes last. A program of more than `LONGEST` operations, or
    `MOST_CHARACTERS` of MathML, is told to be too long.
    """
    if policy.model is None:
        return {}
    names, inputs, model = policy.space.names, policy.alphabet.inputs, policy.model
    side = _rate if model.sample_time is None else _next
    rates = [side(name) for name in policy.domain.names]
    told = "" if policy.exogenous is None else "<mo>,</mo><mi>w</mi>"
    topics = {
        "dynamics": _equations(model.dynamics, rates, (*names, *inputs)),
        "cost": _cost(model, names, told),
    }
    if isinstance(policy.target, Program):
        topics["target"] = _equations(policy.target, [""], names)
    if model.prediction is not None:
        left = [name_mathml(name) for name in inputs]
        topics["default control"] = _equations(model.prediction.law, left, names)
    return {topic: lines for topic, lines in topics.items() if lines}


def name_mathml(name: str) -> str:
    """Return the name of a state or an input in MathML, escaped.

    Greek letters are letters; what follows an underscore, or digits at the end, is a subscript.
    """
    base, below = _split(name)
    return f"<msub>{_letter(base)}{_letter(below)}</msub>" if below else _letter(base)


def _split(name: str) -> tuple[str, str]:
    parts = re.fullmatch(r"([^\W\d_]+)_?(\d+)|([^\W_]+)_([^\W_]+)", name)
    return (parts[1] or parts[3], parts[2] or parts[4]) if parts else (name, "")


def _letter(name: str) -> str:
    if name.isdecimal():
        return f"<mn>{name}</mn>"
    tag = "mi" if name.isalnum() else "mtext"
    return f"<{tag}>{GREEK.get(name, html.escape(name))}</{tag}>"


def _rate(name: str) -> str:
    """Return the left side of a state's equation: a letter with a dot, or d name / dt."""
    base, below = _split(name)
    if len(GREEK.get(base, base)) > 1:
        time = "<mi>d</mi><mi>t</mi>"
        above = f"<mi>d</mi>{THIN}{name_mathml(name)}"
        return f"<mfrac><mrow>{above}</mrow><mrow>{time}</mrow></mfrac>"
    dotted = f"<mover accent='true'>{_letter(base)}<mo>˙</mo></mover>"
    return f"<msub>{dotted}{_letter(below)}</msub>" if below else dotted


def _next(name: str) -> str:
    """Return the left side of a map's equation: the state one sample later."""
    base, below = _split(name)
    if below:
        return f"<msubsup>{_letter(base)}{_letter(below)}<mo>+</mo></msubsup>"
    return f"<msup>{_letter(base)}<mo>+</mo></msup>"


def _math(*parts: str) -> str:
    return f"<math display='block'><mrow>{''.join(parts)}</mrow></math>"


def _equations(program: Program, left: Sequence[str], inputs: Sequence[str]) -> list[str]:
    """Return an equation for each left side, of the first results, and then the abbreviations."""
    if len(program.instructions) > LONGEST:
        return [_too_long(program)]
    wanted, abbreviations = _read(program, len(left), inputs)
    pairs = [*zip(left, wanted), *((name[1], part) for name, part in abbreviations)]
    lines = [
        _math(side, "<mo>=</mo>" if side else "", _render(expression)[0])
        for side, expression in pairs
    ]
    return lines if sum(map(len, lines)) <= MOST_CHARACTERS else [_too_long(program)]


def _too_long(program: Program) -> str:
    operations = f"{len(program.instructions):,} operations"
    return f"<p class='note'>{operations}: too long to be shown as a formula</p>"


def _read(
    program: Program, count: int, inputs: Sequence[str]
) -> tuple[list[Expression], list[tuple[Expression, Expression]]]:
    named: list[Expression] = [("name", name_mathml(name)) for name in inputs]
    return expressions(program, named, program.results[:count], _abbreviations(inputs))


def _abbreviations(taken: Sequence[str]) -> Iterator[Expression]:
    """Yield names that no state or input has: z1, z2, .."""
    letters = {_split(name)[0] for name in taken}
    letter = next(c for c in itertools.chain("zwqrsab", map("z{}".format, itertools.count()))
                  if c not in letters)  # fmt: skip
    for k in itertools.count(1):
        yield ("name", f"<msub><mi>{letter}</mi><mn>{k}</mn></msub>")


def _cost(model: Model, names: Sequence[str], told: str) -> list[str]:
    """Return eq. (3) with the costs that there are, and then these; `told` is beside x in them."""
    running, terminal = model.running_cost, model.terminal_cost
    horizon = "<mrow><msub><mi>t</mi><mn>0</mn></msub><mo>+</mo><mi>T</mi></mrow>"
    end = f"<mrow><mi>x</mi><mo>(</mo>{horizon}<mo>)</mo></mrow>"
    integral = f"<msubsup><mo>∫</mo><msub><mi>t</mi><mn>0</mn></msub>{horizon}</msubsup>"
    along = f"{integral}{_of('ℓ', f'<mi>x</mi>{told}')}{THIN}<mi>d</mi><mi>t</mi>"
    if model.sample_time is not None:
        first = "<mrow><mi>k</mi><mo>=</mo><mn>0</mn></mrow>"
        last = "<mrow><mi>T</mi><mo>−</mo><mn>1</mn></mrow>"
        at = "<msub><mi>x</mi><mi>k</mi></msub>"
        end = "<msub><mi>x</mi><mi>T</mi></msub>"
        along = f"<munderover><mo>∑</mo>{first}{last}</munderover>{_of('ℓ', f'{at}{told}')}"
    both = [
        (running, "ℓ", along),
        (terminal, "m", _of("m", f"{end}{told}")),
    ]
    parts, lines = [], []
    for program, letter, part in both:
        zero = len(program.instructions) <= LONGEST and _read(program, 1, names)[0] == [number(0.0)]
        if not zero:
            parts.append(part)
            lines += _equations(program, [_of(letter, f"<mi>x</mi>{told}")], names)
    return [_math("<mi>J</mi><mo>=</mo>", "<mo>+</mo>".join(parts)), *lines] if parts else []


def _of(letter: str, argument: str) -> str:
    return f"<mrow><mi>{letter}</mi><mo>(</mo>{argument}<mo>)</mo></mrow>"


def _within(expression: Expression, least: int = SUM) -> str:
    """Return an expression, enclosed where it does not hold together enough."""
    return _enclosed(*_render(expression), least)


def _enclosed(text: str, bond: int, least: int) -> str:
    if bond >= least:
        return text
    left, right = "[]" if bond == CONDITION else "()"
    return f"<mrow><mo>{left}</mo>{text}<mo>{right}</mo></mrow>"


def _render(expression: Expression) -> tuple[str, int]:
    """Return an expression in MathML, and how tightly it holds together."""
    kind, *rest = expression
    if kind == "number":
        return _number(rest[0])
    if kind == "name":
        return rest[0], ATOM
    if kind == "sum":
        return _sum(rest[0]), SUM
    if kind == "product":
        order = sorted(rest[0], key=_place)
        times = f"<mo>&#x2062;</mo>{THIN}"
        parts = [_within(part, CALL if k else PRODUCT) for k, part in enumerate(order)]
        return f"<mrow>{times.join(parts)}</mrow>", PRODUCT
    if kind == "fraction":
        return f"<mfrac>{_within(rest[0])}{_within(rest[1])}</mfrac>", CALL
    if kind == "root":
        inner, degree = _within(rest[0]), rest[1]
        if degree == 2:
            return f"<msqrt>{inner}</msqrt>", ATOM
        return f"<mroot>{inner}<mn>{degree}</mn></mroot>", ATOM
    if kind == "power":
        return _power(*rest), CALL
    if kind == "relation":
        relation, left, right = rest
        text = f"<mrow>{_within(left)}<mo>{RELATIONS[relation]}</mo>{_within(right)}</mrow>"
        return text, CONDITION
    if kind == "cases":
        return _cases(*rest), SUM
    return _call(*rest)


def _condition(expression: Expression) -> str:
    """Return a condition; a number holds where it is not 0."""
    text, bond = _render(expression)
    return text if bond == CONDITION else _compared(text, bond, "≠")


def _compared(text: str, bond: int, sign: str) -> str:
    return f"<mrow>{_enclosed(text, bond, SUM)}<mo>{sign}</mo><mn>0</mn></mrow>"


def _number(value: float) -> tuple[str, int]:
    """Return a number with six digits, as a power of ten where it is very large or small."""
    sign, text = "<mo form='prefix'>−</mo>" if value < 0 else "", f"{abs(value):.6g}"
    bond = SUM if sign else ATOM
    if text in ("inf", "nan"):
        return f"<mrow>{sign}<mi>{'∞' if text == 'inf' else text}</mi></mrow>", bond
    mantissa, _, exponent = text.partition("e")
    if not exponent:
        return (f"<mrow>{sign}<mn>{text}</mn></mrow>" if sign else f"<mn>{text}</mn>"), bond
    power = int(exponent)
    raised = f"<mn>{power}</mn>" if power > 0 else f"<mrow><mo>−</mo><mn>{-power}</mn></mrow>"
    times = "" if mantissa == "1" else f"<mn>{mantissa}</mn><mo>⋅</mo>"
    text = f"<mrow>{sign}{times}<msup><mn>10</mn>{raised}</msup></mrow>"
    return text, min(bond, PRODUCT if times else CALL)


def _sum(terms: Sequence[tuple[int, Expression]]) -> str:
    parts = []
    for k, (sign, term) in enumerate(terms):
        minus = "<mo>−</mo>" if k else "<mo form='prefix'>−</mo>"
        parts.append(minus if sign < 0 else "<mo>+</mo>" if k else "")
        parts.append(_within(term, PRODUCT))
    return f"<mrow>{''.join(parts)}</mrow>"


def _place(factor: Expression) -> int:
    """Return where a factor stands in a product: numbers, names, sums, functions."""
    if factor[0] == "power" and factor[1][0] == "call":
        return _place(factor[1])
    if factor[0] == "call":
        return 1 if factor[1] in FENCES else 3
    return {"number": 0, "sum": 2, "cases": 2}.get(factor[0], 1)


def _power(base: Expression, exponent: Expression) -> str:
    raised = _within(exponent)
    single = base[0] == "call" and len(base[2]) == 1 and base[1] not in FENCES
    if single and exponent[0] == "number" and signed(exponent)[0] > 0:
        name = f"<msup><mi>{FUNCTIONS.get(base[1], base[1])}</mi>{raised}</msup>"
        return _applied(name, base[2])
    return f"<msup>{_within(base, ATOM)}{raised}</msup>"


def _applied(name: str, arguments: Sequence[Expression]) -> str:
    texts, bonds = zip(*map(_render, arguments))
    if bonds == (ATOM,):
        return f"<mrow>{name}<mo>&#x2061;</mo>{THIN}{texts[0]}</mrow>"
    inside = "<mo>,</mo>".join(_enclosed(*part, SUM) for part in zip(texts, bonds))
    return f"<mrow>{name}<mo>&#x2061;</mo><mrow><mo>(</mo>{inside}<mo>)</mo></mrow></mrow>"


def _call(operation: str, arguments: Sequence[Expression]) -> tuple[str, int]:
    if operation in FENCES:
        left, right = FENCES[operation][0], FENCES[operation][1]
        fence = "<mo fence='true' form='{}'>{}</mo>".format
        inner = _within(arguments[0])
        return f"<mrow>{fence('prefix', left)}{inner}{fence('postfix', right)}</mrow>", ATOM
    if operation in ("and", "or"):
        sign = "∧" if operation == "and" else "∨"
        sides = (f"<mrow><mo>(</mo>{_condition(part)}<mo>)</mo></mrow>" for part in arguments)
        return f"<mrow>{f'<mo>{sign}</mo>'.join(sides)}</mrow>", CONDITION
    if operation == "not":
        text, bond = _render(arguments[0])
        if bond != CONDITION:
            return _compared(text, bond, "="), CONDITION
        return f"<mrow><mo>¬</mo>{_enclosed(text, bond, ATOM)}</mrow>", CONDITION
    return _applied(f"<mi>{FUNCTIONS.get(operation, operation)}</mi>", arguments), CALL


def _cases(value: Expression, condition: Expression, otherwise: Expression) -> str:
    rows = [(value, f"<mtext>if&#xA0;</mtext>{_condition(condition)}")]
    rows.append((otherwise, "<mtext>otherwise</mtext>"))
    space = "<mspace width='1em'/>"
    lines = "".join(
        f"<mtr><mtd>{_within(part)}</mtd><mtd>{space}{when}</mtd></mtr>" for part, when in rows
    )
    brace = "<mo fence='true' form='prefix'>{</mo>"
    return f"<mrow>{brace}<mtable columnalign='left'>{lines}</mtable></mrow>"
