"""The study of an alphabet: its table, its file, and what a policy's statistics say of it."""

from __future__ import annotations

import copy
import dataclasses
import json
import math

import pytest

from capsyn.alphabets.document import document, save_document
from capsyn.alphabets.judged import brief, columns
from capsyn.alphabets.study import AlphabetStudy
from capsyn.errors import ProblemError
from capsyn.policies.checks import is_alphabet_study
from support.problems.study import motor_study


def test_a_study_comes_back_from_its_file_as_it_was(tmp_path):
    study, path = motor_study(), tmp_path / "chosen.json"
    study.save(path)
    text = path.read_bytes()
    again = AlphabetStudy.load(path)
    assert again.to_json() == study.to_json() and again.alphabet == study.alphabet
    again.save(path)
    assert path.read_bytes() == text
    assert b"Infinity" not in text and math.isinf(again.table[-1].objective)
    assert [row.count for row in again.chosen] == [2, 3]


def changed(change):
    data = copy.deepcopy(motor_study().to_json())
    change(data)
    return json.dumps(data)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "it is no JSON"),
        ("[" * 100_000, "it is no JSON"),
        ("[]", "it does not say that it is a capsyn-alphabet"),
        ('{"settings": 3}', "it does not say that it is a capsyn-alphabet"),
        (changed(lambda d: d.update(more=1)), "it has other keys"),
        (changed(lambda d: d.update(problem="a\nb")), "its problem has no name"),
        (changed(lambda d: d.update(count=0)), "`count` must be a whole number >= 1"),
        (changed(lambda d: d.update(searched=True)), "`searched` must be a whole number >= 0"),
        (changed(lambda d: d.update(objective={"cost": "1"})), "its `objective` must be numbers"),
        (changed(lambda d: d.update(prices=[1])), "its `prices` must be numbers"),
        (changed(lambda d: d.update(time_unit=["s"])), "`time_unit` must be one of"),
        (changed(lambda d: d.update(table={})), "its table must have at most 1000 rows"),
        (changed(lambda d: d["alphabet"].update(values=[[1.0], [1.0, 2.0]])), "`alphabet` must be"),
        (changed(lambda d: d["alphabet"].update(values=[])), "`alphabet` must have"),
        (changed(lambda d: d["alphabet"].pop("units")), "an alphabet has other keys"),
        (changed(lambda d: d["candidates"].update(inputs=["v"])), "have different inputs"),
        (changed(lambda d: d["table"][0].pop("cells")), "a row of the table has other keys"),
        (changed(lambda d: d["table"][0].update(kind="best")), "is of no kind; got 'best'"),
        (changed(lambda d: d["table"][0].update(success=1.5)), "a wrong success"),
        (changed(lambda d: d["table"][0].update(nodes=-1)), "a wrong nodes"),
        (changed(lambda d: d["table"][0].update(low="0")), "a wrong low"),
        (changed(lambda d: d["table"][0].update(figures={"cost": [1]})), "a wrong figures"),
        (changed(lambda d: d["table"][0].update(tried=0)), "a wrong tried"),
        (changed(lambda d: d.update(count=1e999)), "`count` must be a whole number"),
    ],
)
def test_what_is_no_study_is_told_in_one_line(tmp_path, text, reason):
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(ProblemError) as error:
        AlphabetStudy.load(path)
    told = str(error.value)
    assert told.startswith(f"'{path}' must be a study as capsyn alphabet writes it: ")
    assert reason in told and "\n" not in told


