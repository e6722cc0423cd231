"""Every code block of every page runs, and prints what the page shows.

The blocks of a page run in its order, in one folder of their own:

- ``python``: all in one namespace. A block that begins with ``# NAME.py`` is a file of that name;
  likewise ``c`` blocks that begin with ``/* NAME.c */``.
- ``sh``: line by line, with the commands of this environment; each must succeed.
- ``console``: the lines that begin with ``$`` are run; the lines after each must be in what it
  prints, in that order, with a line ``...`` for any lines between.
- ``text`` and others are for the reader alone.
"""

import contextlib
import functools
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import capsyn
from capsyn.cli.doctor import COMMANDS
from capsyn.compression import trees
from support.processes.command_line import run_here

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```([\w{}-]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"(?:#|/\*) ([\w-]+\.(?:py|c))(?: \*/)?\n")
OPTIONAL = {*COMMANDS, "arm-none-eabi-size", "vvp", "cmake"}
"""Commands without which a page is not tried."""


def blocks(page):
    """Return the language and the text of each code block; a backslash continues a line."""
    return BLOCK.findall(page.read_text().replace("\\\n", ""))


def commands(text):
    """Return the lines of a shell block that are commands."""
    return [line for line in text.splitlines() if line.strip() and not line.startswith("#")]


def in_shell(line, folder):
    """Run a line in a shell as a reader would, and return what it prints."""
    for word in re.findall(r"(?:^|[(]|&& |\| )([\w-]+)", line):
        if word in OPTIONAL and not shutil.which(word):
            pytest.skip(f"{word} is not installed")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", line],
        cwd=folder,
        env=os.environ | {"PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert done.returncode == 0, f"{line}\n{done.stdout}"
    assert "warning:" not in done.stdout, f"{line}\n{done.stdout}"
    return done.stdout


def run(line, folder):
    """Run a line: in this process where it is a call of capsyn alone, otherwise in a shell."""
    line = re.sub(r"  +# .*", "", line)
    own = "--dask" in line or set(line) & set("|&;<>()$`*?#~")  # of processes and the shell's
    if not line.startswith("capsyn ") or own:
        return in_shell(line, folder)
    done = run_here(shlex.split(line)[1:], folder)
    printed = done.stdout + done.stderr
    assert done.returncode == 0, f"{line}\n{printed}"
    assert "warning:" not in printed, f"{line}\n{printed}"
    return printed


def check_shown(shown, printed, line):
    """Check that lines are in what a command prints, next to each other but for ``...``."""
    found, start, anywhere = [text.rstrip() for text in printed.splitlines()], 0, False
    for text in shown:
        if text == "...":
            anywhere = True
            continue
        rest = found[start:] if anywhere else found[start : start + 1]
        assert text.rstrip() in rest, f"{line}\nshows\n{text}\nbut prints\n{printed}"
        start += rest.index(text.rstrip()) + 1
        anywhere = False
    assert anywhere or start == len(found), f"{line}\nprints more than is shown:\n{printed}"


def console(text, folder, run=run):
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        line, *shown = part.splitlines()
        check_shown(shown, run(line, folder), line)


@contextlib.contextmanager
def few_samples():
    """Let trees be fitted to fewer samples, where a page does not show what is printed of them."""
    with pytest.MonkeyPatch.context() as patch:
        fewer = functools.partial(trees.fit_tree, samples=40_000)
        patch.setattr("capsyn.compression.trees.fit_tree", fewer)
        yield


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_block_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    known = set(sys.modules)
    names = {"__name__": "page"}
    own = in_shell if page.stem == "dwell" else run  # one page in processes of its own
    try:
        for language, text in blocks(page):
            file = FILE.match(text)
            if file:
                (tmp_path / file[1]).write_text(text)
            elif language == "python":
                with few_samples():
                    exec(compile(text, page.name, "exec"), names)
            elif language == "sh":
                with few_samples():
                    for line in commands(text):
                        own(line, tmp_path)
            elif language == "console":
                console(text, tmp_path, own)
    finally:
        for name in set(sys.modules) - known:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
                del sys.modules[name]


def test_what_a_page_shows_is_checked(tmp_path):
    console("$ printf 'a\\nb\\nc\\n'\na\n...\nc\n", tmp_path)
    for wrong in ("$ echo a\nb\n", "$ printf 'a\\nb\\n'\na\n", "$ echo a\n...\nb\n", "$ false\n"):
        with pytest.raises(AssertionError):
            console(wrong, tmp_path)


def test_the_site_builds_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d"]
    command += [tmp_path / "doctrees", ROOT / "docs", tmp_path / "site"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    reference = (tmp_path / "site" / "api.html").read_text()
    assert all(f'id="capsyn.{name}"' in reference for name in capsyn.__all__)


def test_every_block_has_a_language():
    for page in PAGES:
        lines = [line for line in page.read_text().splitlines() if line.startswith("```")]
        assert len(lines) % 2 == 0 and set(lines[1::2]) <= {"```"}, page.name
        assert "```" not in lines[::2], f"{page.name}: a block without a language"


def test_links_and_pictures_exist():
    for page in PAGES:
        for link in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_every_page_is_in_the_contents():
    contents = re.findall(r"^([\w-]+)$", (ROOT / "docs" / "index.md").read_text(), re.MULTILINE)
    pages = {page.stem for page in (ROOT / "docs").glob("*.md")} - {"index"}
    assert set(contents) == pages and len(contents) == len(pages)


def resolve(name):
    """Return what a name of the guides means: public, or inside a module of the package."""
    parts = name.split("(")[0].split(".")
    for cut in range(len(parts), -1, -1):
        try:
            value = importlib.import_module(".".join(["capsyn", *parts[:cut]]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            fields = getattr(value, "__dataclass_fields__", {})
            value = fields[part] if part in fields else getattr(value, part)
        return value
    raise AssertionError(name)


def test_the_functions_of_the_theory_exist():
    rows = re.findall(r"^\|(.*)\|(.*)\|$", (ROOT / "docs" / "theory.md").read_text(), re.MULTILINE)
    found = 0
    for equation, functions in rows:
        if equation.startswith(" policy | paper"):
            break
        last = ""
        for name in re.findall(r"`([\w.]+)(?:\([^)]*\))?(?:\.\w+)?`", functions):
            last = last.rpartition(".")[0] + name if name.startswith(".") else name
            resolve(last)
            found += 1
    assert found >= 25
