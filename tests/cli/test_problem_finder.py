"""Problems by name, in files and in modules."""

import sys

import pytest

from capsyn import Problem
from capsyn.cli.problem_finder import find_function, find_problem
from capsyn.errors import ProblemError

OWN = """
import capsyn
from beside import HORIZON
def make(name):
    return capsyn.Problem(name, lambda x, u: u, capsyn.Box([-1], [1]), [-1, 1], 0, HORIZON,
                          running_cost=lambda x: x[0]**2)
problem = make("first")
other = make("second")
number = 3
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "beside.py").write_text("HORIZON = 0.25\n")
    (tmp_path / "broken.py").write_text("raise KeyError('oh\\nno')\n")
    (tmp_path / "stop.py").write_text("import sys\nsys.exit(0)\n")
    (tmp_path / "wrong.py").write_text(OWN.replace("HORIZON,", "-HORIZON,"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for module in ("own", "beside"):
        sys.modules.pop(module, None)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("cart-pole", "cart-pole"),
        ("own.py", "first"),
        ("{}/own.py:other", "second"),
        ("own:other", "second"),
        ("own:", "first"),
    ],
)
def test_find_takes_names_files_and_modules(own, text, name):
    problem = find_problem(text.format(own))
    assert isinstance(problem, Problem) and problem.name == name


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("cart-pol", "did you mean 'cart-pole'?"),
        ("own", "no built-in problem 'own'; for the file give 'own.py', or 'own.py:NAME'"),
        ("missing.py", "there is no file 'missing.py'"),
        ("own.py:third", "must hold a capsyn.Problem named 'third'; found own.py:problem, "),
        ("stop.py", "'stop.py', line 2: SystemExit: 0"),
        ("own.py:number", "must hold a capsyn.Problem named 'number'"),
        ("no_such_module:problem", "No module named 'no_such_module'"),
        ("broken.py", "'broken.py', line 1: KeyError: 'oh"),
        ("wrong.py", "`horizon` must be a finite number > 0; got -0.25"),
    ],
)
def test_find_says_in_one_line_what_is_wrong(own, text, reason):
    with pytest.raises(ProblemError) as caught:
        find_problem(text)
    assert reason in str(caught.value) and "\n" not in str(caught.value)


def test_what_a_file_prints_goes_to_stderr_and_dataclasses_work(tmp_path, capsys):
    (tmp_path / "chatty.py").write_text(
        "from __future__ import annotations\n"
        "import dataclasses\n\n"
        "@dataclasses.dataclass\n"
        "class Size:\n"
        "    width: float = 1.0\n\n"
        "print('hello')\n" + OWN.replace("from beside import HORIZON", "HORIZON = 1.0")
    )
    assert find_problem(str(tmp_path / "chatty.py")).name == "first"
    out, err = capsys.readouterr()
    assert out == "" and "hello" in err


def test_functions_are_found_by_file_or_module(tmp_path):
    (tmp_path / "v.py").write_text("def V(x):\n    return x[0] ** 2\nnumber = 3\n")
    assert find_function(f"{tmp_path / 'v.py'}:V")([3]) == 9
    assert find_function("math:sqrt")(4) == 2
    for text, reason in (
        (f"{tmp_path / 'v.py'}:W", "must hold a function named 'W'"),
        (f"{tmp_path / 'v.py'}:number", "must hold a function named 'number'"),
        (f"{tmp_path / 'v.py'}", "a function must be given as FILE.py:NAME"),
        (f"{tmp_path / 'w.py'}:V", "there is no file"),
    ):
        with pytest.raises(ProblemError, match=reason):
            find_function(text)
