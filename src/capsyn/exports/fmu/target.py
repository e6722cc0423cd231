"""Target ``fmu``: an FMI 2.0 co-simulation unit with its C source and a binary of this platform.

Inputs are readings of the states, outputs the control vector, the symbol and the status. A step
decides from the inputs at its begin and holds the control over it; inputs that are set afterwards
show in the outputs at once. The parameter ``min_dwell`` overrides the policy's.
"""

from __future__ import annotations

import hashlib
import io
import platform
import subprocess
import sys
import tempfile
import textwrap
import uuid
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from capsyn.errors import KernelBuildError, ProblemError, warn
from capsyn.exports.c.language import KEYWORDS
from capsyn.exports.feature_texts import c_ranks, features_of
from capsyn.exports.fmu.description import description, variable_names
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name, renamed
from capsyn.exports.plan import Files, Plan
from capsyn.exports.target import Exported, Target
from capsyn.native.build import find_compiler
from capsyn.policies.file import content_hash
from capsyn.validation import describe
from capsyn.version import __version__

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden", "-s")
BUILD_SECONDS = 120
"""Longest that the compiler may take."""


@dataclass(frozen=True)
class Options:
    """Options of target ``fmu``.

    Parameters
    ----------
    name : str, optional
        What the unit is called, made an identifier. Default: the policy's name.
    sources_only : bool
        Whether to leave out the binary; the unit then runs where its importer can build sources.
        So it is, with a warning, where there is no compiler or no name for the platform.
    """

    name: str | None = None
    sources_only: bool = False


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return the unit, ``NAME.fmu``."""
    if not isinstance(options.sources_only, bool):
        raise ProblemError(
            f"`sources_only` must be true or false; got {describe(options.sources_only)}"
        )
    name = file_name(options.name, plan.policy.name, KEYWORDS)
    guid = "{" + _guid(plan) + "}"
    source = _source(plan, guid)
    content = {"modelDescription.xml": description(plan, name, guid), f"sources/{name}.c": source}
    if not options.sources_only:
        content |= _binary(name, source)
    names = [*plan.policy.domain.names, *plan.policy.alphabet.inputs]
    return Exported({f"{name}.fmu": _zip(content)}, renamed(names, variable_names(plan)))


TARGET = Target(export, Options, features=True)


def _guid(plan: Plan) -> str:
    """Return an identifier of what the unit does, made from the policy and the plan."""
    parts = [content_hash(plan.policy), plan.safe, plan.dwell, plan.scale.tolist()]
    parts += [plan.offset.tolist(), __version__]
    digits = hashlib.sha256(repr(parts).encode()).hexdigest()
    return str(uuid.UUID(digits[:32]))


def _zip(content: dict[str, bytes]) -> bytes:
    """Return an archive, with the date that stands for none: the same content, the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            info = zipfile.ZipInfo(name)
            info.external_attr = 0o644 << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)
    return buffer.getvalue()


def _binary(name: str, source: bytes) -> Files:
    """Return the shared library of this platform by its place; nothing where it cannot be built."""
    ending = {"linux": "so", "darwin": "dylib"}.get(sys.platform)
    if ending is None or platform.machine() not in ("x86_64", "AMD64"):
        _warn(f"FMI 2.0 has no name for {sys.platform} {platform.machine()}")
        return {}
    try:
        command = find_compiler().command
    except KernelBuildError as error:
        _warn(str(error))
        return {}
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory, f"{name}.c")
        path.write_bytes(source)
        # names without a directory: the place leaves no trace in the library
        run = [*command, *FLAGS, path.name, "-o", f"{name}.{ending}", "-lm"]
        try:
            subprocess.run(
                run, cwd=directory, check=True, capture_output=True, timeout=BUILD_SECONDS
            )
        except subprocess.SubprocessError as error:
            output = (getattr(error, "stderr", None) or b"").decode(errors="replace")
            raise KernelBuildError(
                f"the compiler failed on the source of the FMU: {output.strip() or error}", run
            ) from None
        data = path.with_suffix(f".{ending}").read_bytes()
    return {f"binaries/{sys.platform}64/{name}.{ending}": data}


def _warn(reason: str) -> None:
    warn(f"the FMU has no binary, only sources: {reason}")


def _source(plan: Plan, guid: str) -> bytes:
    """Return the C source: what the policy is, as constants and tables, then what it does."""
    policy, tree = plan.policy, plan.tree.cells
    domain = policy.domain
    features, places, ranks = features_of(tree), domain.n, ["#define RANKS"]
    if features:
        places += len(features.names)
        body = [f"    {line}" for line in c_ranks(features, "z[{}]")]
        ranks = ["static void put_ranks(int *z) {", *body, "}", "#define RANKS put_ranks(z);"]
    planes = tree.planes if len(tree.planes) else np.zeros((1, places), dtype=np.int32)
    lines = [f"/* {line.replace('*/', '* /').replace('/*', '/ *')} */" for line in plan.header]
    lines += [
        "#include <stdint.h>",
        "",
        f"#define STATES {domain.n}",
        f"#define PLACES {places}",
        f"#define CONTROLS {policy.alphabet.m}",
        f'#define GUID "{guid}"',
        f"#define SAFE {plan.safe}",
        f"#define NEAREST {int(plan.nearest)}",
        f"#define GAP {plan.gap}",
        f"#define DWELL {plan.dwell!r}",
        "",
        _table("double", "LOWER[STATES]", domain.lower.tolist()),
        _table("double", "UPPER[STATES]", domain.upper.tolist()),
        _table("int", "PERIODIC[STATES]", [int(p) for p in domain.periodic]),
        _table("double", "SCALE[STATES]", plan.scale.tolist()),
        _table("double", "OFFSET[STATES]", plan.offset.tolist()),
        _table("int32_t", "COUNTS[STATES]", tree.counts),
        _table("double", f"CONTROL[{plan.labels}][CONTROLS]", policy.controls.tolist()),
        _table("int32_t", f"SPLIT[{tree.node_count}]", tree.split.tolist()),
        _table("int32_t", f"THRESHOLD[{tree.node_count}]", tree.threshold.tolist()),
        _table("int32_t", f"SECOND[{tree.node_count}]", tree.second.tolist()),
        _table("int32_t", f"PLANES[{len(planes)}][PLACES]", planes.tolist()),
        "",
    ]
    if features:
        lines.append("#include <math.h>")
    lines += [*ranks, ""]
    text = resources.files("capsyn.exports.fmu").joinpath("fmu.c").read_text(encoding="utf-8")
    return ("\n".join(lines) + "\n" + text).encode()


def _table(kind: str, name: str, values: Sequence[Any]) -> str:
    rows = ["{" + ", ".join(map(repr, v)) + "}" if isinstance(v, list) else repr(v) for v in values]
    text = textwrap.fill(", ".join(rows), 96, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name} = {{\n{text}\n}};"
