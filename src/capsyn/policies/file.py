"""Policy files: safetensors with one metadata key that holds JSON. See docs/policy-format.md.

What is saved is read from attributes, and what is loaded are fields: the file need not know the
class of a policy, which knows its file.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from capsyn.cells.affine_leaves import PRICE_ARRAYS, ROW_ARRAYS, AffineLeaves
from capsyn.cells.cell_tree import CELL_ARRAYS, SEEN_ARRAYS, SPLIT_ARRAYS, CellTree
from capsyn.cells.feature_tree import Features, FeatureTree
from capsyn.cells.masks import WORD, word_count
from capsyn.cells.split_tree import TREE_ARRAYS, SplitTree
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.execution.answers import digest
from capsyn.execution.files import atomic_write, save_arrays
from capsyn.execution.memory import check_memory
from capsyn.limits.kept import KEPT_ARRAYS, Kept
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.domain import Ball, Box
from capsyn.modelling.exogenous import check_exogenous, joined
from capsyn.modelling.grid import MAX_COUNT, Grid
from capsyn.modelling.settings import SsacSettings
from capsyn.modelling.switching import Switching
from capsyn.modelling.targets import Target
from capsyn.policies.checks import checked_statistics
from capsyn.policies.evidence import EVIDENCE, is_evidence
from capsyn.policies.guarantee import Guarantee
from capsyn.programs.model import Model
from capsyn.programs.program import Program
from capsyn.validation import describe, whole_numbers

Made = TypeVar("Made")

FORMAT = "capsyn-policy"
VERSION = 13
"""Newest version: cells are 1, decision trees 2, affine leaves 3, any of them with gaps 4, cells
split along some axes only 5, another unit of time than the second, or `outside_at_once`, 6, trees
with features 7, more than 63 symbols, or some of equal control, 8, what depends on the symbol in
force, has prices or least times of its own, or compensates a delay, 9, what is told exogenous
inputs, was cut at some, or predicts under a default law, 10, trees judged by closed loops 11,
models with limits, and policies that keep them, 12, models in discrete time 13."""
CELL_ENTRIES = ("entries", "mixed_cells")
"""The arrays of all cells, whatever is known of the mixed ones."""
TRANSITIONS = {"transitions": np.uint16}
"""The rows of a transition function, (R - N - 1, N + 1), that are not constant, in order."""
ALL_ARRAYS = CELL_ARRAYS | ROW_ARRAYS | SPLIT_ARRAYS | SEEN_ARRAYS | TREE_ARRAYS | PRICE_ARRAYS
ALL_ARRAYS |= TRANSITIONS | KEPT_ARRAYS
"""All arrays that a file may hold, and their types."""
ARRAYS = [
    {*arrays, *transitions, *kept}
    for arrays in (
        TREE_ARRAYS,
        *(
            {*CELL_ENTRIES, *seen, *rows, *splits}
            for seen in (("mixed_labels",), SEEN_ARRAYS)
            for rows in ((), ROW_ARRAYS, {**ROW_ARRAYS, **PRICE_ARRAYS})
            for splits in ((), SPLIT_ARRAYS)
        ),
    )
    for transitions in ((), TRANSITIONS)
    for kept in ((), KEPT_ARRAYS)
]
"""The sets of arrays that a file may hold."""
PLANAR = {"planes", "row_slopes", "row_ratios", "transitions", "kept_rows", *SEEN_ARRAYS}
"""Those of two dimensions."""
KEYS = set(
    "name domain alphabet default outside min_dwell target horizon settings model "
    "statistics".split()
)
CELL_KEYS = KEYS | {"partitions", "refinement", "max_level"}
TREE_KEYS = KEYS | {"counts", "guarantee"}
RARE_KEYS = {"gaps", "time_unit", "outside_at_once", "features", "switching", "delay", "exogenous"}
RARE_KEYS |= {"kept"}
"""Keys that are there where they say something else than False, s, none, and 0."""


def save(policy: Any, path: str | os.PathLike[str]) -> None:
    """Write a policy file atomically; the same policy gives the same bytes."""
    content, arrays = content_of(policy), _arrays(policy)
    document = {
        "format": FORMAT,
        "version": _least_version(arrays, content),
        "policy": content,
        "sha256": digest(arrays, _canonical(content)),
    }
    if policy.evidence.get("sha256") == document["sha256"]:  # that of another content is dropped
        document["evidence"] = policy.evidence
    metadata = {FORMAT: _canonical(document)}
    atomic_write(path, lambda temporary: _write(arrays, temporary, metadata))


def _arrays(policy: Any) -> dict[str, np.ndarray]:
    """Return the arrays of a policy by their names in a file."""
    rows = policy.transitions[len(policy.alphabet) + 1 :]
    table = {"transitions": rows.astype(TRANSITIONS["transitions"])} if len(rows) else {}
    kept = {} if policy.kept is None else policy.kept.arrays()
    return {**policy.cells.arrays(), **table, **kept}


def _write(arrays: dict[str, np.ndarray], path: Path, metadata: dict[str, str]) -> None:
    save_arrays({k: np.ascontiguousarray(v) for k, v in arrays.items()}, path, metadata)


def _canonical(data: Any) -> str:
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_of(policy: Any) -> dict[str, Any]:
    """Return what a policy's file says of it beside its arrays, as plain data."""
    target = policy.target
    kind = {Ball: "ball", Box: "box", Program: "program", type(None): ""}[type(target)]
    return {
        **policy.structure(),
        **({"gaps": True} if policy.gaps else {}),
        **({} if policy.time_unit == "s" else {"time_unit": policy.time_unit}),
        **({"outside_at_once": True} if policy.outside_at_once else {}),
        **({} if policy.switching is None else {"switching": policy.switching.to_json()}),
        **({"delay": policy.delay} if policy.delay else {}),
        **({} if policy.kept is None else {"kept": policy.kept.to_json()}),
        **({} if policy.exogenous is None else {"exogenous": policy.exogenous.to_json()}),
        "name": policy.name,
        "domain": policy.domain.to_json(),
        "alphabet": policy.alphabet.to_json(),
        "default": policy.default.tolist(),
        "outside": policy.outside,
        "min_dwell": policy.min_dwell,
        "target": None if target is None else {kind: target.to_json()},
        "horizon": policy.horizon,
        "settings": None if policy.settings is None else policy.settings.to_json(),
        "model": None if policy.model is None else policy.model.to_json(),
        "statistics": policy.statistics,
    }


