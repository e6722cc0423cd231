"""Policy files: save and load is equality; whatever else a file holds is refused."""

import copy
import dataclasses
import os
import socket
import struct
import subprocess
import sys

import numpy as np
import pytest
from safetensors.numpy import save_file

import capsyn
from capsyn import Alphabet, Ball, Box, Policy, SsacSettings, problems
from capsyn.errors import PolicyFormatError, ProblemError
from capsyn.modelling.grid import Grid
from capsyn.modelling.targets import target_program
from capsyn.policies.file import VERSION, content_hash
from support.policy_files import (
    KEY,
    TRIALS,
    array,
    assert_equal,
    at,
    canonical,
    delete,
    digest,
    full,
    put,
    read,
    refuse,
    resize,
    rewrite,
    set_version,
    with_header,
)
from support.trees import GRIDS, random_policy, random_tree

SOME = {
    "full": full(),
    "box target, nearest": full(
        target=Box([0, 0], [1, 1], names=["ω", "theta"]), outside="nearest"
    ),
    "ball about one state": full(target=Ball([0.2], 0.3, names=["ω"])),
    "target a condition": full(target=target_program(Ball([0.1, 0.2], 0.3), full().domain)),
    "default outside": full(outside=-1),
    "with evidence": full().with_evidence(monte_carlo=TRIALS),
    "absolute sensitivity": full(settings=SsacSettings(alpha_d=-1.5, rule="steepest")),
    "bare": full(
        outside="error",
        min_dwell=0.0,
        target=None,
        horizon=None,
        settings=None,
        model=None,
        statistics={},
    ),
    "63 symbols": full(
        alphabet=Alphabet(range(63)),
        default=np.zeros(1),
        cells=random_tree((3, 20), (2, 3), 1, 64, seed=2),
        settings=None,
        model=None,
    ),
    **{f"grid {k}": random_policy(k, seed=k) for k in range(len(GRIDS))},
    **{f"adaptive {k}": random_policy(k, seed=k, some_axes=True) for k in range(len(GRIDS))},
}


@pytest.fixture
def file(tmp_path):
    """A saved policy that has everything."""
    path = tmp_path / "p.cap"
    full().save(path)
    return path


@pytest.fixture(scope="module")
def real():
    """A small policy as `synthesize` makes it."""
    return capsyn.synthesize(problems.plain("double-tank-a"), partitions=3, max_level=1)


@pytest.mark.parametrize("name", SOME)
def test_save_and_load_is_equality(name, tmp_path):
    path = tmp_path / "p.cap"
    SOME[name].save(path)
    loaded = Policy.load(str(path))
    assert_equal(loaded, SOME[name])
    assert loaded.timings == {}
    again = tmp_path / "again.cap"
    loaded.save(again)
    assert again.read_bytes() == path.read_bytes()
    assert content_hash(loaded) == content_hash(SOME[name])
    states = SOME[name].domain.sample(200)
    assert np.array_equal(loaded(states), SOME[name](states))


def test_a_synthesized_policy_is_saved_whole(real, tmp_path):
    real.save(tmp_path / "p.cap")
    loaded = Policy.load(tmp_path / "p.cap")
    assert_equal(loaded, real)
    assert loaded.model is not None and loaded.settings is not None and loaded.statistics["solves"]


def test_content_hash_is_that_of_the_file_and_of_every_field(file):
    base = content_hash(full())
    assert read(file)[0]["sha256"] == base
    assert content_hash(full(timings={"other": 1.0})) == base
    tree = full().cells
    labels = tree.mixed_labels | np.uint64(4)
    entries = tree.entries.copy()
    entries[-1] = -1 - (-entries[-1]) % 3
    others = [
        full(name="other"),
        full(domain=Box([0, -5], [6, 5])),
        full(alphabet=Alphabet([[-5, 1], [5, 0]])),
        full(default=np.array([0.1, 0.1])),
        full(cells=dataclasses.replace(tree, entries=entries)),
        full(cells=dataclasses.replace(tree, mixed_labels=labels)),
        full(cells=dataclasses.replace(tree, grid=tree.grid.at(3))),
        full(outside=0),
        full(min_dwell=0.02),
        full(target=None),
        full(horizon=1.3),
        full(settings=None),
        full(model=None),
        full(statistics={}),
    ]
    assert len({base, *map(content_hash, others)}) == len(others) + 1


