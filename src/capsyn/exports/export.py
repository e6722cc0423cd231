"""From a policy to files of a target, all of them or none."""

from __future__ import annotations

import importlib
import inspect
import json
import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from capsyn.errors import ProblemError
from capsyn.exports.certificate import certificate
from capsyn.exports.golden import golden_vectors
from capsyn.exports.plan import Files, Plan
from capsyn.policy import Policy
from capsyn.validation import describe

TARGETS = {
    "c": "c",
    "structured-text": "structured_text",
    "verilog": "verilog",
    "fmu": "fmu",
    "python": "python_module",
    "javascript": "javascript",
    "dot": "dot",
    "json": "policy_json",
}
"""Targets and their modules, each with ``files(plan, golden, **options) -> Made``."""

CERTIFICATE = "certificate.json"
"""File of what a decision costs; see `certificate`."""


def check_options(to: object, names: Iterable[str]) -> tuple[str, ...]:
    """Return the targets; raise unless they are known, and have options of these names."""
    targets = tuple(to) if isinstance(to, (list, tuple)) else (to,)
    for target in targets or (to,):
        if not isinstance(target, str) or target not in TARGETS:
            raise ProblemError(
                f"`to` must be one of {', '.join(TARGETS)}, or several; got {describe(target)}"
            )
        known = list(inspect.signature(_module(target).files).parameters)[2:]
        for name in names:
            if name not in known:
                raise ProblemError(
                    f"`{name}` is no option of target {target}, which has {', '.join(known)}"
                )
    return targets


def _module(target: str) -> ModuleType:
    return importlib.import_module(f"capsyn.exports.{TARGETS[target]}")


def export(
    policy: Policy,
    to: str | list[str] | tuple[str, ...],
    directory: str | os.PathLike[str],
    *,
    safe: int | str | None = None,
    dwell: float | None = None,
    scale: Any = None,
    offset: Any = None,
    **options: Any,
) -> tuple[Path, ...]:
    """Write a policy or a decision tree in another language, and return the files.

    Parameters
    ----------
    policy : Policy
        A policy of cells, of which the exact tree is exported, or a decision tree.
    to : str, or list of str
        One of `TARGETS`; or several, each into a folder of its name.
    directory : path
        Where; it is made if need be. Files of the same names are replaced, others left alone; if
        anything fails, everything is as it was.
    safe : symbol index or name, optional
        Symbol of states that have no other. Default: the policy's own safe symbol, or the default.
    dwell : float, optional
        Least time between switches [s]. Default: the policy's.
    scale, offset : float or (n,), optional
        A state is ``reading * scale + offset``. Default: readings are states.
    options
        Those of the target, see its module.

    Returns
    -------
    tuple of Path
        The files that were written.

    Raises
    ------
    ProblemError
        An unknown target or option, or one that the policy does not allow.
    """
    targets = check_options(to, options)
    plan = Plan.of(policy, safe=safe, dwell=dwell, scale=scale, offset=offset)
    golden = golden_vectors(plan)
    vectors = golden.to_csv(plan)
    files: Files = {}
    for target in targets:
        made = _module(target).files(plan, golden, **options)
        made.files["golden.csv"] = vectors
        figures = certificate(plan, made, target)
        made.files[CERTIFICATE] = (json.dumps(figures, indent=2, sort_keys=True) + "\n").encode()
        folder = "" if isinstance(to, str) else f"{target}/"
        files |= {folder + name: content for name, content in made.files.items()}
    return _write(files, Path(directory))


def _write(files: Files, directory: Path) -> tuple[Path, ...]:
    """Write files under temporary names, then rename them all; a failure leaves what was there."""
    made = not directory.exists()
    directory.mkdir(parents=True, exist_ok=True)
    done: list[str] = []
    try:
        with tempfile.TemporaryDirectory(prefix=".capsyn-", dir=directory) as temporary:
            new, old = Path(temporary, "new"), Path(temporary, "old")
            for name, content in files.items():
                if (directory / name).is_dir():
                    raise ProblemError(f"cannot write '{directory / name}': it is a directory")
                for path in (new / name, old / name):
                    path.parent.mkdir(parents=True, exist_ok=True)
                (new / name).write_bytes(content)
            try:
                for name in files:
                    (directory / name).parent.mkdir(parents=True, exist_ok=True)
                    done.append(name)
                    if (directory / name).exists():
                        os.replace(directory / name, old / name)
                    os.replace(new / name, directory / name)
            except BaseException:
                for name in done:
                    if (old / name).exists():
                        os.replace(old / name, directory / name)
                    elif not (new / name).exists():
                        (directory / name).unlink()
                raise
    except BaseException:
        if made:
            shutil.rmtree(directory, ignore_errors=True)
        raise
    return tuple(directory / name for name in files)
