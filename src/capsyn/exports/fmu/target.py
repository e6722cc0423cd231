"""Target ``fmu``: an FMI 2.0 co-simulation unit with its C source and binaries of platforms.

Inputs are readings of the states, then of exogenous inputs; outputs are the control vector, the
symbol and the status. A step decides from the inputs at its begin and holds the control over it;
inputs that are set afterwards show in the outputs at once. The parameter ``min_dwell`` overrides
the policy's; where symbols and inputs have times of their own there is one for each, ``hold_NAME``,
and ``hold_off`` where there is one. They are in seconds, as all time of FMI is; tools can display
them in the policy's unit.
"""

from __future__ import annotations

import hashlib
import io
import platform
import re
import sys
import textwrap
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from capsyn.cells.cell_tree import CellTree
from capsyn.cells.feature_tree import Features
from capsyn.cells.packing import smallest_type
from capsyn.cells.split_tree import SplitTree
from capsyn.errors import KernelBuildError, ProblemError, warn
from capsyn.exports.c.language import KEYWORDS
from capsyn.exports.constants import cell_tables
from capsyn.exports.feature_texts import c_ranks, features_of
from capsyn.exports.fmu.build import ENDINGS, build, own_platform
from capsyn.exports.fmu.description import description
from capsyn.exports.fmu.times import times_of, variable_names
from capsyn.exports.golden import Golden
from capsyn.exports.identifiers import file_name, renamed
from capsyn.exports.plan import OUTSIDE, Files, Plan
from capsyn.exports.target import Exported, Target
from capsyn.native.compiler import find_compiler
from capsyn.validation import describe
from capsyn.version import __version__


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
    platforms : "host", "all", or one or more of "linux64", "win64", "darwin64"
        Platforms of the binaries. Those of others than this one are made by the package ziglang
        (``pip install ziglang``); that of ``darwin64`` is then for both kinds of Macs.
    """

    name: str | None = None
    sources_only: bool = False
    platforms: str | Sequence[str] = "host"


def export(plan: Plan, golden: Golden, options: Options) -> Exported:
    """Return the unit, ``NAME.fmu``."""
    if not isinstance(options.sources_only, bool):
        raise ProblemError(
            f"`sources_only` must be true or false; got {describe(options.sources_only)}"
        )
    platforms = _platforms(options)
    name = file_name(options.name, plan.policy.name, KEYWORDS)
    guid = "{" + _guid(plan) + "}"
    source = _source(plan, guid)
    content = {"modelDescription.xml": description(plan, name, guid), f"sources/{name}.c": source}
    if not options.sources_only:
        content |= build(name, source, platforms) if platforms else _of_host(name, source)
    names = [*plan.policy.space.names, *plan.policy.alphabet.inputs]
    return Exported({f"{name}.fmu": _zip(content)}, renamed(names, variable_names(plan)))


TARGET = Target(export, Options, features=True, remembers=True)


def _guid(plan: Plan) -> str:
    """Return an identifier of what the unit does, made from the policy and the plan."""
    parts = [plan.sha256, plan.safe, plan.dwell, plan.at_once, plan.scale.tolist()]
    parts += [plan.offset.tolist(), __version__]
    parts += [plan.policy.rules.holds.tolist(), plan.hold_off] if plan.has_state else []
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


def _platforms(options: Options) -> tuple[str, ...]:
    """Return the platforms that are asked for by name; none for this one, whichever it is."""
    given = options.platforms
    if isinstance(given, str):
        given = {"host": (), "all": tuple(ENDINGS)}.get(given, (given,))
        known = all(name in ENDINGS for name in given)
    else:
        known = isinstance(given, Sequence) and len(given) > 0
        known = known and all(isinstance(name, str) and name in ENDINGS for name in given)
    if not known:
        raise ProblemError(
            f"`platforms` must be host, all, or one or more of {', '.join(ENDINGS)}; "
            f"got {describe(options.platforms)}"
        )
    if given and options.sources_only:
        raise ProblemError("`platforms` and `sources_only` exclude each other; got both")
    return tuple(name for name in ENDINGS if name in given)


def _of_host(name: str, source: bytes) -> Files:
    """Return the library of this platform by its place; nothing where it cannot be built."""
    own = own_platform()
    if own is None:
        _warn(f"FMI 2.0 has no name for {sys.platform} {platform.machine()}")
        return {}
    try:
        find_compiler()
    except KernelBuildError as error:
        _warn(str(error))
        return {}
    return build(name, source, [own])


def _warn(reason: str) -> None:
    warn(f"the FMU has no binary, only sources: {reason}")


def _source(plan: Plan, guid: str) -> bytes:
    """Return the C source: what the policy is, as constants and tables, then what it does."""
    policy, domain = plan.policy, plan.policy.space
    features = features_of(plan.cells)
    lines = [f"/* {line.replace('*/', '* /').replace('/*', '/ *')} */" for line in plan.header]
    lines += [
        "#include <stdint.h>",
        "",
        f"#define STATES {domain.n}",
        f"#define PLACES {domain.n + (len(features.names) if features else 0)}",
        f"#define CONTROLS {policy.alphabet.m}",
        f'#define GUID "{guid}"',
        f"#define SAFE {plan.safe}",
        f"#define NEAREST {int(plan.nearest)}",
        f"#define GAP {plan.gap}",
        *([] if plan.has_state else [f"#define DWELL {plan.dwell_s!r}"]),
        f"#define OUTSIDE_AT_ONCE {int(OUTSIDE in plan.at_once)}",
        "",
        _table("double", "LOWER[STATES]", domain.lower.tolist()),
        _table("double", "UPPER[STATES]", domain.upper.tolist()),
        _table("int", "PERIODIC[STATES]", [int(p) for p in domain.periodic]),
        _table("double", "SCALE[STATES]", plan.scale.tolist()),
        _table("double", "OFFSET[STATES]", plan.offset.tolist()),
        _table("int32_t", "COUNTS[STATES]", plan.counts),
        _table("double", f"CONTROL[{plan.labels}][CONTROLS]", policy.controls.tolist()),
        *(_memory(plan) if plan.has_state else []),
        *_arrays(plan),
        *_ranks(features),
        "",
    ]
    text = resources.files("capsyn.exports.fmu").joinpath("fmu.c").read_text(encoding="utf-8")
    known = {"REMEMBERS": plan.has_state, "PRICES": plan.cells.priced}
    return ("\n".join(lines) + "\n" + _resolved(text, known)).encode()


def _resolved(text: str, known: Mapping[str, bool]) -> str:
    """Return source text with each ``#ifdef`` of known names carried out, and others left alone."""
    block = rf"#ifdef ({'|'.join(known)})\n(.*?)(?:#else\n(.*?))?#endif\n"  # none in another

    def chosen(match: re.Match[str]) -> str:
        return match[2] if known[match[1]] else match[3] or ""

    return re.sub(block, chosen, text, flags=re.DOTALL)