def test_same_policy_same_bytes_in_any_process(tmp_path):
    code = (
        "import capsyn, numpy as np, sys\n"
        "box = capsyn.Box([0, 0], [1, 2], periodic=[True, False])\n"
        "label = lambda x: (np.sin(x[:, 0]) > x[:, 1]).astype(int)\n"
        "capsyn.subdivide(label, box, 2, max_level=2).save(sys.argv[1])\n"
    )
    found = []
    for number, zone in enumerate(("UTC", "Asia/Tokyo")):
        home = tmp_path / f"home{number}"
        home.mkdir()
        environment = {**os.environ, "PYTHONHASHSEED": str(number), "TZ": zone, "HOME": str(home)}
        command = [sys.executable, "-c", code, str(home / "p.cap")]
        subprocess.run(command, check=True, env=environment, cwd=home)
        found.append((home / "p.cap").read_bytes())
    assert found[0] == found[1]


def texts(data):
    """Yield every text in plain data."""
    if isinstance(data, dict):
        yield from data
        data = list(data.values())
    if isinstance(data, list):
        for value in data:
            yield from texts(value)
    elif isinstance(data, str):
        yield data


def test_no_dates_paths_or_host_names_in_a_file(real, tmp_path, monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "some-host-name")
    real.save(tmp_path / "p.cap")
    raw = (tmp_path / "p.cap").read_bytes()
    for place in (os.getcwd(), tmp_path, tmp_path.name, os.path.expanduser("~"), sys.prefix):
        assert len(str(place)) < 4 or str(place).encode() not in raw
    for host in {os.uname().nodename, "some-host-name"}:
        assert len(host) < 4 or host.encode() not in raw
    document, _ = read(tmp_path / "p.cap")
    keys = {"format", "version", "policy", "sha256"}
    assert set(document) == keys, "a new key: is it the same on every machine?"
    for text in texts(document):
        assert not text.startswith(("/", "C:")) and ":\\" not in text
        assert not any(c.isdigit() for c in text) or not set(text) <= set("0123456789-:T.Z+ ")


# what is no policy file


def test_rewriting_without_a_change_is_accepted(file):
    before = file.read_bytes()
    rewrite(file, lambda document, arrays: None)
    assert file.read_bytes() == before
    assert_equal(Policy.load(file), full())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "there is no file"),
        (b"", "is no policy file"),
        (b"\0" * 7, "is no policy file"),
        (b"\0" * 4096, "is no policy file"),
        (b"hello, this is a text and no policy", "is no policy file"),
        (b'{"format": "capsyn-policy"}', "is no policy file"),
        (b"PK\x03\x04" + bytes(range(256)) * 4, "is no policy file"),
        (struct.pack("<Q", 2) + b"{}", "is a safetensors file but no policy"),
    ],
)
def test_other_files_are_no_policies(tmp_path, content, message):
    path = tmp_path / "p.cap"
    if content is not None:
        path.write_bytes(content)
    refuse(path, message)


def test_random_bytes_and_directories_are_no_policies(tmp_path):
    refuse(tmp_path, "is no file")
    os.mkfifo(tmp_path / "pipe")
    refuse(tmp_path / "pipe", "is no file")
    rng = np.random.default_rng(0)
    for size in (1, 8, 9, 64, 1000, 100_000):
        for small in (False, True):  # a small header length goes further
            content = rng.bytes(size)
            (tmp_path / "p.cap").write_bytes(
                struct.pack("<Q", max(size - 8, 0)) + content[8:] if small else content
            )
            refuse(tmp_path / "p.cap", "is no policy file")


