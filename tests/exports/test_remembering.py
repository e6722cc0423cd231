"""Exports of policies that remember: golden vectors and sequences, in all plain languages."""

import pytest

from support.exports.remembering import POLICIES, RUNNERS, assert_remembers


@pytest.mark.parametrize("to", RUNNERS)
@pytest.mark.parametrize("name", POLICIES)
def test_languages(name, to, tmp_path):
    assert_remembers(to, POLICIES[name](), tmp_path)
