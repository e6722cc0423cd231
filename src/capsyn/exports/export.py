"""From a policy to files of a target, all of them or none."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from capsyn.cells.feature_tree import FeatureTree
from capsyn.cells.packing import packed_bytes
from capsyn.compression.complexity import mean_depth
from capsyn.errors import ProblemError
from capsyn.exports.golden import Golden, golden_vectors
from capsyn.exports.plan import Files, Plan
from capsyn.exports.target import Exported, Target
from capsyn.policies.file import content_hash
from capsyn.policies.policy import Policy
from capsyn.policies.report import feature_figures
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
"""Files beside those of a target: vectors, costs, and what is measured here, of C."""


def _load(name: str) -> Target:
    """Return a target of `TARGETS`."""
    target: Target = importlib.import_module(f"capsyn.exports.{TARGETS[name]}").TARGET
    return target


def all_targets(policy: Policy) -> tuple[str, ...]:
    """Return the targets that a policy can be exported to.

    Not all take oblique splits, or features.
    """
    needed = ["planes"] * policy.has_planes
    needed += ["features"] * isinstance(policy.cells, FeatureTree)
    return tuple(x for x in TARGETS if all(getattr(_load(x), need) for need in needed))


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
        anything fails, everything is as it was. A killed process may leave a hidden folder
        ``.capsyn-*``, and files of two exports, which the certificate's SHA-256 tell apart.
    safe : symbol index or name, optional
        Symbol of states that have no other. Default: the policy's own safe symbol, or the default.
    dwell : float, optional
        Least time between switches [s]. Default: the policy's.
    scale, offset : float or (n,), optional
        A state is ``reading * scale + offset``. Default: readings are states.
    options
        Those of the target, see the `Target` in its module.

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
    plan = Plan.of(policy, safe=safe, dwell=dwell, scale=scale, offset=offset)
    golden = golden_vectors(plan)
    files: Files = {}
    for name in targets:
        folder = "" if isinstance(to, str) else f"{name}/"
        written = _files_of(name, plan, golden, options)
        files |= {folder + file: content for file, content in written.items()}
    return _write(files, Path(directory))


def _files_of(name: str, plan: Plan, golden: Golden, options: dict[str, Any]) -> Files:
    """Return all files of one target, with vectors, costs and what is measured."""
    target = _load(name)
    if isinstance(plan.tree.cells, FeatureTree) and not target.features:
        able = ", ".join(x for x in TARGETS if _load(x).features)
        raise ProblemError(f"target {name} takes no tree with features; these do: {able}")
    chosen = target.options(**options)
    exported = target.export(plan, golden, chosen)
    for file in {GOLDEN, CERTIFICATE, MEASURED} & set(exported.files):
        raise ProblemError(f"`name` must be another: the export has a {file} of its own")
    vectors = (exported.golden or golden).to_csv(plan)
    exported = dataclasses.replace(exported, files=exported.files | {GOLDEN: vectors})
    costs = _certificate(plan, exported, name, vars(chosen))
    files = exported.files | {CERTIFICATE: _json(costs)}
    if target.measure is not None:
        files[MEASURED] = _json(target.measure(exported.files))
    return files


def _certificate(
    plan: Plan, exported: Exported, target: str, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what a decision takes at most, as plain data.

    ``comparisons`` is exact, from the tree; the mean is over the volume, and None where splits are
    oblique. ``tree_bytes`` counts the tree's arrays in the smallest integers that hold them.
    ``changed_by_rounding`` is the share of random states whose symbol is another as the target
    rounds them; None where it rounds to the policy's own lattice, which changes none.
    """
    tree, features = plan.tree, feature_figures(plan.tree.cells)
    return {
        "header": list(plan.header),
        "target": target,
        "options": dict(options),
        "policy": plan.policy.name,
        "sha256": content_hash(plan.policy),
        "nodes": tree.node_count,
        "comparisons": {"most": tree.depth, "mean": mean_depth(tree)},
        "planes": len(tree.cells.planes),
        **({"features": features} if features else {}),
        "lattice": list(tree.cells.counts),
        "tree_bytes": packed_bytes(tree.cells),
        "files": {
            name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
            for name, content in sorted(exported.files.items())
        },
        "guarantee": tree.guarantee.text,
        "changed_by_rounding": exported.changed,
        "renamed": dict(exported.renamed),
        "notes": list(exported.notes),
    }


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
