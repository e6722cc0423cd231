"""The command line: in this process where that says the same, and in one of its own."""

import contextlib
import importlib
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import capsyn as package
from capsyn.cli.app import main

SOURCE = Path(package.__file__).parent
UNSEEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Warnings that Python does not show by itself."""

BOAT = """
import capsyn
problem = capsyn.Problem(
    name="boat", dynamics=lambda x, u: [x[1], u[0]], domain=capsyn.Box([-1, -1], [1, 1]),
    alphabet=[-1, 0, 1], default=0, horizon=1.0, running_cost=lambda x: x[0]**2 + x[1]**2,
)
"""
"""A file with a problem of the user's own."""


@contextlib.contextmanager
def fresh():
    """Let what a run changes of this process be as before when it ends, as if it had its own."""
    known = set(sys.modules)
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.setattr(warnings, "showwarning", warnings.showwarning)
        patch.setattr(sys, "path", list(sys.path))
        warnings.resetwarnings()  # to what Python begins with
        for category in UNSEEN:
            warnings.simplefilter("ignore", category)
        importlib.invalidate_caches()
        try:
            yield patch
        finally:
            for name in set(sys.modules) - known:
                place = getattr(sys.modules[name], "__file__", None) or sys.prefix
                if not place.startswith((sys.prefix, sys.base_prefix, str(SOURCE))):
                    del sys.modules[name]  # the user's own


def run_here(arguments, cwd=None, environment=None):
    """Run the command line in this process; return what `subprocess.run` would.

    Signals, terminals and compilers that are not the usual one need a process of their own: see
    `run_apart`.
    """
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with fresh() as patch:
        patch.setattr(sys, "argv", ["capsyn", *arguments])
        if cwd is not None:
            patch.chdir(cwd)
        for name, value in (environment or {}).items():
            patch.setenv(name, value)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                main()
                status = 0
            except SystemExit as stopped:
                status = stopped.code or 0
    texts = []
    for stream in (out, err):
        stream.flush()
        texts.append(stream.buffer.getvalue().decode())
    return subprocess.CompletedProcess(arguments, status, *texts)


def run_apart(arguments, cwd=None, environment=None):
    """Run the command line in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "capsyn", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**os.environ, **(environment or {})},
    )


def capsyn(*arguments, cwd=None, code=0, run=run_here, **environment):
    """Run the command with an environment; return (stdout, stderr)."""
    done = run(list(map(str, arguments)), cwd, environment)
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


def error_of(*arguments, cwd=None):
    """Return the one line that a failing command prints."""
    out, err = capsyn(*arguments, cwd=cwd, code=2)
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1
    return err
