"""Export: from a policy to the files of a target, all of them or none."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from capsyn.errors import ProblemError
from capsyn.exports.certificate import certificate
from capsyn.exports.feature_texts import features_of
from capsyn.exports.golden import Golden, golden_vectors
from capsyn.exports.plan import MOST_NODES, Files, Plan, has_state, tree_within
from capsyn.exports.sequence import golden_sequence
from capsyn.exports.target import Target
from capsyn.limits.telling import limits_policy
from capsyn.policies.policy import Policy
from capsyn.validation import describe

TARGETS = {
    "c": "c.target",
    "structured-text": "structured_text.target",
    "verilog": "verilog.target",
    "fmu": "fmu.target",
    "python": "python_module",
    "javascript": "javascript.target",
    "dot": "dot",
    "json": "policy_json.target",
}
"""Targets and their modules, each of which has its `Target` as ``TARGET``."""
GOLDEN, CERTIFICATE, MEASURED = "golden.csv", "certificate.json", "measured.json"
SEQUENCE = "sequence.csv"
LIMITS = "limits"
"""Files beside those of a target: vectors, costs, what is measured here, of C, and, where there is
more to remember than one least time, a sequence; and the folder of what says whether a policy keeps
its limits."""


def _load(name: str) -> Target:
    """Return a target of `TARGETS`."""
    target: Target = importlib.import_module(f"capsyn.exports.{TARGETS[name]}").TARGET
    return target


def all_targets(policy: Policy) -> tuple[str, ...]:
    """Return the targets that a policy can be exported to.

    Not all take planes, features, or many nodes.
    """
    targets = {name: _load(name) for name in TARGETS}
    if policy.has_planes:
        small = tree_within(policy, MOST_NODES) is not None
        targets = {k: target for k, target in targets.items() if target.planes}
        targets = {k: target for k, target in targets.items() if small or target.cells}
    if has_state(policy):
        targets = {k: target for k, target in targets.items() if target.remembers}
    if features_of(policy.cells):
        targets = {k: target for k, target in targets.items() if target.features}
    return tuple(targets)


def check_options(to: object, names: Iterable[str]) -> tuple[str, ...]:
    """Return the targets; raise unless they are known, and have options of these names."""
    targets = tuple(to) if isinstance(to, (list, tuple)) else (to,)
    for target in targets or (to,):
        if not isinstance(target, str) or target not in TARGETS:
            raise ProblemError(
                f"`to` must be one of {', '.join(TARGETS)}, or several; got {describe(target)}"
            )
        known = _load(target).option_names
        for name in names:
            if name not in known:
                raise ProblemError(
                    f"`{name}` is no option of target {target}, which has {', '.join(known)}"
                )
    return targets


def export(
    policy: Policy,
    to: str | list[str] | tuple[str, ...],
    directory: str | os.PathLike[str],
    *,
    safe: int | str | None = None,
    dwell: float | None = None,
    outside_at_once: bool | None = None,
    scale: Any = None,
    offset: Any = None,
    hold_off: float = 0.0,
    **options: Any,
) -> tuple[Path, ...]:
    """Write a policy or a decision tree in another language, and return the files.

    For a policy that keeps limits, the folder ``limits`` gets a second controller. The symbol of
    the second controller is 1 for a state from which limits are kept, and otherwise 0. The name of
    the second controller is "limits" followed by the policy's name.

    Parameters
    ----------
    policy : Policy
        A policy of cells, or a decision tree. Cells are exported as their exact tree, or as they
        are if leaves are affine.
    to : str, or list of str
        One of `TARGETS`, or a list of them. Each target of a list gets a folder of its name.
    directory : path
        Folder for the files, which is made if need be. Files of the same names are replaced, and
        other files are left alone. If anything fails, everything is as it was. A killed process may
        leave a hidden folder ``.capsyn-*``. A killed process may also leave files of two exports,
        which the SHA-256 of the certificate tells apart.
    safe : symbol index or name, optional
        Symbol for states that have no other symbol. Default: the policy's own safe symbol, or the
        default control.
    dwell : float, optional
        One least time for all symbols [time unit of the policy]. Default: the policy's own times.
    outside_at_once : bool, optional
        Whether the symbol of a state outside the domain is taken at once, without waiting for the
        least time. The symbol of a state that is not finite never waits. Default: as the policy
        says.
    scale, offset : float or (n + k,), optional
        A state or exogenous input is ``reading * scale + offset``. Give one number for all, or one
        for each of the n states and then of the k exogenous inputs. Default: 1 and 0.
    hold_off : float
        Time after a start, or after a power failure, for which the safe symbol is in force,
        whatever the state [time unit of the policy].
    options
        Options of the target; see the `Target` in its module.

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
    if not isinstance(directory, os.PathLike) and not (isinstance(directory, str) and directory):
        raise ProblemError(f"`directory` must be a path; got {describe(directory)}")
    readings: dict[str, Any] = {"scale": scale, "offset": offset}
    waits: dict[str, Any] = {"dwell": dwell, "hold_off": hold_off}
    plan = Plan.of(policy, safe=safe, outside_at_once=outside_at_once, **readings, **waits)
    golden = golden_vectors(plan)
    limits = None if policy.kept is None else Plan.of(limits_policy(policy), **readings)
    files: Files = {}
    for name in targets:
        folder = "" if isinstance(to, str) else f"{name}/"
        written = _files_of(name, plan, golden, options)
        if limits is not None:
            own = options | ({"name": f"limits_{options['name']}"} if options.get("name") else {})
            beside = _files_of(name, limits, golden_vectors(limits), own)
            written |= {f"{LIMITS}/{file}": content for file, content in beside.items()}
        files |= {folder + file: content for file, content in written.items()}
    return _write(files, Path(directory))