def content_hash(policy: Any) -> str:
    """Return the SHA-256 of what the policy is, the same that its file carries."""
    return digest(_arrays(policy), _canonical(content_of(policy)))


def _least_version(arrays: dict[str, np.ndarray], content: dict[str, Any]) -> int:
    """Return the first version that has files with such arrays and content."""
    values = [tuple(value) for value in content["alphabet"]["values"]]
    model = content["model"] if isinstance(content["model"], dict) else {}
    news = {"transitions", "row_prices", "mixed_sets"} & set(arrays)
    needed = {
        13: "sample_time" in model,
        12: "kept" in content or "limits" in model,
        11: "loop" in content.get("guarantee", {}),
        10: "exogenous" in content
        or "prediction" in model
        or "cut" in content.get("guarantee", {}),
        9: bool(news) or "switching" in content or "delay" in content,
        8: len(values) >= WORD or len(set(values)) < len(values),
        7: "features" in content,
        6: "time_unit" in content or "outside_at_once" in content,
        5: "splits" in arrays,
        4: "gaps" in content,
        3: "row_starts" in arrays,
        2: "split" in arrays,
    }
    return next((version for version, news in needed.items() if news), 1)


def load(path: str | os.PathLike[str], make: Callable[[dict[str, Any]], Made]) -> Made:
    """Return what is made of the fields of the policy in a file, every size and value checked.

    `make` takes the fields of a `Policy` by name; those of a `DecisionTree` have a ``guarantee``. A
    file that is no policy, damaged, tampered with, or newer is a `PolicyFormatError`.
    """
    from safetensors import SafetensorError, safe_open

    if os.path.exists(path) and not os.path.isfile(path):
        raise PolicyFormatError(f"'{path}' is no file")
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            if FORMAT not in metadata:
                raise PolicyFormatError(f"'{path}' is a safetensors file but no policy")
            document = _parse(metadata[FORMAT], path)
            if set(file.keys()) not in ARRAYS:
                raise PolicyFormatError(f"'{path}' does not hold the arrays of a policy")
            arrays = {name: file.get_tensor(name) for name in sorted(file.keys())}
    except FileNotFoundError:
        raise PolicyFormatError(f"there is no file '{path}'") from None
    except PermissionError:
        raise PolicyFormatError(f"'{path}' cannot be read: permission denied") from None
    except PolicyFormatError:
        raise
    except (SafetensorError, OSError, ValueError, TypeError, AttributeError, KeyError) as error:
        # the last two: types of array that NumPy does not have
        raise PolicyFormatError(f"'{path}' is no policy file, or a truncated one") from error
    try:
        return make(_fields(document, arrays))
    except (PolicyFormatError, ProblemError) as error:
        raise PolicyFormatError(f"'{path}' is damaged: {error}") from None
    except (
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        ArithmeticError,
        RecursionError,
    ) as error:
        raise PolicyFormatError(f"'{path}' is damaged: {type(error).__name__} {error}") from None


