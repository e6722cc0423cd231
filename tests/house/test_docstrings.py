"""Public docstrings say what goes in, what comes out and what is raised."""

import ast
import dataclasses
import functools
import inspect
import pkgutil
import re
import textwrap
from pathlib import Path

import pytest

import capsyn

SECTION = re.compile(r"^(\w+)\n-{3,}$", re.MULTILINE)
ENTRY = re.compile(r"^(\*{0,2}\w+(?:, \w+)*)(?: : .+)?$", re.MULTILINE)


API = (Path(__file__).parents[2] / "docs" / "api.md").read_text()
SHOWN = re.findall(r"^\.\. auto(?:class|function|exception):: capsyn\.(.+)$", API, re.MULTILINE)


def public():
    """Yield name and object of all that the reference shows: with methods and properties."""
    for name in SHOWN:
        value = pkgutil.resolve_name(f"capsyn.{name}" if "." in name else f"capsyn:{name}")
        yield name, value
        if isinstance(value, type):
            for key, member in vars(value).items():
                member = getattr(member, "__func__", member)
                if isinstance(member, functools.cached_property):
                    member = member.func
                elif isinstance(member, property):
                    member = member.fget
                shown = not key.startswith("_") or key == "__call__"
                if shown and inspect.isfunction(member):
                    yield f"{name}.{key}", member


PUBLIC = dict(public())
ALONE = [name for name in SHOWN if not isinstance(PUBLIC[name], type)]
FUNCTIONS = [name for name, value in PUBLIC.items() if not isinstance(value, type)]
RECORDS = [name for name, value in PUBLIC.items() if dataclasses.is_dataclass(value)]


def sections(value):
    """Return the sections of a docstring by name; what is before them has the name ''."""
    parts = SECTION.split(inspect.cleandoc(value.__doc__ or ""))
    return {"": parts[0]} | dict(zip(parts[1::2], parts[2::2]))


def named(text):
    """Return what a section has an entry for."""
    return {name.strip(" *") for entry in ENTRY.findall(text) for name in entry.split(",")}


def parameters(function):
    return [name for name in inspect.signature(function).parameters if name != "self"]


def raised(function):
    """Return the names of the exceptions that the body of a function raises itself."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    calls = (node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise))
    return {call.func.id for call in calls if isinstance(call, ast.Call)}


def test_the_reference_shows_all_public_names():
    assert set(capsyn.__all__) <= set(SHOWN)


@pytest.mark.parametrize("name", PUBLIC)
def test_the_first_line_is_a_sentence(name):
    first, _, rest = inspect.cleandoc(PUBLIC[name].__doc__ or "").partition("\n")
    assert first.endswith((".", "?")) and (not rest or rest.startswith("\n")), first


@pytest.mark.parametrize("name", ALONE)
def test_functions_describe_exactly_their_parameters(name):
    described = named(sections(PUBLIC[name]).get("Parameters", ""))
    if len(parameters(PUBLIC[name])) == 1 and not described:
        return  # the first line says what it takes
    told = set(re.findall(r"``(\w+)=", PUBLIC[name].__doc__))  # with another parameter
    assert described <= set(parameters(PUBLIC[name])) <= described | told


@pytest.mark.parametrize("name", sorted({*FUNCTIONS} - {*ALONE}))
def test_methods_mention_all_their_parameters(name):
    words = set(re.findall(r"\w+", inspect.getdoc(PUBLIC[name])))
    assert set(parameters(PUBLIC[name])) <= words


@pytest.mark.parametrize("name", RECORDS)
def test_records_describe_their_fields(name):
    found = sections(PUBLIC[name])
    described = named(found.get("Parameters", "")) | named(found.get("Attributes", ""))
    own = set(PUBLIC[name].__dict__.get("__annotations__", ()))
    fields = {field.name for field in dataclasses.fields(PUBLIC[name]) if field.name in own}
    assert {field for field in fields if not field.startswith("_")} <= described


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_returned_is_said(name):
    annotation = inspect.signature(PUBLIC[name]).return_annotation
    found = sections(PUBLIC[name])
    if annotation not in (None, "None"):
        words = inspect.cleandoc(PUBLIC[name].__doc__).split(maxsplit=1)[0]
        assert "Returns" in found or words in ("Return", "Whether", "Yield") or name not in ALONE


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_raised_is_said(name):
    text = inspect.getdoc(PUBLIC[name])
    for error in raised(PUBLIC[name]):
        assert error in text, error
    if name in ALONE and parameters(PUBLIC[name]):
        assert "Raises" in sections(PUBLIC[name])