def test_other_safetensors_files_are_no_policies(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_file({"weight": np.zeros((3, 3), np.float32)}, path, {"format": "pt"})
    refuse(path, "is a safetensors file but no policy")
    save_file({"weight": np.zeros((3, 3), np.float32)}, path)
    refuse(path, "is a safetensors file but no policy")
    for text in ("{}", "[]", "null", '{"format":"other"}', '{"format":["capsyn-policy"]}'):
        save_file({"entries": np.zeros(1, np.int32)}, path, {KEY: text})
        refuse(path, "is no policy file")
    for text in ("", "{", "not JSON", '{"format":"capsyn-policy"'):
        save_file({"entries": np.zeros(1, np.int32)}, path, {KEY: text})
        refuse(path, "is damaged: its metadata is not JSON")


@pytest.mark.parametrize(
    ("version", "message"),
    [
        (VERSION + 1, f"has format version {VERSION + 1}; .* up to {VERSION}: upgrade it"),
        (10**30, "upgrade"),
        (0, "it has no format version"),
        (-1, "it has no format version"),
        (None, "it has no format version"),
        ("1", "it has no format version"),
        (1.0, "it has no format version"),
        (True, "it has no format version"),
    ],
)
def test_versions(file, version, message):
    rewrite(file, set_version(version))
    refuse(file, message)


def test_a_newer_version_says_so_whatever_else_it_holds(file):
    def change(document, arrays):
        document["version"] = VERSION + 1
        document["policy"] = {"all": "new"}
        arrays["masks"] = np.zeros(3, np.uint8)
        del arrays["entries"]

    rewrite(file, change)
    refuse(file, "upgrade")


@pytest.mark.parametrize(
    "change",
    [
        at("name")("other"),
        at("domain", "upper", 1)(6.0),
        at("domain", "periodic", 0)(False),
        at("alphabet", "values", 0, 0)(-4.0),
        at("default", 0)(0.0),
        at("outside")("nearest"),
        at("min_dwell")(0.5),
        at("target")(None),
        at("horizon")(2.0),
        at("settings", "gamma")(-5.0),
        at("model", "step", "instructions", 0, 1)(0.2),
        at("statistics", "solves")(1),
        at("partitions")([2, 3]),
    ],
)
def test_changed_content_does_not_match_its_checksum(file, change):
    rewrite(file, change, checksum=False)
    refuse(file, "content does not match its checksum")


def relabel(document, arrays):
    """Give one leaf that is not mixed another label."""
    leaves = np.flatnonzero(arrays["entries"] < 0)
    place = np.setdiff1d(leaves, arrays["mixed_cells"])[0]
    arrays["entries"][place] = -1 - (-arrays["entries"][place]) % 3


def test_changed_arrays_do_not_match_their_checksum(file):
    rewrite(file, relabel, checksum=False)
    refuse(file, "content does not match its checksum")
    rewrite(file, relabel)  # the checksum is no signature: with its own one it is another policy
    with pytest.raises(AssertionError, match="entries"):
        assert_equal(Policy.load(file), full())


FIRST_SPLIT = int(np.flatnonzero(full().cells.entries >= 0)[0])
LAST = len(full().cells.entries) - 1
BLOCKS = "the blocks of cells are not one after the other"
DEEPER = "the cells are deeper or more than the file says"
MIXED = "the mixed cells are no ascending leaf cells"

TAMPERED = {
    # the tree
    "a block that holds itself": (array("entries", put(FIRST_SPLIT, FIRST_SPLIT)), BLOCKS),
    "a reference back": (array("entries", put(LAST, 6)), "."),
    "an offset beyond the end": (array("entries", put(FIRST_SPLIT, LAST + 1)), BLOCKS),
    "the largest offset": (array("entries", put(FIRST_SPLIT, 2**31 - 1)), BLOCKS),
    "the last cell split": (array("entries", put(LAST, LAST + 1)), "."),
    "a label out of range": (array("entries", put(LAST, -4)), "a cell has an unknown label"),
    "the least label": (array("entries", put(LAST, -(2**31))), "a cell has an unknown label"),
    "trailing cells": (array("entries", lambda x: np.append(x, x[-1:])), "1 cells belong to no"),
    "a block cut off": (array("entries", lambda x: x[:-1]), DEEPER),
    "no cells": (array("entries", lambda x: x[:0]), "fewer"),
    "mixed cells unsorted": (array("mixed_cells", lambda x: x[::-1]), MIXED),
    "mixed cells negative": (array("mixed_cells", put(0, -1)), MIXED),
    "mixed cells beyond": (array("mixed_cells", put(-1, LAST + 1)), MIXED),
    "mixed cells split": (array("mixed_cells", lambda x: put(0, FIRST_SPLIT)(x)), MIXED),
    "fewer mixed labels": (array("mixed_labels", lambda x: x[1:]), "differ in number"),
    "mixed labels empty": (array("mixed_labels", lambda x: 0 * x), "not among the labels seen"),
    "mixed labels unknown": (array("mixed_labels", lambda x: x | np.uint64(8)), "unknown label"),
    # types
    "64-bit cells": (array("entries", lambda x: x.astype(np.int64)), "must be one-dimensional"),
    "unsigned cells": (array("entries", lambda x: x.view(np.uint32)), "must be one-dimensional"),
    "float cells": (array("entries", lambda x: x.astype("f4")), "must be one-dimensional int32"),
    "2-D cells": (array("entries", lambda x: x[None]), "must be one-dimensional int32"),
    "signed masks": (array("mixed_labels", lambda x: x.view("i8")), "one-dimensional uint64"),
    "complex masks": (array("mixed_labels", lambda x: x.view("c8")), "one-dimensional uint64"),
    "a missing array": (lambda d, a: a.pop("mixed_cells"), "does not hold the arrays"),
    "one more array": (lambda d, a: a.update(x=np.zeros(1)), "does not hold the arrays"),
    # numbers
    "huge partitions": (at("partitions")([2**31 - 1] * 2), "`max_level` must be"),
    "many partitions": (at("partitions")([2**20] * 2), "fewer than the root grid"),
    "too many partitions": (at("partitions")([2**31, 1]), r"`partitions\[0\]` must be"),
    "partitions past any float": (at("partitions")([10**400, 1]), r"`partitions\[0\]` must be"),
    "no partitions": (at("partitions")([0, 6]), r"`partitions\[0\]` must be"),
    "negative partitions": (at("partitions")([-3, -2]), r"`partitions\[0\]` must be"),
    "broken partitions": (at("partitions")([3.0, 2]), r"`partitions\[0\]` must be"),
    "other partitions": (at("partitions")([3, 3]), "."),
    "partitions of 3 axes": (at("partitions")([3, 2, 1]), "`partitions` must be"),
    "partitions of no axes": (at("partitions")(None), "`partitions` must be"),
    "huge refinement": (at("refinement")([2**31 - 1, 2]), "`max_level` must be"),
    "too much refinement": (at("refinement")([2, 10**400]), r"`refinement\[1\]` must be"),
    "refinement of 1": (at("refinement")([1, 6]), r"`refinement\[0\]` must be"),
    "other refinement": (at("refinement")([3, 3]), "."),
    "huge max_level": (at("max_level")(10**9), "`max_level` must be"),
    "deepest max_level": (at("max_level")(31), "`max_level` must be"),
    "max_level past any float": (at("max_level")(10**400), "`max_level` must be"),
    "negative max_level": (at("max_level")(-1), "`max_level` must be"),
    "shallow max_level": (at("max_level")(1), DEEPER),
    # the rest of the content
    "no domain": (delete("domain"), "keys are not those"),
    "domain upside down": (at("domain", "upper")([-1, 5]), "must be at least `lower`"),
    "domain of text": (at("domain", "upper")(["7", "5"]), "`upper` must be numbers"),
    "domain of 3 axes": (at("domain", "lower")([0, 0, 0]), "one entry per state"),
    "domain with more": (
        lambda d, a: d["policy"]["domain"].update(color="red"),
        "TypeError .*unexpected keyword",
    ),
    "domain too narrow": (at("domain", "upper")([1e-310, 5]), "`max_level` is too high"),
    "domain is a list": (at("domain")([0, 1]), "TypeError"),
    "alphabet of one": (at("alphabet", "values")([[1, 2]]), "`alphabet names` must be"),
    "names doubled": (at("alphabet", "names")(["a", "a"]), "non-empty and distinct"),
    "alphabet infinite": (at("alphabet", "values", 0, 0)(10**400), "`alphabet` must be numbers"),
    "default of 3 inputs": (at("default")([0, 0, 0]), "`default` must have shape"),
    "default of nothing": (at("default")(None), "`default` must be finite"),
    "outside unknown": (at("outside")("else"), "`outside` must be"),
    "outside no symbol": (at("outside")(2), "`outside` must be"),
    "min_dwell negative": (at("min_dwell")(-1), "`min_dwell` must be"),
    "min_dwell huge": (at("min_dwell")(10**400), "`min_dwell` must be"),
    "horizon zero": (at("horizon")(0), "`horizon` must be"),
    "horizon of text": (at("horizon")("1.2"), "`horizon` must be"),
    "target of 3 states": (at("target")({"ball": {"center": [0, 0, 0], "radius": 1}}), "target"),
    "target unknown": (at("target")({"cube": {}}), "KeyError 'cube'"),
    "target twice": (
        at("target")({"ball": {"center": [0, 0], "radius": 1}, "box": {}}),
        "ValueError",
    ),
    "target a list": (at("target")([1]), "AttributeError"),
    "target of a malformed program": (at("target")({"program": {}}), "program"),
    "target of another program": (
        lambda d, a: d["policy"].update(target={"program": d["policy"]["model"]["dynamics"]}),
        "`target` must be a program of 2 state",
    ),
    "target named otherwise": (
        at("target")({"ball": {"center": [0, 0], "radius": 1, "names": ["a", "b"]}}),
        "`target` must name states among",
    ),
    "settings with more": (
        lambda d, a: d["policy"]["settings"].update(speed=1),
        "settings are not those",
    ),
    "settings wrong": (at("settings", "rule")("any"), "`rule` must be"),
    "settings of 3 inputs": (
        at("settings", "control_weight")([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        "`control_weight` must be a number or have shape",
    ),
    "name a number": (at("name")(5), "`name` must be a printable string"),
    "name with an escape": (at("name")("\x1b[31m"), "`name` must be a printable string"),
    "symbol with an escape": (at("alphabet", "names", 0)("\x1b[31m"), "printable"),
    "more content": (lambda d, a: d["policy"].update(extra=1), "keys are not those"),
    "statistics a list": (at("statistics")([]), "statistics are no object"),
    "solves of text": (at("statistics")({"solves": "1"}), "'solves' is of another kind"),
    "roles of text": (at("statistics")({"solves_by_role": {"vertices": "1"}}), "another kind"),
    "a sample of something": (at("statistics")({"sample": {"x": 1}}), "another kind"),
    "content a list": (lambda d, a: d.update(policy=[1]), "keys are not those"),
    "model a list": (at("model")([1]), "the model in the file must hold"),
    "model with less": (delete("model", "step"), "the model in the file must hold"),
    "model of other sizes": (at("model", "step", "inputs", 0, 1)(3), "."),
    "model with unknown operation": (
        at("model", "step", "instructions", 0)(["__import__", 0]),
        "unknown operation",
    ),
    "model with later operand": (at("model", "step", "instructions", 2, 1)(999), "operands of"),
    "model with itself as operand": (at("model", "step", "instructions", 2, 1)(7), "operands of"),
    "model with huge constant": (at("model", "step", "instructions", 0, 1)(10**400), "."),
    "model with foreign port": (at("model", "step", "inputs", 0, 0)("x;y"), "port name"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_tampered_content_with_a_valid_checksum_is_refused(name, file):
    change, message = TAMPERED[name]
    before = file.read_bytes()
    rewrite(file, change)
    assert file.read_bytes() != before
    refuse(file, message)


def test_a_missing_checksum_or_policy_is_damage(file):
    before = file.read_bytes()
    for key in ("sha256", "policy"):
        file.write_bytes(before)
        document, arrays = read(file)
        del document[key]
        save_file(arrays, file, {KEY: canonical(document)})
        refuse(file, f"is damaged: KeyError '{key}'")


def test_not_a_number_is_no_json_number(file):
    document, arrays = read(file)
    for number in (float("nan"), float("inf")):
        changed = copy.deepcopy(document)
        changed["policy"]["statistics"]["share"] = number
        changed["sha256"] = digest(canonical(changed["policy"]), arrays)
        save_file(arrays, file, {KEY: canonical(changed)})
        refuse(file, "is damaged: ValueError")


@pytest.mark.parametrize("depth", [10, 900, 5_000, 1_000_000])
@pytest.mark.parametrize("brackets", ["[]", "{}"])
def test_deep_nesting_is_refused_or_kept(file, depth, brackets):
    before, after = ("[", "]") if brackets == "[]" else ('{"a":', "}")
    deep = before * depth + ("1" if brackets == "{}" else "") + after * depth
    document, arrays = read(file)
    document["policy"]["statistics"] = {"deep": "HERE"}
    content = canonical(document["policy"]).replace('"HERE"', deep)
    document["policy"] = "CONTENT"
    document["sha256"] = digest(content, arrays)
    save_file(arrays, file, {KEY: canonical(document).replace('"CONTENT"', content)})
    try:
        loaded = Policy.load(file)
    except PolicyFormatError:
        assert depth > 10
    else:
        assert depth < 1_000_000 and list(loaded.statistics) == ["deep"]


@pytest.mark.parametrize(
    ("dtype", "size"),
    [("BF16", 2), ("F16", 2), ("F8_E4M3", 1), ("F8_E5M2", 1), ("F8_E8M0", 1), ("F4", 0.5)]
    + [("C64", 8), ("BOOL", 1), ("U8", 1), ("I64", 8), ("F64", 8), ("X9", 8)],
)
def test_every_type_of_array_that_safetensors_knows(file, dtype, size):
    with_header(file, resize("mixed_labels", dtype, size))
    refuse(file, "is no policy file|must be one-dimensional")


def huge_files(directory):
    """Write files that claim far more than they hold; return their paths."""

    def claim(name, *shape):
        def change(header):
            start = header[name]["data_offsets"][0]
            count = int(np.prod([int(s) for s in shape], dtype=object))
            header[name].update(shape=list(shape), data_offsets=[start, start + 4 * count])

        return change

    changes = [
        claim("entries", 2**29),
        claim("entries", 2**40),
        claim("entries", 2**61),
        claim("entries", 2**31, 2**31),
        lambda header: header["entries"].update(data_offsets=[0, 2**64 - 1]),
        lambda header: header["entries"].update(data_offsets=[8, 0]),
        lambda header: header["entries"].update(shape=[2**64 - 1]),
        lambda header: header["entries"].update(shape=[-1]),
    ]
    paths = []
    for number, change in enumerate(changes):
        paths.append(directory / f"header{number}.cap")
        full().save(paths[-1])
        with_header(paths[-1], change)
    for number, length in enumerate((2**27, 2**31, 2**62, 2**64 - 1)):
        paths.append(directory / f"length{number}.cap")
        full().save(paths[-1])
        paths[-1].write_bytes(struct.pack("<Q", length) + paths[-1].read_bytes()[8:])
    contents = [
        at("partitions")([2**31 - 1] * 2),
        at("partitions")([2**15, 2**15]),
        at("refinement")([10_000, 10_000]),
        at("refinement")([40_000, 40_000]),
    ]
    for number, change in enumerate(contents):
        paths.append(directory / f"content{number}.cap")
        full().save(paths[-1])
        rewrite(paths[-1], change)
    return paths


@pytest.mark.skipif(sys.platform != "linux", reason="memory limits work on Linux alone")
def test_what_a_file_claims_is_not_allocated(tmp_path):
    code = (
        "import pathlib, resource, sys\n"
        "from safetensors import safe_open\n"
        "from capsyn.errors import PolicyFormatError\n"
        "from capsyn import Policy\n"
        "pages = int(pathlib.Path('/proc/self/statm').read_text().split()[0])\n"
        "limit = pages * resource.getpagesize() + 2**28\n"
        "resource.setrlimit(resource.RLIMIT_AS, (limit, limit))\n"
        "for path in sys.argv[1:]:\n"
        "    try:\n"
        "        Policy.load(path)\n"
        "    except PolicyFormatError as error:\n"
        "        print(error)\n"
    )
    paths = huge_files(tmp_path)
    command = [sys.executable, "-c", code, *map(str, paths)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert len(run.stdout.splitlines()) == len(paths)


def test_a_leaf_with_a_huge_refinement_is_a_usable_policy(tmp_path):
    base = random_policy(0)
    made = dataclasses.replace(
        base,
        cells=dataclasses.replace(base.cells, grid=Grid((1,), (2**31 - 1,), 1)),
        domain=Box([0], [1]),
    )
    made.save(tmp_path / "p.cap")
    loaded = Policy.load(tmp_path / "p.cap")
    assert loaded.volume_shares.sum() == 1 and loaded([0.5]) == made([0.5])


def test_evidence_is_outside_the_checksum(tmp_path):
    plain, tried = full(), full().with_evidence(monte_carlo=TRIALS)
    for name, policy in (("plain", plain), ("tried", tried)):
        policy.save(tmp_path / name)
    (one, _), (other, _) = read(tmp_path / "plain"), read(tmp_path / "tried")
    assert one["sha256"] == other["sha256"] == tried.evidence["sha256"]
    assert "evidence" not in one and other["evidence"]["monte_carlo"] == TRIALS


def test_evidence_gathers_and_is_dropped_when_the_policy_changes(tmp_path):
    agreement = {
        "states": 5,
        "agreeing": 5,
        "share": 1.0,
        "low": 0.4,
        "high": 1.0,
        "confidence": 0.95,
    }
    policy = full().with_evidence(monte_carlo=TRIALS).with_evidence(agreement=agreement)
    assert set(policy.evidence) == {"sha256", "monte_carlo", "agreement"}
    changed = dataclasses.replace(policy, min_dwell=0.5)
    changed.save(tmp_path / "changed")
    assert Policy.load(tmp_path / "changed").evidence == {}
    assert set(changed.with_evidence(monte_carlo=TRIALS).evidence) == {"sha256", "monte_carlo"}


@pytest.mark.parametrize(
    "kinds",
    [
        {"luck": TRIALS},
        {"monte_carlo": {}},
        {"monte_carlo": 5},
        {"monte_carlo": TRIALS | {"low": np.nan}},
        {"monte_carlo": TRIALS | {"more": np.zeros(2)}},
        {"agreement": TRIALS},
        {"monte_carlo": TRIALS | {"successes": 11}},
        {"monte_carlo": TRIALS | {"successes": -1}},
        {"monte_carlo": TRIALS | {"trials": 10.0}},
        {"monte_carlo": TRIALS | {"high": 1.5}},
        {"monte_carlo": TRIALS | {"low": 0.9, "high": 0.1}},
        {"monte_carlo": TRIALS | {"more": "\x1b[31m"}},
        {"monte_carlo": TRIALS | {"more": [{"\x07": 1}]}},
        {"monte_carlo": TRIALS | {"more": 10**400}},
        {"monte_carlo": TRIALS | {"conditions": []}},
    ],
)
def test_what_is_no_evidence_is_refused(kinds):
    with pytest.raises(ProblemError, match=f"`{next(iter(kinds))}` must be what to_json"):
        full().with_evidence(**kinds)


@pytest.mark.parametrize(
    ("evidence", "message"),
    [
        ([1], "evidence is no object"),
        ({"monte_carlo": TRIALS}, "evidence is that of another policy"),
        ({"monte_carlo": TRIALS, "sha256": "0" * 64}, "evidence is that of another policy"),
        ("luck", "evidence 'luck' is of another kind"),
        ("monte_carlo", "evidence 'monte_carlo' is of another kind"),
    ],
)
def test_evidence_of_another_kind_is_refused(file, evidence, message):
    def change(document, arrays):
        document["evidence"] = evidence
        if isinstance(evidence, str):
            document["evidence"] = {evidence: {"trials": "many"}, "sha256": document["sha256"]}

    rewrite(file, change)
    refuse(file, message)
