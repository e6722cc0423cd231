"""Names and comments that are C, whatever the policy's are."""

import dataclasses
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsyn.exports.c.language import comment
from capsyn.exports.plan import Plan
from support.exports.c_machines import (
    Library,
    prefix_of,
)
from support.exports.c_plans import (
    files,
    plan_of,
    policy,
)


def test_names(tmp_path):
    source = dataclasses.replace(policy("cart-pendulum"), name="7 */ int \\ ünder-the-surface ??/")
    written = files(Plan.of(source), None)
    p = prefix_of(written)
    assert p == "n7_int_under_the_s"
    header = written[f"{p}.h"].decode()
    told = " ".join(header.replace("\n *", " ").split())
    assert f"became {p}." in told and "Name '-5' became MINUS_5." in told
    assert f"{p.upper()}_SYMBOL_MINUS_5 = 1" in header
    Library(written, tmp_path, 2)
    assert prefix_of(files(Plan.of(source), None, name="double")) == "double_2"


@pytest.mark.parametrize(
    "name",
    "stdint stdbool float math string stdio Stdint limits test Test ALL install help clean example"
    " Arduino double".split(),
)
def test_names_that_others_have(tmp_path, name):
    written = files(plan_of("cart-pendulum"), None, name=name)
    assert prefix_of(written) == f"{name}_2"
    if name in ("stdint", "float", "math"):
        Library(written, tmp_path, 2, options=["-O1", "-I."])


@given(st.lists(st.text("*/\\?a \n", max_size=120), max_size=3))
def test_a_comment_ends_where_it_should(lines):
    text = comment(lines)
    assert text.startswith("/*") and text.endswith("*/") and not set(text) & {"\\"}
    assert not any(mark in text[2:-2] for mark in ("*/", "/*", "//", "??"))


@pytest.mark.parametrize("name", ["a *\\ int boom; b", "*??/ int boom; /*", "\\*\\/ // \\"])
def test_a_name_is_no_code(tmp_path, name):
    source = dataclasses.replace(policy("cart-pendulum"), name=name)
    written = files(Plan.of(source), None, name="k")
    Library(written, tmp_path, 2)
    assert "boom" not in re.sub(r"/\*.*?\*/", "", written["k.c"].decode(), flags=re.S)
