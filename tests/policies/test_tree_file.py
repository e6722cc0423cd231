"""Files of decision trees: save and load is equality; whatever else a file holds is refused."""

import dataclasses

import numpy as np
import pytest
from safetensors.numpy import save_file

from capsyn import DecisionTree, Policy
from capsyn.policies.file import VERSION, content_hash
from support.policy_files import (
    TRIALS,
    array,
    assert_equal,
    at,
    canonical,
    delete,
    full,
    full_tree,
    put,
    read,
    refuse,
    resize,
    rewrite,
    set_version,
    with_header,
)
from support.split_trees import BOXED, guarantee, random_split_tree, tree_of


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "p.cap"
    full_tree().save(path)
    return path


SOME = {
    "oblique": full_tree(3),
    "axes": full_tree(0),
    "one leaf": tree_of((7,), cells=random_split_tree((7,), depth=0)),
    "with evidence": full_tree().with_evidence(monte_carlo=TRIALS),
    "plain guarantee": full_tree(0, guarantee=guarantee()),
    **{f"lattice {k}": tree_of(counts, k % 3, 1, k) for k, counts in enumerate(BOXED)},
}


@pytest.mark.parametrize("name", SOME)
def test_save_and_load_is_equality(name, tmp_path):
    tree = SOME[name]
    tree.save(tmp_path / "p.cap")
    loaded = Policy.load(tmp_path / "p.cap")
    assert type(loaded) is DecisionTree
    assert_equal(loaded, tree)
    loaded.save(tmp_path / "again.cap")
    assert (tmp_path / "again.cap").read_bytes() == (tmp_path / "p.cap").read_bytes()
    assert content_hash(loaded) == content_hash(tree) == read(tmp_path / "p.cap")[0]["sha256"]
    assert read(tmp_path / "p.cap")[0]["version"] == 2
    states = tree.domain.sample(200)
    assert np.array_equal(loaded(states), tree(states))


def test_cells_are_still_written_as_version_1(tmp_path):
    full().save(tmp_path / "p.cap")
    assert read(tmp_path / "p.cap")[0]["version"] == 1
    rewrite(tmp_path / "p.cap", set_version(2))
    assert type(Policy.load(tmp_path / "p.cap")) is Policy


def test_the_hash_is_that_of_every_field():
    base = full_tree()
    cells, held = base.cells, base.guarantee
    leaf = int(np.flatnonzero(cells.split == -1)[0])
    others = [
        full_tree(name="other"),
        full_tree(guarantee=dataclasses.replace(held, agreeing=8)),
        full_tree(cells=dataclasses.replace(cells, counts=(12, 19))),
        full_tree(cells=dataclasses.replace(cells, planes=cells.planes + np.int32(1))),
        full_tree(
            cells=dataclasses.replace(
                cells, threshold=put(leaf, (cells.threshold[leaf] + 1) % 3)(cells.threshold.copy())
            )
        ),
    ]
    assert len({content_hash(tree) for tree in (base, *others)}) == len(others) + 1


LAST = full_tree().cells.node_count - 1


INNER = int(np.flatnonzero(full_tree().cells.split >= 0)[-1])


TYPE = "must be one-dimensional int32"


SENSE = "the guarantee of a tree does not make sense"


held = "guarantee"


