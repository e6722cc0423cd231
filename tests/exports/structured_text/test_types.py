"""The strict compiler: it takes every export, and refuses what edition 2 does not have."""

import dataclasses
import itertools

import numpy as np
import pytest

from capsyn.cells.split_tree import SplitTree
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text.words import KEYWORDS
from support.exports.c_plans import of_vectors
from support.exports.policies import mixed
from support.trees import random_affine_policy

pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
pytest.importorskip(
    "tree_sitter_iec61131_3_st", reason="tree-sitter-iec61131-3-st is not installed"
)
from support.exports.mutants import CONVERSION, mutants, unmarked  # noqa: E402
from support.exports.siemens import NoScl, to_iec  # noqa: E402
from support.exports.structured_text import (  # noqa: E402
    RESERVED,
    Program,
    Refused,
    check,
    program,
    source,
)

COUNTED = {"scale": [6.5 / 4096, -0.001], "offset": [0, 0.1]}
NUMBERS = list(itertools.product(("LREAL", "REAL"), ("real", "INT", "DINT")))
MATRIX = [(style, *row) for style in ("nested", "table") for row in NUMBERS]


def text_of(style, real, readings, dialect="iec"):
    policy, counts = mixed(), COUNTED
    if style == "cells":
        policy = random_affine_policy(3, True, 3, True)
        counts = {"scale": policy.domain.widths / 4096, "offset": 0.1}
    plan = Plan.of(policy, dwell=0.3, **({} if readings == "real" else counts))
    return source(plan, style=style, real=real, readings=readings, dialect=dialect)


@pytest.mark.parametrize("style, real, readings", [*MATRIX, *(("cells", *r) for r in NUMBERS)])
def test_every_sixth_error_is_refused(style, real, readings):
    """Of the six kinds of numbers and readings each has a sixth of the errors."""
    text = text_of(style, real, readings)
    interface, count = Program(text).interface(), 0
    first = NUMBERS.index((real, readings))
    for what, wrong in itertools.islice(mutants(text), first, None, 6):
        count += 1
        try:
            found = Program(wrong).interface()
        except (Refused, OverflowError):
            continue
        assert found != interface, f"{what} is taken"  # else it shows at the first connection
    assert count > 57


def test_tables_of_dint_are_converted_back():
    cells = mixed().cells
    threshold = np.where(cells.split == 0, 40_000, cells.threshold).astype(np.int32)
    cells = SplitTree((1 << 17, 8), cells.split, threshold, cells.second, cells.planes)
    text = source(Plan.of(dataclasses.replace(mixed(), cells=cells)), style="table")
    Program(text)
    found = [what for what, wrong in mutants(text) if "_TO_" in what and not refused(wrong)]
    assert not found and text.count(b"DINT_TO_INT(thresholds[node])") == 1


def refused(text):
    try:
        Program(text)
    except (Refused, OverflowError):
        return True
    return False


def test_every_conversion_occurs():
    texts = [text_of(*row).decode() for row in MATRIX]
    used = {found[0] for text in texts for found in CONVERSION.finditer(text)}
    assert used == {"INT_TO_DINT", "DINT_TO_LREAL"}
    assert not [text for text in texts if "CONSTANT" in text or "ELSIF" in text]


def test_names_that_are_refused_are_never_given():
    assert RESERVED <= KEYWORDS


@pytest.mark.parametrize("style", ["nested", "table", "cells"])
def test_a_block_has_no_name_of_its_variables(style):
    policy = random_affine_policy(3) if style == "cells" else mixed()
    for name in "symbol status cycle wanted node z rest value splits started z0 faces0".split():
        Program(source(Plan.of(policy, dwell=0.3), style=style, name=name))
    for name in ("entries", "row", "most", "within"):
        Program(source(Plan.of(policy, dwell=0.3), style=style, name=name))


@pytest.mark.parametrize("dialect", ["iec", "siemens"])
@pytest.mark.parametrize("style", ["nested", "table", "cells"])
@pytest.mark.parametrize(
    "names", ["Wanted value i", "z0 wanted node", "first z1 axis", "last splits wanted"]
)
def test_variables_give_way_to_names_of_users(style, names, dialect):
    policy = random_affine_policy(3) if style == "cells" else mixed()
    *axes, control = names.split()
    inputs = [control, *policy.alphabet.inputs[1:]]
    changed = dataclasses.replace(
        policy,
        domain=dataclasses.replace(policy.domain, names=axes),
        alphabet=dataclasses.replace(policy.alphabet, inputs=inputs),
    )
    plan = Plan.of(changed, dwell=0.3)
    options = {"style": style, "dialect": dialect}
    made = program(plan, **options)
    assert [name for name, _ in made.interface()[:2]] == [name.lower() for name in axes]
    assert made.block.outputs[2] == control
    text = source(plan, **options).decode()
    assert not any(f"Renamed: '{name}'" in text for name in names.split())
    plain = Plan.of(policy, dwell=0.3)
    some = of_vectors(golden_vectors(plain), slice(None, None, 7))
    assert check(plan, some, **options) == check(plain, some, **options)


