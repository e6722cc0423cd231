"""Damaged policy files: refused in one line, or read as what they were; never anything else."""

import struct

import numpy as np
import pytest

from capsyn import Policy
from capsyn.errors import PolicyFormatError
from support.policy_files import assert_equal, full, full_tree, refuse, rewrite
from support.trees import random_affine_policy

WHOLE = {
    "cells": full,
    "tree": full_tree,
    "affine leaves": lambda: random_affine_policy(3, periodic=True, seed=4),
}


@pytest.fixture
def file(tmp_path, kind):
    """A saved policy of a kind that has everything."""
    path = tmp_path / "p.cap"
    WHOLE[kind]().save(path)
    return path


@pytest.mark.parametrize("kind", ["cells", "tree"])
def test_truncated_files_are_refused(file):
    raw = file.read_bytes()
    lengths = {*range(64), *range(64, len(raw), 97), len(raw) - 8, len(raw) - 1}
    for length in sorted(lengths):
        file.write_bytes(raw[:length])
        refuse(file, "is no policy file")
    file.write_bytes(raw + b"\0")
    refuse(file, "is no policy file")


def flipped_bytes(part, count, seed):
    """Return what damages a file `count` times: bits, or all of a byte, in a part of it."""

    def damages(file):
        raw = file.read_bytes()
        (size,) = struct.unpack("<Q", raw[:8])
        start, end = {
            "header length": (0, 8),
            "header": (8, 8 + size),
            "end of header": (size - 400, 8 + size),  # the list of arrays
            "end of header and arrays": (8 + size - 500, len(raw)),
            "arrays": (8 + size, len(raw)),
            "file": (0, len(raw)),
        }[part]
        rng = np.random.default_rng(seed)
        places = rng.integers(start, end, count)
        bits, masks = 1 << rng.integers(0, 8, count), rng.integers(1, 256, count)
        for place, mask in zip(places, np.where(rng.random(count) < 0.5, bits, masks)):
            damaged = bytearray(raw)
            damaged[place] ^= int(mask)
            file.write_bytes(damaged)
            yield

    return damages


def flipped_tables(count, seed):
    """Return what flips bits of arrays, and makes the checksum fit."""

    def damages(file):
        whole, rng = file.read_bytes(), np.random.default_rng(seed)

        def damage(_, arrays):
            name = rng.choice(sorted(arrays))
            raw = np.frombuffer(arrays[name].tobytes(), dtype=np.uint8).copy()
            for place in rng.integers(0, len(raw), rng.integers(1, 4)):
                raw[place] ^= 1 << rng.integers(0, 8)
            arrays[name] = raw.view(arrays[name].dtype).reshape(arrays[name].shape)

        for _ in range(count):
            file.write_bytes(whole)
            rewrite(file, damage)
            yield

    return damages


def assert_symbols(loaded, whole):
    """Assert that lookups of what is another policy give symbols, the same in C and NumPy."""
    states = whole.domain.sample(200)
    symbols = loaded(states, backend="c")
    assert np.isin(symbols, [-1, 0, 1]).all()
    assert np.array_equal(symbols, loaded(states, backend="numpy"))


@pytest.mark.parametrize(
    ("kind", "damages", "harmless", "least", "most"),
    [
        ("cells", flipped_bytes("header length", 300, 1), assert_equal, 291, 300),
        ("cells", flipped_bytes("header", 300, 1), assert_equal, 291, 300),
        ("cells", flipped_bytes("end of header", 300, 1), assert_equal, 291, 300),
        ("cells", flipped_bytes("arrays", 300, 1), assert_equal, 291, 300),
        ("tree", flipped_bytes("end of header and arrays", 300, 2), assert_equal, 291, 300),
        ("tree", flipped_bytes("file", 100, 2), assert_equal, 96, 100),
        ("affine leaves", flipped_tables(200, 0), assert_symbols, 21, 199),
    ],
    ids=["header length", "header", "end of header", "arrays", "tree's arrays", "tree", "tables"],
)
def test_flipped_bytes_are_refused_or_harmless(kind, file, damages, harmless, least, most):
    refused, whole = 0, WHOLE[kind]()
    for _ in damages(file):
        try:
            loaded = Policy.load(file)
        except PolicyFormatError as error:
            assert "\n" not in str(error)
            refused += 1
        else:
            harmless(loaded, whole)
    assert least <= refused <= most