TAMPERED = {
    # arrays
    "unknown axis": (array("split", put(INNER, 99)), "splits an unknown axis"),
    "plane used out of order": (array("split", put(INNER, 3)), "use each plane of the tree once"),
    "axis far off": (array("split", put(INNER, 2**31 - 1)), "splits an unknown axis"),
    "axis below": (array("split", put(LAST, -2)), "splits an unknown axis"),
    "inner end": (array("split", put(LAST, 0)), "."),
    "unknown label": (array("threshold", put(LAST, 3)), "unknown label"),
    "negative label": (array("threshold", put(LAST, -1)), "unknown label"),
    "cycle": (array("second", put(INNER, 0)), "in depth-first order"),
    "itself": (array("second", put(INNER, INNER)), "in depth-first order"),
    "beyond": (array("second", put(0, LAST + 1)), "in depth-first order"),
    "two parents": (array("second", put(0, LAST)), "in depth-first order"),
    "shorter": (array("second", lambda x: x[:-1]), "differ in length"),
    "longer": (array("threshold", lambda x: np.append(x, x[-1:])), "differ in length"),
    "empty": (
        lambda d, a: a.update({k: a[k][:0] for k in ("split", "threshold", "second")}),
        "or are empty",
    ),
    "no planes": (array("planes", lambda x: x[:0]), "unknown axis"),
    "planes of 3": (array("planes", lambda x: np.hstack([x, x[:, :1]])), "2 coefficients"),
    "huge planes": (array("planes", lambda x: x * 0 + np.int32(2**31 - 1)), "beyond 32 bits"),
    # types
    "64 bits": (array("split", lambda x: x.astype(np.int64)), TYPE),
    "unsigned": (array("second", lambda x: x.view(np.uint32)), TYPE),
    "floats": (array("threshold", lambda x: x.astype("f4")), TYPE),
    "8 bits": (array("split", lambda x: x.astype("i1")), TYPE),
    "2-D": (array("split", lambda x: x[None]), TYPE),
    "flat planes": (array("planes", lambda x: x.ravel()), "'planes' must be two-dimensional int32"),
    "3-D planes": (array("planes", lambda x: x[None]), "'planes' must be two-dimensional int32"),
    "planes of floats": (
        array("planes", lambda x: x.astype("f8")),
        "must be two-dimensional int32",
    ),
    "a missing array": (lambda d, a: a.pop("planes"), "does not hold the arrays"),
    "one more array": (lambda d, a: a.update(x=np.zeros(1)), "does not hold the arrays"),
    "arrays of both": (
        lambda d, a: a.update(entries=np.zeros(1, np.int32)),
        "does not hold the arrays",
    ),
    "arrays of cells": (
        lambda d, a: [
            a.clear(),
            a.update(
                entries=np.full(1, -1, np.int32),
                mixed_cells=np.zeros(0, np.int32),
                mixed_labels=np.zeros(0, np.uint64),
            ),
        ],
        "keys are not those",
    ),
    # keys and versions
    "version 1": (set_version(1), "keys are not those of this format version"),
    "newer version": (set_version(VERSION + 1), "upgrade"),
    "one key more": (lambda d, a: d["policy"].update(extra=1), "keys are not those"),
    "gaps too early": (lambda d, a: d["policy"].update(gaps=True), "keys are not those"),
    "keys of cells": (lambda d, a: d["policy"].update(partitions=[3, 2]), "keys are not those"),
    "no counts": (delete("counts"), "keys are not those"),
    "no guarantee": (delete("guarantee"), "keys are not those"),
    "no domain": (delete("domain"), "keys are not those"),
    # counts
    "huge counts": (at("counts")([2**31, 18]), r"`counts\[0\]` must be"),
    "counts past any float": (at("counts")([10**400, 18]), r"`counts\[0\]` must be"),
    "counts that planes forbid": (at("counts")([2**31 - 1] * 2), "beyond 32 bits"),
    "no steps": (at("counts")([0, 18]), r"`counts\[0\]` must be"),
    "negative counts": (at("counts")([12, -18]), r"`counts\[1\]` must be"),
    "broken counts": (at("counts")([12.0, 18]), r"`counts\[0\]` must be"),
    "counts of 3": (at("counts")([12, 18, 1]), "`counts` must be"),
    "counts of text": (at("counts")("12"), "`counts` must be"),
    "counts of nothing": (at("counts")(None), "`counts` must be"),
    "domain too narrow": (at("domain", "upper")([1e-310, 5]), "`max_level` is too high|steps of"),
    # the guarantee
    "guarantee a list": (at(held)([1]), "TypeError"),
    "guarantee a text": (at(held)("exact"), "TypeError"),
    "guarantee of nothing": (at(held)(None), "TypeError"),
    "guarantee empty": (at(held)({}), "TypeError"),
    "guarantee with more": (lambda d, a: d["policy"][held].update(x=1), "TypeError"),
    "guarantee with less": (delete(held, "source"), "TypeError"),
    "mode unknown": (at(held, "mode")("any"), "`mode` must be"),
    "mode a list": (at(held, "mode")(["exact"]), "`mode` must be"),
    "controller unknown": (at(held, "controller")("any"), "`controller` must be"),
    "source of text": (at(held, "source")("\x1b[31m" + "0" * 59), SENSE),
    "source a list": (at(held, "source")(["0"] * 64), SENSE),
    "level negative": (at(held, "level")(-1), SENSE),
    "level huge": (at(held, "level")(10**400), SENSE),
    "level of text": (at(held, "level")("1"), SENSE),
    "changed beyond 1": (at(held, "changed")(1.5), SENSE),
    "changed huge": (at(held, "changed")(10**400), SENSE),
    "changed of nothing": (at(held, "changed")(None), SENSE),
    "states huge": (at(held, "states")(10**400), SENSE),
    "states broken": (at(held, "states")(10.5), SENSE),
    "states true": (at(held, "states")(True), SENSE),
    "more agree": (at(held, "agreeing")(11), SENSE),
    "target beyond 1": (at(held, "target")(2), SENSE),
    # the rest is that of all policies
    "outside no symbol": (at("outside")(2), "`outside` must be"),
    "name with an escape": (at("name")("\x1b[31m"), "`name` must be a printable string"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_tampered_content_with_a_valid_checksum_is_refused(name, file):
    change, message = TAMPERED[name]
    before = file.read_bytes()
    rewrite(file, change)
    assert file.read_bytes() != before
    refuse(file, message)


@pytest.mark.parametrize("value", ["", [], {}, False])
def test_a_target_of_another_kind_is_refused(file, value):
    rewrite(file, at(held, "target")(value))
    refuse(file, SENSE)


def test_a_guarantee_of_states_without_a_controller_is_refused(file):
    rewrite(file, at(held, "controller")(""))
    refuse(file, SENSE)


def test_changes_do_not_match_the_checksum(file):
    before = file.read_bytes()
    for change in (
        at(held, "agreeing")(10),
        at(held, "mode")("exact"),
        at("counts")([12, 19]),
        array("threshold", put(LAST, 0)),
        array("planes", lambda x: x + np.int32(1)),
    ):
        file.write_bytes(before)
        rewrite(file, change, checksum=False)
        assert file.read_bytes() != before
        refuse(file, "content does not match its checksum")


def test_version_1_knows_no_arrays_of_trees(tmp_path):
    path = tmp_path / "p.cap"
    full().save(path)

    def change(document, arrays):
        arrays.clear()
        arrays.update({k: getattr(full_tree().cells, k) for k in ("split", "threshold", "second")})
        arrays["planes"] = np.ascontiguousarray(full_tree().cells.planes)

    rewrite(path, change)
    refuse(path, "keys are not those of this format version")
    full_tree().save(path)
    for version in (1, 0, None, "2", 2.0, True):
        full_tree().save(path)
        rewrite(path, set_version(version))
        refuse(path, "keys are not those|it has no format version")


@pytest.mark.parametrize("name", ["split", "planes"])
@pytest.mark.parametrize(
    ("dtype", "size"), [("BF16", 2), ("F16", 2), ("U8", 1), ("I64", 8), ("F32", 4), ("X9", 8)]
)
def test_other_types_of_arrays_are_refused(file, name, dtype, size):
    with_header(file, resize(name, dtype, size))
    refuse(file, "is no policy file|must be .*-dimensional int32")


def test_trees_that_are_too_deep_are_refused(file):
    depth = 1001

    def change(document, arrays):
        split = np.append(np.tile([0, -1], depth), -1)
        second = np.arange(2 * depth + 1)
        second[:-1:2] += 2
        kinds = {"split": split, "threshold": 0 * split, "second": second}
        arrays.update({k: v.astype(np.int32) for k, v in kinds.items()})

    rewrite(file, change)
    refuse(file, "takes more than 1000 comparisons")


def test_not_a_number_is_no_json_number(file):
    document, arrays = read(file)
    document["policy"][held]["low"] = float("nan")
    save_file(arrays, file, {"capsyn-policy": canonical(document)})
    refuse(file, "is damaged: ValueError")