def _files_of(name: str, plan: Plan, golden: Golden, options: dict[str, Any]) -> Files:
    """Return all files of one target, with vectors, costs and what is measured."""
    target = _load(name)
    if plan.has_state and not target.remembers:
        able = ", ".join(x for x in TARGETS if _load(x).remembers)
        raise ProblemError(
            f"target {name} keeps one least time between decisions, and nothing else; "
            f"these keep the symbol in force and all times: {able}"
        )
    if features_of(plan.policy.cells) and not target.features:
        able = ", ".join(x for x in TARGETS if _load(x).features)
        raise ProblemError(f"target {name} takes no tree with features; these do: {able}")
    chosen = target.options(**options)
    exported = target.export(plan, golden, chosen)
    plan, chosen = exported.plan or plan, dataclasses.replace(chosen, **exported.chosen)
    for file in {GOLDEN, CERTIFICATE, MEASURED, SEQUENCE} & set(exported.files):
        raise ProblemError(f"`name` must be another: the export has a {file} of its own")
    vectors, beside = (exported.golden or golden).to_csv(plan), exported.beside
    files = exported.files | {beside + GOLDEN: vectors}
    if plan.has_state:
        files[beside + SEQUENCE] = (exported.sequence or golden_sequence(plan)).to_csv(plan)
    exported = dataclasses.replace(exported, files=files)
    files = files | {beside + CERTIFICATE: _json(certificate(plan, exported, name, vars(chosen)))}
    if target.measure is not None:
        measured = target.measure(plan, exported.golden or golden, exported, chosen)
        files[beside + MEASURED] = _json(measured)
    return files


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=2) + "\n").encode()


def _write(files: Files, directory: Path) -> tuple[Path, ...]:
    """Write files under temporary names, then rename them all; a failure leaves what was there."""
    folders = sorted({(directory / name).parent for name in files} | {directory})
    new_folders = [p for p in {f for x in folders for f in (x, *x.parents)} if not p.exists()]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".capsyn-", dir=directory) as temporary:
            _exchange(files, directory, Path(temporary))
    except BaseException as error:
        for folder in sorted(new_folders, reverse=True):  # the innermost first
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            at = f" '{error.filename}'" if error.filename else ""
            raise ProblemError(
                f"cannot write to '{directory}':{at} {error.strerror or error}"
            ) from None
        raise
    return tuple(directory / name for name in files)


def _exchange(files: Files, directory: Path, temporary: Path) -> None:
    """Write files in a temporary folder, and exchange them with those of their names."""
    new, old = temporary / "new", temporary / "old"
    for name, content in files.items():
        if (directory / name).is_dir():
            raise ProblemError(f"cannot write '{directory / name}': it is a directory")
        for path in (new / name, old / name, directory / name):
            path.parent.mkdir(parents=True, exist_ok=True)
        (new / name).write_bytes(content)
    done: list[str] = []
    try:
        for name in files:
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
