"""Formulas in MathML: read back and evaluated against the programs that they show."""

import dataclasses
import math
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import Phase, given, settings

from capsyn import Alphabet, Box, Problem, problems
from capsyn.explorer.formulas import LONGEST, MOST_CHARACTERS, formulas, name_mathml
from capsyn.modelling.transcription import transcribe, transcribe_target
from capsyn.policies.policy import Policy
from capsyn.programs.program import Program
from support.random_programs import random_program
from support.trees import random_policy, random_tree

NAMES = {"x1": "x", "x2": "y", "x3": "w"}
FUNCTIONS = {
    "sin": math.sin, "cos": math.cos, "tanh": math.tanh, "arctan": math.atan, "min": min,
    "max": max, "atan2": math.atan2, "sgn": np.sign, "copysign": math.copysign,
    "arsinh": math.asinh,
}  # fmt: skip
OPERATIONS = tuple(
    "add sub mul mul div neg sqrt fabs floor ceil copysign sign fmin fmax select lt le eq ne not "
    "and or exp log pow sin cos atan atan2 tanh asinh hypot".split()
)
SIGNS = {
    "\u2062": "*", "−": "-", "⋅": "*", "≤": "<=", "≥": ">=", "≠": "!=", "=": "==", "[": "1.0*(",
    "]": ")", "∧": " and ", "∨": " or ", "¬": " not ",
}  # fmt: skip


def python_of(element):
    """Return a MathML element as a Python expression, by what a reader takes it for."""
    children = list(element)
    if element.tag in ("mi", "mtext"):
        return element.text
    if element.tag == "mn":
        return repr(float(element.text))
    if element.tag == "mo":
        return SIGNS.get(element.text, element.text)
    if element.tag == "mspace":
        return ""
    if element.tag == "mfrac":
        return "(({})/({}))".format(*map(python_of, children))
    if element.tag == "msqrt":
        return f"root(({''.join(map(python_of, children))}), 2)"
    if element.tag == "mroot":
        return "root(({}), {})".format(*map(python_of, children))
    if element.tag == "mover":
        return f"rate of {python_of(children[0])}"
    if element.tag == "msub":
        return "".join(python_of(child).removesuffix(".0") for child in children)
    if element.tag == "msup":
        return "({})**({})".format(*map(python_of, children))
    assert element.tag == "mrow", element.tag
    texts = [child.text for child in children]
    if "\u2061" in texts:
        name, arguments = children[0], children[-1]
        inner = python_of(arguments)
        inner = inner if inner.startswith("(") else f"({inner})"
        if name.tag == "msup":
            return f"({python_of(name[0])}{inner})**({python_of(name[1])})"
        return python_of(name) + inner
    if texts[0] in ("|", "⌊", "⌈"):
        name = {"|": "abs", "⌊": "math.floor", "⌈": "math.ceil"}[texts[0]]
        return f"float({name}({''.join(map(python_of, children[1:-1]))}))"
    if texts[0] == "{":
        rows = [[list(cell) for cell in row] for row in children[1]]
        (value,), (other,) = rows[0][0], rows[1][0]
        condition = rows[0][1][2]
        return f"(({python_of(value)}) if ({python_of(condition)}) else ({python_of(other)}))"
    # in a sum or a product, a power belongs to what stands before it
    return "".join(python_of(child) for child in children)


def read_back(lines, count, values):
    """Return what the first equations give with values by name; the rest are abbreviations."""

    def root(x, degree):
        return math.nan if x < 0 else x ** (1 / degree)

    known = {"root": root, "math": math, "e": math.e, **FUNCTIONS, **values}
    known["ln"] = lambda x: math.log(x) if x > 0 else (-math.inf if x == 0 else math.nan)
    sides = []
    for line in lines:
        row = ElementTree.fromstring(line)[0]
        equals = next((k for k, child in enumerate(row) if child.text == "="), -1)
        left = "".join(python_of(c) for c in list(row)[: max(equals, 0)]) if equals > 0 else ""
        right = ElementTree.Element("mrow")
        right.extend(list(row)[equals + 1 :])
        sides.append((left, "".join(python_of(child) for child in right)))
    for name, text in sides[count:]:
        known[name] = eval(text, known)
    return [float(eval(text, known)) for _, text in sides[:count]]


def tame(program):
    """Return a program with constants of a few digits."""
    rows = tuple(
        ("const", {1 / 3: 0.25, 1e200: 3.5, math.inf: 7.0}.get(row[1], row[1]))
        if row[0] == "const"
        else row
        for row in program.instructions
    )
    return dataclasses.replace(program, instructions=rows)


class Read:
    """How many results were compared."""

    count = 0


