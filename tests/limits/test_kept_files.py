"""Files of version 12: limits in the model, and from where they are kept."""

import functools

import numpy as np
import pytest

from capsyn import KeepLimits, Policy, Switching, compress, synthesize
from support.policy_files import at, read, refuse, rewrite, set_version
from support.proofs.limits import double_integrator


@functools.cache
def policy(case):
    if case == "limits":
        return synthesize(double_integrator(max_level=1))
    more = {"switching": Switching(price="3%")} if case == "remembers" else {}
    kept = synthesize(double_integrator(max_level=1, **more), keep_limits=KeepLimits((120, 90)))
    return compress(kept) if case == "tree" else kept


CASES = ["limits", "plain", "remembers", "tree"]


@pytest.mark.parametrize("case", CASES)
def test_files_come_back_as_they_were(case, tmp_path):
    path, made = tmp_path / "p.cap", policy(case)
    made.save(path)
    first = path.read_bytes()
    document, arrays = read(path)
    assert document["version"] == 12
    assert {"kept_entries", "kept_rows"} <= set(arrays) or case == "limits"
    again = Policy.load(path)
    assert type(again) is type(made) and again.model.limits == made.model.limits
    again.save(path)
    assert path.read_bytes() == first
    if case == "limits":
        assert again.kept is None
        return
    states = made.domain.sample(3000)
    for now in range(3):
        same = again.keeps_limits(states, current=now) == made.keeps_limits(states, current=now)
        assert same.all()
    assert again.kept.sample_time == made.kept.sample_time


def arrays_of(name, change):
    def changed(_, arrays):
        arrays[name] = np.ascontiguousarray(change(arrays[name]))

    return changed


def without(*names):
    def change(document, arrays):
        for name in names:
            arrays.pop(name, None)
            document["policy"].pop(name, None)

    return change


def limits(**change):
    def changed(document, _):
        document["policy"]["model"]["limits"].update(change)

    return changed


TAMPERED = {
    "an older version": ("plain", set_version(11), "not those of this format version"),
    "limits of an older version": ("limits", set_version(1), "not those of this format version"),
    "limits of nothing": ("limits", at("model", "limits")(5), "a program in the file is malformed"),
    "limits of other sizes": ("limits", limits(inputs=[["x", 3]]), "malformed|other sizes"),
    "limits of another name": ("limits", limits(outputs=[["cost", 4]]), "'limits' in the file has"),
    "kept of nothing": ("plain", at("kept")(None), "says of kept limits is of another kind"),
    "kept of a list": ("tree", at("kept")([1]), "says of kept limits is of another kind"),
    "kept of another grid": ("plain", at("kept", "partitions")([7, 9]), "cells"),
    "kept of too few axes": ("plain", at("kept", "partitions")([7]), "`partitions` must"),
    "no sample time": ("plain", at("kept", "sample_time")(0), "`sample_time` must be"),
    "ranges of nothing": ("plain", at("kept", "parameters")([]), "is of another kind"),
    "ranges of words": ("plain", at("kept", "parameters")({"a": ["x", 1]}), "`a` must be"),
    "ranges of one": ("plain", at("kept", "parameters")({"a": [1]}), "ValueError"),
    "no kept": ("plain", without("kept"), "not those of this format version"),
    "kept without arrays": ("plain", without("kept_entries", "kept_rows"), "not those of this"),
    "one of two arrays": ("plain", without("kept_rows"), "does not hold the arrays of a policy"),
    "rows of others": (
        "remembers",
        arrays_of("kept_rows", lambda rows: rows[:, :3]),
        "none of its symbols",
    ),
    "rows of numbers": (
        "plain",
        arrays_of("kept_rows", lambda rows: rows + np.uint8(1)),
        "none of its symbols",
    ),
    "no rows": ("plain", arrays_of("kept_rows", lambda rows: rows[:0]), "none of its symbols"),
    "flat rows": ("plain", arrays_of("kept_rows", lambda rows: rows[:, 0]), "two-dimensional"),
    "rows of another type": (
        "plain",
        arrays_of("kept_rows", lambda rows: rows.astype(np.int32)),
        "two-dimensional uint8",
    ),
    "an unknown row": (
        "plain",
        arrays_of("kept_entries", lambda entries: np.where(entries == -1, -9, entries)),
        "unknown label",
    ),
    "half of the cells": ("plain", arrays_of("kept_entries", lambda e: e[: len(e) // 2]), "cells"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_tampered_content_with_a_valid_checksum_is_refused(name, tmp_path):
    case, change, message = TAMPERED[name]
    path = tmp_path / "p.cap"
    policy(case).save(path)
    before = path.read_bytes()
    rewrite(path, change)
    assert path.read_bytes() != before
    refuse(path, message)
