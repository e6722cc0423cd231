"""Files of version 10: exogenous inputs, predictions under a law, and cuts."""

import dataclasses
import functools

import numpy as np
import pytest

from capsyn import Box, Policy, compress, synthesize
from support.policy_files import (
    assert_equal,
    at,
    delete,
    full,
    full_tree,
    read,
    refuse,
    rewrite,
    set_version,
)
from support.told import ROOMS, TOLD


@functools.cache
def policy(case):
    if case == "plain":
        return synthesize(ROOMS, partitions=2, max_level=1)
    if case == "law":
        law = ROOMS.replace(
            default=lambda x, w: [x[0] - w[0], 0.5], target=lambda x, w: x[0] < w[0] + 1
        )
        return synthesize(law, partitions=2, max_level=1)
    if case == "tree":
        return compress(policy("plain"))
    if case == "law of states":
        return policy("law").at([22, 30])
    assert case == "cut tree"
    return policy("tree").at([22, 30])


CASES = ["plain", "law", "tree", "law of states", "cut tree"]
NEWS = {
    "plain": {"exogenous"},
    "law": {"exogenous", "prediction"},
    "tree": {"exogenous"},
    "law of states": {"prediction"},
    "cut tree": {"cut"},
}


@pytest.fixture
def file(tmp_path, case):
    path = tmp_path / "p.cap"
    policy(case).save(path)
    return path


@pytest.mark.parametrize("case", CASES)
def test_round_trip(file, case, tmp_path):
    again = Policy.load(file)
    assert_equal(again, dataclasses.replace(policy(case), timings={}))
    assert again.space == policy(case).space
    again.save(tmp_path / "again.cap")
    assert (tmp_path / "again.cap").read_bytes() == file.read_bytes()
    document, _ = read(file)
    content = document["policy"]
    news = {"exogenous"} & set(content) | {"prediction"} & set(content["model"])
    news |= {"cut"} & set(content.get("guarantee", ()))
    assert document["version"] == 10 and news == NEWS[case]
    z = again.space.sample(500)
    assert np.array_equal(again(z), policy(case)(z))
    if case == "cut tree":
        assert content["guarantee"]["cut"] is True and again.guarantee.cut


@pytest.mark.parametrize("version", range(1, 10))
@pytest.mark.parametrize("case", CASES)
def test_older_versions_do_not_hold_it(file, version):
    rewrite(file, set_version(version))
    refuse(file, "its keys are not those of this format version")


@pytest.mark.parametrize("made", [full, full_tree])
def test_what_is_told_nothing_says_nothing_of_it(made, tmp_path):
    made().save(tmp_path / "p.cap")
    document, _ = read(tmp_path / "p.cap")
    assert document["version"] < 10 and "exogenous" not in document["policy"]
    assert "prediction" not in document["policy"]["model"]
    assert "cut" not in document["policy"].get("guarantee", {})


def more(*keys):
    """Return a function that adds a value at keys of the policy's content."""

    def adder(value):
        def change(document, arrays):
            document["version"], place = 10, document["policy"]
            for key in keys[:-1]:
                place = place[key]
            place[keys[-1]] = value

        return change

    return adder


