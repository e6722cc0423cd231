"""Runs of small numbers as text."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capsyn.cells.run_lengths import run_lengths, runs_of
from capsyn.errors import ProblemError

RUNS = st.lists(st.tuples(st.integers(0, 7), st.integers(1, 40_000)), min_size=1, max_size=30)


@given(RUNS)
def test_a_text_holds_the_values(runs):
    values = np.repeat(*np.array(runs).T)
    found, lengths = runs_of(run_lengths(values))
    assert (np.repeat(found, lengths) == values).all()
    assert (found[1:] != found[:-1]).all()


def test_a_run_takes_few_bytes():
    assert base64.b64decode(run_lengths(np.full(15, 7))) == bytes([15 * 8 + 7])
    assert base64.b64decode(run_lengths(np.full(16, 1))) == bytes([0x81, 1])
    assert len(base64.b64decode(run_lengths(np.zeros(2**20, int)))) == 4


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "whole run"),
        (b"\x81", "whole run"),
        (b"\x09\x81", "whole run"),
        (b"\x05", "longer than 0"),
        (b"\x81\x81\x81\x81\x81\x01", "at most 5 bytes"),
    ],
)
def test_other_bytes_are_refused(data, message):
    with pytest.raises(ProblemError, match=message):
        runs_of(base64.b64encode(data).decode())


@pytest.mark.parametrize("text", ["?", "a", "CQ=", "é", "CQ==\n"])
def test_other_texts_are_refused(text):
    with pytest.raises(ProblemError, match="must be base64"):
        runs_of(text)