@settings(max_examples=200, phases=[Phase.generate], deadline=None, derandomize=True, database=None)
@given(random_program(OPERATIONS))
def compare(program):
    program = tame(program)
    policy = with_dynamics(program)
    lines = formulas(policy)["dynamics"]
    everything = tuple(range(program.input_count + len(program.instructions)))
    whole = dataclasses.replace(program, outputs=(("all", len(everything)),), results=everything)
    for x in ([0.7, -1.3, 2.1], [-0.45, 0.2, 0.9], [1.9, 3.3, -0.6]):
        values = whole.evaluate(np.array(x))[0]
        if not np.isfinite(values).all() or abs(values).max() > 1e4:
            continue
        cut = [k for k, row in enumerate(program.instructions, 3) if row[0] in ("floor", "ceil")]
        if any(abs(values[k] - v) < 1e-9 for k in cut for v in values[:k]):
            continue
        expected = values[list(program.results[:2])]
        try:
            read = read_back(lines, len(expected), dict(zip("xyw", x)))
        except (ZeroDivisionError, OverflowError):
            continue  # what is left out of a product with 0, or in the other case
        np.testing.assert_allclose(read, expected, rtol=1e-5, atol=1e-5 * (1 + abs(values).max()))
        Read.count += 1


def test_formulas_say_what_programs_do():
    compare()
    assert Read.count > 200, Read.count


def with_dynamics(program):
    """Return a policy of states x and y and input w, with a program for its dynamics, no costs."""
    box = Box([0, 0], [1, 1], names=["x", "y"])
    zero = Program("zero", (("x", 2),), (("cost", 1),), (("const", 0.0),), (2,))
    model = dataclasses.replace(
        transcribe(problems.plain("cart-pendulum")),
        dynamics=program,
        running_cost=zero,
        terminal_cost=zero,
    )
    alphabet = Alphabet([-1.0, 1.0], inputs=["w"])
    return Policy("p", box, alphabet, 0.0, random_tree((1, 1), (2, 2), 0), model=model)


def plain(line):
    """Return the text of a formula, with fractions as (a)/(b), and powers and subscripts marked."""
    marks = {"mfrac": ")/(", "msup": "^", "msub": "_", "mover": ""}

    def text(element):
        inner = [text(child) for child in element]
        if element.tag == "mfrac":
            return f"({inner[0]})/({inner[1]})"
        if element.tag in marks:
            return marks[element.tag].join(inner)
        if element.tag == "mroot":
            return f"root{inner[1]}({inner[0]})"
        return (element.text or "") + "".join(inner)

    words = text(ElementTree.fromstring(line))
    return words.replace("\u2062", " ").replace("\u2061", " ").replace("\u02d9", "'")


def model_only(problem):
    """Return a policy of one cell with the model of a problem."""
    n = problem.space.n
    tree = random_tree((1,) * n, (2,) * n, 0)
    return Policy(
        problem.name, problem.domain, problem.alphabet, problem.default_control, tree,
        model=transcribe(problem), target=transcribe_target(problem), exogenous=problem.exogenous,
    )  # fmt: skip


BUILT_IN = {
    "cart-pendulum": {
        "dynamics": ["θ'=ω", "ω'=(9.81 sin θ+acceleration cos θ)/(2)"],
        "cost": ["J=m(x(t_0+T))", "m(x)=0.5 (2 ω^2+19.62 (cos θ−1))^2"],
        "target": ["|2 ω^2+19.62 (cos θ−1)|≤1.962"],
    },
    "double-tank-a": {
        "dynamics": [
            "x'_1=V_1−(V_2 z_1)/(root4(z_1^2+10^−12))",
            "x'_2=(V_2 z_1)/(root4(z_1^2+10^−12))−(V_3 x_2)/(root4(x_2^2+10^−12))",
            "z_1={x_1−x_2+0.5if\xa0x_2>0.5x_1otherwise",
        ],
        "cost": [
            "J=∫t_0t_0+Tℓ(x)dt+m(x(t_0+T))",
            "ℓ(x)=(x_1−0.8)^2+(x_2−0.2)^2",
            "m(x)=100 ((x_1−0.8)^2+(x_2−0.2)^2)",
        ],
    },
    "cart-pole": {
        "dynamics": ["x'=v", "v'=acceleration", "θ'=ω", "ω'=(9.81 sin θ+acceleration cos θ)/(2)"],
        "cost": ["J=∫t_0t_0+Tℓ(x)dt", "ℓ(x)=x^2+0.5 v^2+10 θ^2+ω^2"],
    },
}


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_problems_look_as_in_a_text(name):
    shown = formulas(model_only(problems.plain(name)))
    assert {topic: [plain(line) for line in lines] for topic, lines in shown.items()} == (
        BUILT_IN[name]
    )


def test_every_built_in_problem_has_formulas():
    for name in problems.names():
        assert set(formulas(model_only(problems.plain(name)))) >= {"dynamics", "cost"}


HOSTILE = ["<script>alert(1)</script>", "a & b", "\"'><img src=x onerror=alert(1)>", "</math>"]


