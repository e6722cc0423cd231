"""Policy files with everything in them; what reads, changes and damages them, and who refuses."""

import dataclasses
import hashlib
import json
import struct

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from capsyn import Alphabet, Ball, Box, DecisionTree, Policy, SsacSettings
from capsyn.errors import PolicyFormatError
from capsyn.policies.guarantee import Guarantee
from capsyn.programs.model import Model, model_ports
from capsyn.programs.program import Program
from support.split_trees import random_split_tree
from support.trees import random_tree

KEY = "capsyn-policy"


def any_model(n, m, symbols):
    """Return a model of the right sizes whose programs mean nothing."""
    programs = {}
    for name, (inputs, outputs) in model_ports(n, m, symbols).items():
        known = sum(size for _, size in inputs)
        instructions = (
            ("const", 0.1),
            ("const", float("-inf")),
            ("sin", 0),
            ("fmax", known + 1, known + 2),
            ("mul", known, known + 3),
        )
        results = tuple((3 * k) % (known + 5) for k in range(sum(size for _, size in outputs)))
        programs[name] = Program(name, inputs, outputs, instructions, results)
    return Model(**programs)


def full(**changes):
    """Return a policy whose every field is something."""
    made = Policy(
        name="full ü",
        domain=Box([0, -5], [2 * np.pi, 5], ["theta", "ω"], ["rad", "rad/s"], [True, False]),
        alphabet=Alphabet([[-5, 1 / 3], [5, 0]], ["left", "right"], ["a", "b"], ["m/s^2", ""]),
        default=np.array([0.1, -0.0]),
        cells=random_tree((3, 2), (2, 3), 2, 3, seed=1),
        outside=1,
        min_dwell=0.01,
        target=Ball([0.1, 0.2], 0.3),
        horizon=1.2,
        settings=SsacSettings(gamma=-2.5, control_weight=[[1, 0.1], [0.1, 0.2]], steps=24),
        model=any_model(2, 2, 2),
        statistics={"solves": 12, "levels": [{"cells": 6}], "share": 0.1, "none": None, "s": "ü"},
        timings={"label": 0.25},
    )
    return dataclasses.replace(made, **changes)


TRIALS = {"trials": 10, "successes": 9, "low": 0.5, "high": 1, "confidence": 0.95, "more": [None]}


def assert_equal(one, other):
    """Assert that two policies, of cells or trees, are equal in every field but the timings."""
    assert type(one) is type(other)
    for field in dataclasses.fields(type(one)):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if field.name == "cells":
            assert type(a) is type(b)
            for part in dataclasses.fields(type(a)):
                x, y = getattr(a, part.name), getattr(b, part.name)
                if part.name == "affine" and x is not None:
                    assert all(np.array_equal(v, vars(y)[k]) for k, v in vars(x).items())
                    continue
                assert np.array_equal(x, y), part.name
                if isinstance(x, np.ndarray):
                    assert x.dtype == y.dtype and x.shape == y.shape
        elif field.name in ("default", "transitions"):
            assert a.tobytes() == b.tobytes() and a.dtype == b.dtype
        elif field.name != "timings":
            assert a == b and type(a) is type(b), field.name


def read(path):
    """Return the metadata document and the arrays of a file."""
    with safe_open(path, framework="np") as opened:
        document = json.loads(opened.metadata()[KEY])
        return document, {name: opened.get_tensor(name) for name in opened.keys()}


def canonical(data):
    return json.dumps(data, sort_keys=True, separators=(",", ":"))


def digest(content_text, arrays):
    """Return the checksum as the format documents it, written out once more."""
    result = hashlib.sha256(content_text.encode())
    for name in sorted(arrays):
        result.update(f"{name}:{arrays[name].dtype.str}:{arrays[name].shape}".encode())
        result.update(arrays[name].tobytes())
    return result.hexdigest()


def rewrite(path, change, checksum=True):
    """Apply ``change(document, arrays)`` to a file, with a checksum that fits, or the old one."""
    document, arrays = read(path)
    change(document, arrays)
    if checksum:
        document["sha256"] = digest(canonical(document["policy"]), arrays)
    save_file(arrays, path, {KEY: canonical(document)})


def refuse(path, message):
    """Assert that a file is refused in one line that names it."""
    with pytest.raises(PolicyFormatError, match=message) as caught:
        Policy.load(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def set_version(value):
    def change(document, arrays):
        if value is None:
            del document["version"]
        else:
            document["version"] = value

    return change


def at(*keys):
    """Return a function that gives the value at `keys` of the policy's content a new value."""

    def setter(value):
        def change(document, arrays):
            place = document["policy"]
            for key in keys[:-1]:
                place = place[key]
            assert keys[-1] in place if isinstance(place, dict) else place
            place[keys[-1]] = value

        return change

    return setter


def delete(*keys):
    def change(document, arrays):
        place = document["policy"]
        for key in keys[:-1]:
            place = place[key]
        del place[keys[-1]]

    return change


def array(name, function):
    """Return a change that replaces one array by a function of it."""

    def change(document, arrays):
        arrays[name] = np.ascontiguousarray(function(arrays[name].copy()))

    return change


def put(place, value):
    def function(values):
        values[place] = value
        return values

    return function


def with_header(path, change):
    """Rewrite the list of arrays in a file's header, as no writer would."""
    raw = path.read_bytes()
    (size,) = struct.unpack("<Q", raw[:8])
    header = json.loads(raw[8 : 8 + size])
    change(header)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + raw[8 + size :])


def resize(name, dtype, size):
    def change(header):
        start, end = header[name]["data_offsets"]
        header[name].update(dtype=dtype, shape=[int((end - start) // size)])

    return change


def full_tree(planes=1, **changes):
    """Return a tree whose every field is something."""
    policy = full()
    fields = {f.name: getattr(policy, f.name) for f in dataclasses.fields(Policy)}
    known = {
        "mode": "linear" if planes else "freedom",
        "source": "0123456789abcdef" * 4,
        "level": 1,
        "changed": 0.25,
        "controller": "ssac",
        "states": 10,
        "agreeing": 9,
        "target": 0.99,
    }
    fields |= {"cells": random_split_tree((12, 18), planes, seed=4), "timings": {}}
    return DecisionTree(**fields | {"guarantee": Guarantee(**known)} | changes)