HALF = {"lower": [20], "upper": [25], "names": ["setpoint"], "units": [""], "periodic": [False]}
TAMPERED = {
    "a box of one input": ("plain", at("exogenous")(HALF), "has other sizes"),
    "a box of one input, of a tree": ("tree", at("exogenous")(HALF), "has other sizes"),
    "no box": ("plain", delete("exogenous"), "has other sizes"),
    "no box of a tree": ("tree", delete("exogenous"), "has other sizes"),
    "one more bound": ("plain", at("exogenous", "upper")([25, 38, 1]), "`upper` must"),
    "upside down": ("plain", at("exogenous", "upper")([19, 38]), "must be at least `lower`"),
    "too narrow": ("plain", at("exogenous", "upper")([20.000000000000004, 38]), "too high"),
    "names that clash": (
        "plain",
        at("exogenous", "names")(["setpoint", "T1"]),
        "`exogenous` must have names that no state has; 'T1' is a state, too",
    ),
    "the name of a control input": (
        "plain",
        at("exogenous", "names")(["setpoint", "u1"]),
        "`exogenous` must have names that no control input has; 'u1' is a control input, too",
    ),
    "a name twice": ("plain", at("exogenous", "names")(["a", "a"]), "non-empty and distinct"),
    "a name with an escape": ("plain", at("exogenous", "names", 0)("\x1b[31m"), "printable"),
    "a null box": ("plain", at("exogenous")(None), "TypeError"),
    "a list": ("plain", at("exogenous")([1]), "TypeError"),
    "an empty box": ("plain", at("exogenous")({}), "TypeError"),
    "a box with more": ("plain", more("exogenous", "color")("red"), "TypeError"),
    "an infinite bound": ("plain", at("exogenous", "upper", 0)(10**400), "`upper` must be"),
    "states told twice": ("law of states", more("exogenous")(HALF), "has other sizes"),
    "no law in the prediction": (
        "law",
        delete("model", "prediction", "law"),
        "the model in the file must hold law, step, adjoint, insertion",
    ),
    "a null prediction": ("law", at("model", "prediction")(None), "must hold law, step, adjoint"),
    "a list of predictions": ("law", at("model", "prediction")([1]), "must hold law"),
    "a prediction with more": (
        "law",
        lambda d, a: d["policy"]["model"]["prediction"].update(
            dynamics=d["policy"]["model"]["dynamics"]
        ),
        "must hold law, step, adjoint",
    ),
    "a law of other ports": (
        "law",
        at("model", "prediction", "law", "outputs")([["u", 1]]),
        "the program 'law' in the file has other sizes|results",
    ),
    "a prediction under a control": (
        "law",
        lambda d, a: d["policy"]["model"]["prediction"].update(step=d["policy"]["model"]["step"]),
        "the program 'step' in the file has other sizes",
    ),
    "a law of other states": (
        "law of states",
        lambda d, a: d["policy"]["model"]["prediction"].update(
            law=policy("law").model.prediction.law.to_json()
        ),
        "the program 'law' in the file has other sizes",
    ),
    "a target of the states alone": (
        "law",
        lambda d, a: d["policy"].update(
            target={"program": policy("law of states").target.to_json()}
        ),
        "`target` must be a program of 4 state",
    ),
    "exogenous inputs without names": (
        "plain",
        at("exogenous", "names")(["x1", "x2"]),
        "its exogenous inputs have no names of their own",
    ),
    "not cut": ("cut tree", at("guarantee", "cut")(False), "its keys are not those"),
    "cut in words": ("cut tree", at("guarantee", "cut")("yes"), "its keys are not those"),
    "cut once": ("cut tree", at("guarantee", "cut")(1), "its keys are not those"),
    "cut nothing": ("cut tree", at("guarantee", "cut")(None), "its keys are not those"),
    "a guarantee of nothing": ("cut tree", at("guarantee")(None), "TypeError"),
    "a guarantee of numbers": ("tree", at("guarantee")([1]), "TypeError"),
    "a model of nothing": ("law", at("model")(5), "the model in the file must hold"),
    "counts of the states alone": ("tree", at("counts")([4, 4]), "`counts` must be"),
    "partitions of the states alone": ("plain", at("partitions")([2, 2]), "`partitions` must be"),
}


@pytest.mark.parametrize(("case", "name"), [(TAMPERED[name][0], name) for name in TAMPERED])
def test_tampered_content_with_a_valid_checksum_is_refused(file, name):
    _, change, message = TAMPERED[name]
    before = file.read_bytes()
    rewrite(file, change)
    assert file.read_bytes() != before
    refuse(file, message)


def test_names_of_boxes_without_any():
    box = Box(TOLD.lower, TOLD.upper)
    told = dataclasses.replace(policy("plain"), exogenous=box, target=None)
    assert told.exogenous.names == ("w1", "w2") and told.space.names[:2] == ("T1", "T2")