def test_names_are_escaped():
    problem = Problem(
        name="hostile",
        dynamics=lambda x, u: [x[1] * u[0], x[2] / x[0], x[0] + u[0], x[3] ** 2],
        domain=Box([0] * 4, [1] * 4, names=HOSTILE),
        alphabet=Alphabet([0.0, 1.0], inputs=["</mtext><script>"]),
        default=0.0,
        horizon=1.0,
        running_cost=lambda x: x[0] * x[1] + x[2] * x[3],
    )
    allowed = set(
        "math mrow mi mn mo mtext mspace mfrac msqrt mroot msub msup msubsup mover".split()
    )
    for lines in formulas(model_only(problem)).values():
        for line in lines:
            elements = list(ElementTree.fromstring(line).iter())
            assert {element.tag for element in elements} <= allowed
            names = {"display", "accent", "width", "form", "fence"}
            assert {key for element in elements for key in element.attrib} <= names
            assert "<script" not in line and "<img" not in line
    assert "&lt;script&gt;" in formulas(model_only(problem))["dynamics"][0]


def test_names_of_states():
    assert name_mathml("theta") == "<mi>θ</mi>" and name_mathml("Omega") == "<mi>Ω</mi>"
    assert name_mathml("lambda") == "<mi>λ</mi>" and name_mathml("omicron") == "<mi>ο</mi>"
    assert name_mathml("x1") == "<msub><mi>x</mi><mn>1</mn></msub>"
    assert name_mathml("phi_dot") == "<msub><mi>φ</mi><mi>dot</mi></msub>"
    assert name_mathml("cart position") == "<mtext>cart position</mtext>"
    assert name_mathml("a<b") == "<mtext>a&lt;b</mtext>"


def test_abbreviations_have_names_of_their_own():
    program = Program(
        "p",
        (("x", 2), ("u", 1)),
        (("xdot", 2),),
        (("lt", 0, 1), ("select", 3, 0), ("sin", 4), ("mul", 5, 2)),
        (6, 5),
    )
    policy = with_dynamics(program)
    box = Box([0, 0], [1, 1], names=["z1", "w_2"])
    lines = formulas(dataclasses.replace(policy, domain=box))["dynamics"]
    assert [plain(line) for line in lines] == [
        "z'_1=w sin q_1",
        "w'_2=sin q_1",
        "q_1={z_1if\xa0z_1<w_20otherwise",
    ]


def test_numbers_are_short():
    rows = [("const", v) for v in (1 / 3, -2.5e-9, 1e21, math.pi)]
    rows += [("mul", 0, 3), ("add", 7, 4), ("mul", 1, 5), ("sub", 8, 9), ("pow", 0, 6)]
    program = Program("p", (("x", 2), ("u", 1)), (("xdot", 2),), tuple(rows), (10, 11))
    first, second = formulas(with_dynamics(program))["dynamics"]
    assert plain(first) == "x'=0.333333 x−10^21 y−2.5⋅10^−9"
    assert plain(second) == "y'=x^3.14159"


def test_long_programs_are_told_and_missing_models_have_none():
    rows = [("sin", 0), *(("sin", k) for k in range(3, 3 + LONGEST))]
    program = Program("p", (("x", 2), ("u", 1)), (("xdot", 2),), tuple(rows), (3, 3 + LONGEST))
    assert "251 operations: too long" in formulas(with_dynamics(program))["dynamics"][0]
    assert formulas(random_policy(3)) == {}
    rows = rows[:LONGEST]
    program = dataclasses.replace(program, instructions=tuple(rows), results=(3, 2 + LONGEST))
    assert len(formulas(with_dynamics(program))["dynamics"]) >= 2


@pytest.mark.parametrize("operation", ["fmin", "add", "mul", "pow", "and", "hypot", "div"])
@pytest.mark.parametrize("last", [True, False])
def test_formulas_of_files_that_mean_harm_stay_small(operation, last):
    rows = [(operation, 0, 0), *((operation, k, k if last else 1) for k in range(3, 2 + LONGEST))]
    program = Program("p", (("x", 2), ("u", 1)), (("xdot", 2),), tuple(rows), (3, 2 + LONGEST))
    assert sum(map(len, formulas(with_dynamics(program))["dynamics"])) <= MOST_CHARACTERS


def test_huge_exponents_are_left_as_they_are():
    rows = [("const", 1e308), ("pow", 0, 3), ("mul", 4, 4), ("mul", 5, 5)]
    program = Program("p", (("x", 2), ("u", 1)), (("xdot", 2),), tuple(rows), (6, 6))
    assert "10" in formulas(with_dynamics(program))["dynamics"][0]


def test_shared_parts_are_not_written_out_again_and_again():
    rows = [("add", 0, 1), ("sin", 3)]
    for k in range(4, 64, 2):
        rows += [("cos", k), ("mul", k, k + 1)]
    program = Program("p", (("x", 2), ("u", 1)), (("xdot", 1),), tuple(rows), (2 + len(rows),))
    lines = formulas(with_dynamics(program))["dynamics"]
    assert len(lines) > 3 and sum(map(len, lines)) < 20_000
