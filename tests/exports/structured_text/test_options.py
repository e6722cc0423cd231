"""Options of Structured Text: numbers, readings, dialects, and policies with nothing to decide."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from capsyn import Alphabet, Box, Policy
from capsyn.errors import ProblemError
from capsyn.exports.c.readings.single import decide_single
from capsyn.exports.export import export
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Plan
from capsyn.exports.structured_text import target
from capsyn.exports.structured_text.cuts import cut
from capsyn.exports.structured_text.target import TARGET
from support.exports.policies import built_in, mixed, oblique
from support.trees import random_affine_policy, random_policy, random_tree

pytest.importorskip("tree_sitter", reason="tree-sitter is not installed")
pytest.importorskip(
    "tree_sitter_iec61131_3_st", reason="tree-sitter-iec61131-3-st is not installed"
)
from support.exports.structured_text import Program, check, program, source  # noqa: E402

STYLES, DIALECTS = ("nested", "table"), ("iec", "siemens")
NUMBERS = list(itertools.product(("LREAL", "REAL"), ("real", "INT", "DINT")))
MATRIX = [
    (style, *row, DIALECTS[(i + j + j // 3) % 2])
    for i, style in enumerate(STYLES)
    for j, row in enumerate(NUMBERS)
]
"""Each two of these options in every way: a style has each dialect with each kind of numbers."""
OF_CELLS = [
    ("cells", *row, dialect, (i + j + j // 3) % 2 == 0)
    for i, dialect in enumerate(DIALECTS)
    for j, row in enumerate(NUMBERS)
]
"""Likewise, with whether cells are split along some axes alone."""
NAMES = ("style", "real", "readings", "dialect")


def counted(policy, bits=12):
    """Return scale and offset of counts: rising and falling, whole turns."""
    widths = policy.domain.widths
    sign = np.where(np.arange(len(widths)) % 2, -1, 1)
    return {"scale": sign * widths / 2**bits, "offset": 0.3 * widths}


@pytest.mark.parametrize("row", MATRIX, ids="-".join)
def test_every_option_gives_every_symbol_and_control(row):
    options = dict(zip(NAMES, row))
    plan = Plan.of(mixed(), **({} if row[2] == "real" else counted(mixed())))
    count, seen = check(plan, **options)
    assert count >= 2000 and seen == {0, 1, 2, 3}


@pytest.mark.parametrize("row", OF_CELLS, ids=lambda row: "-".join(map(str, row)))
def test_every_option_gives_every_symbol_of_affine_leaves(row):
    options, policy = dict(zip(NAMES, row)), random_affine_policy(3, True, 3, row[-1])
    plan = Plan.of(policy, **({} if row[2] == "real" else counted(policy)))
    count, seen = check(plan, **options)
    assert count >= 2000 and len(seen) >= len(policy.alphabet)


@pytest.mark.parametrize("readings", ["real", "INT", "DINT"])
@pytest.mark.parametrize("grid", [1, 3, 7])
def test_random_policies_in_single_precision_and_of_counts(grid, readings):
    policy = random_policy(grid, periodic=True, seed=grid)
    for style, dialect in zip(STYLES, DIALECTS):
        plan = Plan.of(policy, **({} if readings == "real" else counted(policy)))
        real = "REAL" if readings == "real" else "LREAL"
        check(plan, style=style, dialect=dialect, real=real, readings=readings)


def test_states_many_turns_away_in_single_precision():
    policy = random_policy(1, periodic=True)
    rng = np.random.default_rng(1)
    far = policy.domain.sample(200, 1) * 10.0 ** rng.uniform(0, 40, (200, policy.domain.n))
    plan = Plan.of(policy)
    golden = decide_single(plan, far)
    assert set(golden.statuses) == {0, 2}  # some are infinite as REAL
    for style in STYLES:
        check(plan, golden, style=style, real="REAL")


def test_turns_that_are_no_power_of_two():
    policy = random_policy(3, periodic=True)
    scale = policy.domain.widths / [1000, 3000]
    for readings in ("INT", "DINT"):
        check(Plan.of(policy, scale=scale, offset=[0.1, 0.2]), readings=readings)
        check(Plan.of(policy, scale=-scale, offset=[0.1, 0.2]), readings=readings)
    text = source(Plan.of(policy, scale=scale), readings="INT", style="table").decode()
    assert "(* A turn of 'x2' is 3000 counts; others are brought into one. *)" in text
    assert "Target structured-text: table, numbers LREAL, readings INT, dialect iec." in text


def test_nearest_and_scaled_in_single_precision():
    policy = dataclasses.replace(random_policy(3), outside="nearest")
    for style in STYLES:
        check(Plan.of(policy, scale=[0.1, -3e-5], offset=[0.3, 1e-3]), style=style, real="REAL")
        check(Plan.of(policy, **counted(policy)), style=style, readings="INT")


def test_single_precision_counts_the_states_that_it_moves():
    policy = built_in("cart-pendulum")
    plan = Plan.of(policy)
    exported = TARGET.files(plan, golden_vectors(plan), real="REAL")
    assert 0 <= exported.changed < 1e-3
    assert exported.files["cart_pendulum.st"].count(f"{exported.changed:.3%}".encode()) == 1
    readings = exported.golden.readings
    np.testing.assert_array_equal(readings, readings.astype(np.float32))
    assert TARGET.files(plan, golden_vectors(plan)).changed is None
    for style in STYLES:
        check(plan, style=style, real="REAL")


def one_cell(labels=2, **fields):
    """Return a policy of one cell along a periodic and a bounded axis."""
    box = Box([0, -1], [6.5, 1], periodic=[True, False])
    cells = random_tree((1, 1), (2, 2), 0, leaf_count=labels)
    names = [str(k) for k in range(labels)]
    alphabet = Alphabet(np.arange(labels, dtype=float), names=names)
    return Policy("one", box, alphabet, np.array([0.5]), cells, **fields)


@pytest.mark.parametrize("row", MATRIX, ids="-".join)
def test_helpers_are_left_out_where_nothing_calls_them(row):
    options = dict(zip(NAMES, row))
    for policy, dwell in ((one_cell(), 0.1), (one_cell(1), 0), (one_cell(outside="nearest"), 0)):
        plan = Plan.of(policy, dwell=dwell, **({} if row[2] == "real" else counted(policy)))
        check(plan, **options)
        assert set(program(plan, **options).units) == {"one"}
        assert not re.search(rb"\bz|\bfirst\b|\bnode\b", source(plan, **options))


def test_axes_that_are_never_compared_have_no_steps():
    policy = random_policy(4, periodic=True)  # of two partitions and one
    cells = random_tree((4, 1), (2, 1), 0, leaf_count=3)
    policy = dataclasses.replace(policy, cells=cells)
    for style, real in itertools.product(STYLES, ("LREAL", "REAL")):
        plan = Plan.of(policy)
        check(plan, style=style, real=real)
        text = source(plan, style=style, real=real)
        assert b"_wrap" not in text and b"z1" not in text and b"z[1]" not in text


def terms(text, names):
    """Return factors and bound of a condition."""
    left, right = text.removeprefix("about ").split(" >= ")
    factors = np.zeros(len(names))
    for sign, factor, name in re.findall(r"(-|\+)? ?(?:([\d.e-]+) \* )?([a-z]\w*)", left):
        factors[names.index(name)] = float(factor or 1) * (-1 if sign == "-" else 1)
    return factors, float(right.split()[0])


@pytest.mark.parametrize("make", [mixed, oblique])
def test_splits_are_told_in_states(make):
    plan = Plan.of(make())
    tree, domain = plan.tree.cells, plan.policy.domain
    states = domain.sample(5000)
    steps = domain.locate(states, tree.counts)
    inner = np.flatnonzero(tree.split != -1)
    for node in inner.tolist():
        text = cut(plan, node)
        factors, bound = terms(text.replace("<=", ">="), domain.names)
        value, _ = tree._compared(np.full(5000, node), steps, steps, np.arange(5000))
        told = states @ factors <= bound if "<=" in text else states @ factors >= bound
        assert abs(factors).max() >= 1
        exact = tree.split[node] < tree.n
        assert (told == (value >= tree.threshold[node])).mean() > (1 - 1e-9 if exact else 0.9)
        for style in STYLES:
            assert text in " ".join(source(plan, style=style).decode().split())


def test_units_stand_beside_bounds():
    text = source(Plan.of(mixed())).decode()
    assert "(* angle >= 1.21875 rad *)\n    IF z0 >= 3 THEN" in text
    assert "(* about angle <= 4.062 rad *)\n" in text  # a step is 0.40625 rad
    assert re.search(r"\(\* about angle - 2.438 \* rate >= \S+ rad \*\)\nIF 2 \* z0 - 3", text)
    assert "Split 2 from 1 on: about angle" in source(Plan.of(mixed()), style="table").decode()


def sections(pou):
    """Return the declarations of a unit in XML as lines of text."""
    words = {"input_vars": "VAR_INPUT", "output_vars": "VAR_OUTPUT", "local_vars": "VAR"}
    for kind, word in words.items():
        for declared in getattr(pou.interface, kind):
            yield word
            for variable in declared.variable:
                yield f"    {variable.name} : {kind_of(variable.type)}{start(variable)};"
            yield "END_VAR"


def kind_of(data):
    if data.array is not None:
        (dimension,) = data.array.dimension
        ends = f"{dimension.lower}..{dimension.upper}"
        return f"ARRAY[{ends}] OF {kind_of(data.array.base_type)}"
    (kind,) = (name for name, value in vars(data).items() if value is not None)
    return kind.removesuffix("_value").upper()


def start(variable):
    value = variable.initial_value
    if value is None:
        return ""
    if value.array_value is not None:
        return f" := [{', '.join(v.simple_value.value for v in value.array_value.value)}]"
    return f" := {value.simple_value.value}"


@pytest.mark.parametrize("style", STYLES)
def test_xml_has_the_same_units(style):
    plcopen = pytest.importorskip("plcopen", reason="plcopen is not installed")
    from xsdata.formats.dataclass.parsers import XmlParser

    plan = Plan.of(mixed(), dwell=0.3)
    files = TARGET.files(plan, golden_vectors(plan), style=style).files
    assert set(files) == {"mixed.st", "mixed.xml"}
    project = XmlParser().from_bytes(files["mixed.xml"], plcopen.Project)
    text, bodies = [], []
    for pou in project.types.pous.pou:
        word = {"function": "FUNCTION", "functionBlock": "FUNCTION_BLOCK"}[pou.pou_type.value]
        result = pou.interface.return_type
        text += [f"{word} {pou.name}{f' : {kind_of(result)}' if result else ''}", *sections(pou)]
        body = pou.body[0].st.w3_org_1999_xhtml_element
        assert body.qname == "{http://www.w3.org/1999/xhtml}p"
        text += [*body.text.splitlines(), f"END_{word}"]
        bodies.append(body.text)
    units = re.findall(r"^FUNCTION.*?^END_FUNCTION", files["mixed.st"].decode(), re.M | re.S)
    assert bodies == [re.split(r"END_VAR\n(?!VAR)", unit)[1][:-13] for unit in units]
    made, told = Program("\n".join(text).encode()), Program(files["mixed.st"])
    assert made.interface() == told.interface() and list(made.units) == list(told.units)
    for name, unit in made.units.items():
        same = told.units[name]
        assert (unit.kinds, unit.arrays, unit.start) == (same.kinds, same.arrays, same.start)
    assert plan.header[0] in files["mixed.xml"].decode()


def test_siemens_has_one_file_and_no_xml(tmp_path):
    paths = export(mixed(), "structured-text", tmp_path, dialect="siemens")
    assert {path.name for path in paths} == {"mixed.scl", "golden.csv", "certificate.json"}


def refused(message, policy=None, **options):
    plan = {k: options.pop(k) for k in ("scale", "offset") if k in options}
    with pytest.raises(ProblemError, match=message) as error:
        source(Plan.of(mixed() if policy is None else policy, **plan), **options)
    assert "\n" not in str(error.value)


def test_what_cannot_be_exported(monkeypatch):
    refused("`real` must be", real="real")
    refused("`readings` must be", readings="int16")
    refused("`dialect` must be", dialect="codesys")
    huge = dataclasses.replace(random_policy(1), domain=Box([0], [1e40]))
    refused("needs bounds of axis 'x1' between 1.2e-38 and 3.4e.38 in size, or 0; got 1e", huge)
    small = dataclasses.replace(random_policy(1), domain=Box([1e-42], [1]))
    refused("needs bounds of axis 'x1' between", small)
    narrow = dataclasses.replace(random_policy(1), domain=Box([1e6], [1e6 + 0.5]))
    refused(
        "`real` REAL does not tell the .* steps of axis 'x1', in .*; take LREAL",
        narrow,
        real="REAL",
    )
    refused("`readings` INT does not reach every step of axis 'rate'.*take DINT",
            scale=[6.5 / 4096, 1e-6], readings="INT")  # fmt: skip
    refused("`scale` must make a turn", scale=[6.5 / 4096.5, 0.01], readings="INT")
    refused("fewer counts than 2.31", scale=[6.5 / 2**31, 0.01], readings="DINT")
    monkeypatch.setattr(target, "MOST_FACES", 16_000)
    refused("`real` REAL tabulates all 16,382 faces", oblique(), real="REAL")
    refused("`readings` DINT tabulates all 16,382 faces", oblique(), readings="DINT",
            scale=[6.5 / 2**20, 2 / 2**20])  # fmt: skip


def test_tables_of_many_faces():
    check(Plan.of(oblique()), real="REAL")


def test_an_unknown_option_lists_them_all(tmp_path):
    with pytest.raises(ProblemError, match="which has style, real, readings, dialect, name"):
        export(mixed(), "structured-text", tmp_path, precision="REAL")