def test_files_that_cannot_be_read_are_told(tmp_path):
    with pytest.raises(ProblemError, match="cannot read the alphabet '.*none.json': No such file"):
        AlphabetStudy.load(tmp_path / "none.json")
    with pytest.raises(ProblemError, match="it is no file"):
        AlphabetStudy.load(tmp_path)
    (tmp_path / "text.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ProblemError, match="it is no JSON"):
        AlphabetStudy.load(tmp_path / "text.json")


def test_the_table_marks_the_chosen_and_leaves_out_what_nobody_knows():
    study = motor_study()
    rows = columns(study.summary()["rows"], "min", study.count)
    assert list(rows[0]) == [
        "kind", "symbols", "best", "objective", "95 % interval", "success", "cost",
        "switches / min", "cells", "solves", "nodes", "bytes", "lost",
    ]  # fmt: skip
    assert [row["best"] for row in rows] == ["", "", "*", "", ""]
    assert rows[2]["objective"] == "555" and rows[2]["95 % interval"] == "535 to 575"
    assert rows[2]["success"] == "100.0%" and rows[2]["bytes"] == "900"
    assert rows[3]["kind"] == "best of 5 random" and rows[3]["bytes"] == ""
    assert rows[4]["objective"] == "infinite" and rows[4]["95 % interval"] == ""
    assert rows[4]["lost"] == "12"
    bare = [dataclasses.replace(row, bytes=None, success=None) for row in study.table[:2]]
    assert not {"bytes", "success", "lost"} & set(columns([row.summary() for row in bare])[0])
    assert columns([]) == []


def test_a_brief_table_fits_a_terminal():
    study = motor_study()
    rows = [row.summary() for row in study.table]
    short = brief(rows, {"cost": 1, "switches": 1, "failures": 3}, "s", study.count)
    assert list(short[0]) == [
        "symbols", "kind", "objective (95 %)", "success", "lost", "cost", "switches / s",
    ]  # fmt: skip
    assert [row["kind"] for row in short] == ["chosen", "uniform", "chosen *", "random", "uniform"]
    assert [row["objective (95 %)"] for row in short[2:]] == [
        "555 (535 .. 575)", "955 (935 .. 975)", "infinite",
    ]  # fmt: skip
    alone = brief(rows[:4], {"cost": 1}, "s", 2)
    assert list(alone[0])[3:] == ["success", "cells", "solves", "nodes"]
    assert brief([], {"cost": 1}, "s", 2) == []


def test_notebooks_show_the_table():
    study = dataclasses.replace(motor_study(), problem="<b>motor</b>")
    text = study._repr_html_()
    assert "&lt;b&gt;motor" in text and "<b>" not in text
    assert text.count("<tr>") == 1 + len(study.table) and "535 to 575" in text
    assert ">names</th>" in text and ">-5, off, 5</td>" in text
    assert repr(study) == "AlphabetStudy('<b>motor</b>': 3 symbols, -5, off, 5)"


def test_the_summary_is_what_a_policy_may_carry():
    summary = motor_study().summary()
    assert is_alphabet_study(summary) and is_alphabet_study(json.loads(json.dumps(summary)))
    assert summary["candidates"] == 21 and summary["rows"][2]["alphabet"] == 3
    row = summary["rows"][0]
    for change in (
        {"rows": None}, {"rows": [3]}, {"rows": [row | {"alphabet": [1]}]}, {"count": -1},
        {"rows": [row | {"cells": "many"}]}, {"objective": 1}, {"time_unit": "year"},
        {"rows": [row | {"low": math.inf}]}, {"rows": [row] * 1001}, {"problem": 3},
        {"candidates": None},
    ):  # fmt: skip
        assert not is_alphabet_study(summary | change), change


def test_the_document_has_symbols_table_and_picture_and_is_the_same_again(tmp_path):
    study = dataclasses.replace(motor_study(), problem="<i>motor</i> $x$")
    text = document(study)
    assert text == document(study) and "<i>" not in text and "&lt;i&gt;motor" in text
    for words in ("<td>off</td><td>0</td><td>0</td>", "<td>5</td><td>5</td><td>3</td>",
                  "<td>best of 5 random</td>", "535 to 575",
                  "<td>-5, -1, 5</td></tr>", "<svg "):  # fmt: skip
        assert words in text, words
    assert "<script" not in text and "http://" not in text.partition("<svg")[0]
    save_document(dataclasses.replace(study, table=()), tmp_path / "bare.html")
    bare = (tmp_path / "bare.html").read_text(encoding="utf-8")
    assert "<svg" not in bare and "<td>off</td>" in bare