@pytest.mark.parametrize("style", ["nested", "table"])
def test_unmarked_names_are_no_scl(style):
    text, count = text_of(style, "LREAL", "real", "siemens"), 0
    Program(to_iec(text))
    for wrong in unmarked(text):
        count += 1
        with pytest.raises((NoScl, Refused, ValueError)):
            Program(to_iec(wrong))
    assert count > 100
    for found in CONVERSION.finditer(text.decode()):
        wrong = text[: found.start()] + text[found.end() :]
        with pytest.raises((NoScl, Refused)):
            Program(to_iec(wrong))


BLOCK = """\
FUNCTION half : DINT
VAR_INPUT
    x : DINT;
END_VAR
half := x / 2;
END_FUNCTION
FUNCTION_BLOCK b
VAR_INPUT
    x : LREAL;
    k : DINT;
    t : TIME;
END_VAR
VAR_OUTPUT
    y : LREAL;
END_VAR
VAR
    a : ARRAY[0..2] OF INT := [1, -2, 3];
    on : BOOL := FALSE;
END_VAR
{}
y := x;
END_FUNCTION_BLOCK
"""
BLOCK = BLOCK.replace("    on :", "    on_ :").replace("on_", "is_on")
READS = "IF is_on AND (a[0] > 0) THEN y := 0.0; END_IF;"


@pytest.mark.parametrize(
    "statement",
    [
        "y := half(x := k);",
        "y := 1;",
        "is_on := k;",
        "is_on := (x = k);",
        "is_on := x AND is_on;",
        "k := 1;",
        "y := x + k;",
        "y := LREAL_TO_REAL(x);",
        "y := DINT_TO_LREAL(a[0]);",
        "y := DINT_TO_LREAL(half(k));",
        "y := DINT_TO_LREAL(half(x := a[0]));",
        "y := DINT_TO_LREAL(half());",
        "y := DINT_TO_LREAL(quarter(x := k));",
        "y := 5.;",
        "y := .5;",
        "y := 1E5;",
        "y := 4.0E38;",
        "y := 1.0E-40;",
        "a[3] := 1;",
        "a[x] := 1;",
        "a := 1;",
        "a[0] := 32768;",
        "y[0] := 1.0;",
        "is_on := t > 5;",
        "is_on := (t * 2) > T#1s;",
        "is_on := t > T#1d500ms;",
        "is_on := is_on = TRUE;",
        "IF k THEN y := 1.0; END_IF;",
        "IF is_on THEN y := 1.0; END_IF",
        "IF is_on THEN END_IF;",
        "WHILE k DO y := 1.0; END_WHILE;",
        "FOR x := 0 TO 3 DO y := 1.0; END_FOR;",
        "CASE x OF 0: y := 1.0; END_CASE;",
        "CASE k OF 0: y := 1.0; 0: y := 2.0; END_CASE;",
        "z := 1.0;",
        "EXIT;",
        "RETURN;",
        ";",
        "(* one (* two *) *)",
    ],
)
def test_statements_that_are_refused(statement):
    Program(BLOCK.format(READS).encode())
    with pytest.raises((Refused, OverflowError)):
        Program(BLOCK.format(f"{READS}\n{statement}").encode())


@pytest.mark.parametrize(
    "old, new",
    [
        ("is_on", "on"),
        ("is_on", "is__on"),
        ("is_on", "is_on_"),
        ("is_on", "limit"),
        ("is_on", "half"),
        ("is_on", "b"),
        ("is_on", "TON"),
        ("is_on", "int_to_dint"),
        ("is_on : BOOL := FALSE;", "is_on : BOOL := FALSE; spare : DINT;"),
        ("is_on : BOOL", "is_on : BIT"),
        ("ARRAY[0..2]", "ARRAY[1..3]"),
        ("VAR\n", "VAR CONSTANT\n"),
        ("VAR\n", "VAR_TEMP\n"),
        ("VAR_INPUT\n    x : DINT;\nEND_VAR\n", ""),
        ("half := x", "END_VAR\nhalf := x"),
        ("END_VAR\nhalf", "END_VAR\nVAR\n    s : ARRAY[0..1] OF DINT;\nEND_VAR\nhalf"),
        ("half := x / 2;", "half := half + x;"),
        ("half := x / 2;", "IF x > 1 THEN x := 2; END_IF;"),
        ("half := x / 2;", "half := b(x := x);"),
    ],
)  # fmt: skip
def test_declarations_that_are_refused(old, new):
    text = BLOCK.format(READS)
    assert old in text
    with pytest.raises((Refused, OverflowError)):
        Program(text.replace(old, new).encode())


def test_functions_are_called_after_they_are_defined():
    text = text_of("nested", "LREAL", "real").decode()
    start = text.index("FUNCTION mixed_tree")
    end = text.index("END_FUNCTION\n", start) + len("END_FUNCTION\n")
    with pytest.raises(Refused):
        Program((text[:start] + text[end:] + text[start:end]).encode())


def test_running_checks_ranges_and_rounds():
    text = BLOCK.format(READS).replace("y := x;", "y := DINT_TO_LREAL(half(x := k) + k) + x;")
    call = Program(text.encode()).instance()
    assert call(0.1, 7, 0)["y"] == 10.1
    assert call(0.0, -7, 0)["y"] == -10  # integers are divided towards 0
    with pytest.raises(OverflowError):
        call(0.0, 2**31 - 1, 0)
    single = Program(BLOCK.format(READS).replace("LREAL", "REAL").encode()).instance()
    assert single(0.1, 0, 0)["y"] == 0.10000000149011612