def _parse(text: str, path: str | os.PathLike[str]) -> dict[str, Any]:
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        raise PolicyFormatError(f"'{path}' is damaged: its metadata is not JSON") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise PolicyFormatError(f"'{path}' is no policy file")
    version = document.get("version")
    if type(version) is not int or version < 1:
        raise PolicyFormatError(f"'{path}' is damaged: it has no format version")
    if version > VERSION:
        raise PolicyFormatError(
            f"'{path}' has format version {version}; this capsyn reads up to {VERSION}: upgrade it"
        )
    return document


def _fields(document: dict[str, Any], arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the fields of the policy in a document and its arrays."""
    content = document["policy"]
    is_tree = "split" in arrays
    for name in arrays:
        dtype = ALL_ARRAYS[name]
        axes, words = (2, "two") if name in PLANAR else (1, "one")
        wide = name == "mixed_labels" and arrays[name].ndim == 3  # for more than one word
        if arrays[name].dtype != dtype or not (arrays[name].ndim == axes or wide):
            raise PolicyFormatError(f"array '{name}' must be {words}-dimensional {np.dtype(dtype)}")
    if document["sha256"] != digest(arrays, _canonical(content)):
        raise PolicyFormatError("its content does not match its checksum")
    if not _has_its_keys(content, is_tree) or document["version"] < _least_version(arrays, content):
        raise PolicyFormatError("its keys are not those of this format version")
    domain, alphabet = Box(**content["domain"]), Alphabet(**content["alphabet"])
    told = Box(**content["exogenous"]) if "exogenous" in content else None
    space = joined(domain, exogenous := check_exogenous(told, domain, alphabet))
    if told is not None and exogenous is not None and told.names != exogenous.names:
        raise PolicyFormatError("its exogenous inputs have no names of their own")
    settings, model = content["settings"], content["model"]
    if model is not None:
        model = Model.from_json(model, space.n, alphabet.m, len(alphabet))
    fields = {key: content[key] for key in ("name", "default", "outside", "min_dwell", "horizon")}
    fields |= {
        "domain": domain,
        "exogenous": exogenous,
        "alphabet": alphabet,
        "target": _target(content["target"]),
        "settings": None if settings is None else _settings(settings),
        "model": model,
        "statistics": checked_statistics(content["statistics"]),
        "evidence": _evidence(document),
        "gaps": "gaps" in content,
        "time_unit": content.get("time_unit", "s"),
        "outside_at_once": "outside_at_once" in content,
        "switching": Switching(**content["switching"]) if "switching" in content else None,
        "delay": content.get("delay", 0.0),
        "transitions": _transitions(arrays.pop("transitions", None), len(alphabet) + 1),
        "kept": _kept(content, arrays, len(alphabet) + 1, space),
    }
    if is_tree:
        counts = whole_numbers("counts", content["counts"], space.n, least=1, most=MAX_COUNT)
        space.check_resolution(counts)
        tree = SplitTree(counts, **arrays)
        if "features" in content:
            tree = FeatureTree(counts, **arrays, features=Features.from_json(content["features"]))
        return fields | {"cells": tree, "guarantee": Guarantee.from_json(content["guarantee"])}
    grid = Grid.of(content["partitions"], content["refinement"], content["max_level"], space.n)
    affine = None
    if "row_starts" in arrays:
        first = len(alphabet) + 1 if fields["transitions"] is None else len(fields["transitions"])
        tables = [arrays[name] for name in (*ROW_ARRAYS, *PRICE_ARRAYS) if name in arrays]
        affine = AffineLeaves(first, *tables)
    space.check_resolution(grid.counts)
    seen, (entries, mixed) = _seen(arrays, len(alphabet) + 1), (arrays[k] for k in CELL_ENTRIES)
    return fields | {"cells": CellTree(grid, entries, mixed, seen, affine, arrays.get("splits"))}


def _kept(
    content: dict[str, Any], arrays: dict[str, np.ndarray], labels: int, space: Box
) -> Kept | None:
    """Return the states from which limits are kept; their arrays are taken out."""
    own = {name: arrays.pop(name) for name in KEPT_ARRAYS if name in arrays}
    if bool(own) != ("kept" in content):
        raise PolicyFormatError("its keys are not those of this format version")
    return Kept.from_file(content["kept"], own, labels, space) if own else None


def _has_its_keys(content: Any, is_tree: bool) -> bool:
    """Return whether content has the keys of its kind, and rare ones where they say something."""
    return (
        set(content) - RARE_KEYS == (TREE_KEYS if is_tree else CELL_KEYS)
        and all(content.get(key, True) is True for key in ("gaps", "outside_at_once"))
        and content.get("time_unit") != "s"
        and content.get("delay", 1.0) != 0
        and (is_tree or "features" not in content)
        and ("cut" not in content.get("guarantee", {}) or content["guarantee"]["cut"] is True)
    )


def _seen(arrays: dict[str, np.ndarray], labels: int) -> np.ndarray:
    """Return the sets of so many labels seen in mixed cells, their sizes checked before."""
    if "mixed_sets" not in arrays:
        return arrays["mixed_labels"]
    sets, places = arrays["mixed_sets"], arrays["mixed_places"]
    fit = places.shape == (len(arrays["mixed_cells"]), labels)
    if not fit or sets.shape[1] != word_count(labels):
        raise PolicyFormatError("the sets of labels seen in mixed cells are of other sizes")
    if (places < 0).any() or (places >= len(sets)).any():
        raise PolicyFormatError("the sets of labels seen in mixed cells are not there")
    check_memory(float(places.size) * 8 * sets.shape[1], "its sets of labels")
    return sets[places]


def _transitions(rows: np.ndarray | None, count: int) -> np.ndarray | None:
    """Return the whole table of rows, of those that are not constant."""
    if rows is None:
        return None
    if not len(rows) or rows.shape[1] != count:
        raise PolicyFormatError("its transitions are none of its symbols")
    constant = np.repeat(np.arange(count, dtype=np.int32)[:, None], count, axis=1)
    return np.concatenate([constant, rows.astype(np.int32)])


def _settings(data: dict[str, Any]) -> SsacSettings:
    known = {f.name for f in dataclasses.fields(SsacSettings)}
    if set(data) - known:
        raise PolicyFormatError("its settings are not those of this format version")
    if data.get("sample_time", 0) is None:
        raise PolicyFormatError("its settings say no sample time")
    # settings that came later have their defaults, which was this one of the first
    return SsacSettings(**{"sample_time": 0.001} | data)


def _evidence(document: dict[str, Any]) -> dict[str, Any]:
    """Return the evidence in a document, if it is about its content and of the kinds known."""
    evidence = document.get("evidence", {})
    if not isinstance(evidence, dict):
        raise PolicyFormatError("its evidence is no object")
    if evidence and evidence.get("sha256") != document["sha256"]:
        raise PolicyFormatError("its evidence is that of another policy")
    for kind in set(evidence) - {"sha256"}:
        if not is_evidence(kind, evidence[kind]):
            raise PolicyFormatError(f"its evidence '{kind}' is of another kind")
    return evidence


def add_evidence(policy: Any, kinds: dict[str, Any]) -> dict[str, Any]:
    """Return the evidence of a policy with some kinds added; see `Policy.with_evidence`."""
    for kind, data in kinds.items():
        try:
            _canonical(data)
        except (TypeError, ValueError):
            data = None
        if not is_evidence(kind, data):
            raise ProblemError(
                f"`{kind}` must be what to_json() of evidence of a kind ({', '.join(EVIDENCE)}) "
                f"gives; got {describe(data)}"
            )
    content = content_hash(policy)
    known = policy.evidence if policy.evidence.get("sha256") == content else {}
    return {**known, **kinds, "sha256": content}


def _target(data: Any) -> Target | None:
    if data is None:
        return None
    ((kind, value),) = data.items()
    if kind == "program":
        return Program.from_json(value)
    return {"ball": Ball, "box": Box}[kind](**value)