def _memory(plan: Plan) -> list[str]:
    """Return what follows which symbol in force, and what its changes wait for, by number."""
    rules, times = plan.policy.rules, times_of(plan)
    forbidden = plan.forbidden
    rows, labels = plan.transitions.shape
    return [
        f"#define LABELS {labels}",
        f"#define ROWS {rows}",
        f"#define TIMES {len(times.seconds)}",
        f"#define HOLD_OFF {times.hold_off}",
        f"#define FORBIDDEN {len(forbidden)}",
        _table(
            f"{smallest_type(plan.transitions)}_t",
            f"TRANSITIONS[{rows}][LABELS]",
            plan.transitions.tolist(),
        ),
        _table("double", "LEAST[TIMES + 1]", [*times.seconds, 0.0]),
        _table("int", "HOLD[LABELS]", times.of_labels),
        _table("int", "INPUT_HOLD[CONTROLS]", times.of_inputs),
        _table("int", "KIND[LABELS]", rules.kinds.tolist()),
        _table("int", f"NO[{max(1, len(forbidden))}][2]", forbidden or [[0, 0]]),
    ]


def _arrays(plan: Plan) -> list[str]:
    """Return what lookups need of the cells or the tree, as they are written."""
    cells = plan.cells
    return _nodes(cells) if isinstance(cells, SplitTree) else _cells(cells, plan.default)


def _ranks(features: Features | None) -> list[str]:
    """Return the macro that puts the ranks of features after the steps."""
    if features is None:
        return ["#define RANKS"]
    body = [f"    {line}" for line in c_ranks(features, "z[{}]")]
    function = ["static void put_ranks(int *z) {", *body, "}"]
    return ["#include <math.h>", *function, "#define RANKS put_ranks(z);"]


def _nodes(tree: SplitTree) -> list[str]:
    planes = tree.planes if len(tree.planes) else np.zeros((1, tree.n), dtype=np.int32)
    return [
        _table("int32_t", f"SPLIT[{tree.node_count}]", tree.split.tolist()),
        _table("int32_t", f"THRESHOLD[{tree.node_count}]", tree.threshold.tolist()),
        _table("int32_t", f"SECOND[{tree.node_count}]", tree.second.tolist()),
        _table("int32_t", f"PLANES[{len(planes)}][PLACES]", planes.tolist()),
    ]


def _cells(cells: CellTree, default: int) -> list[str]:
    none = np.zeros(1, dtype=np.int32)
    tables = ((name, array if len(array) else none) for name, array, _ in cell_tables(cells))
    return [
        f"#define CELLS {1 if cells.splits is None else 2}",
        f"#define DEFAULT {default}",
        *(
            _table(f"{smallest_type(array)}_t", f"{name}[{len(array)}]", array.tolist())
            for name, array in tables
        ),
    ]


def _table(kind: str, name: str, values: Sequence[Any]) -> str:
    rows = ["{" + ", ".join(map(repr, v)) + "}" if isinstance(v, list) else repr(v) for v in values]
    text = textwrap.fill(", ".join(rows), 96, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name} = {{\n{text}\n}};"
