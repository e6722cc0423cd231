"""The picture of a study of alphabets."""

from __future__ import annotations

import dataclasses

import pytest

from capsyn.errors import ProblemError
from capsyn.plots.alphabet import save_alphabet_plot
from support.problems.study import motor_study


def test_objectives_stand_over_symbols_and_bytes_with_their_intervals():
    study = motor_study()
    over, sized = study.plot().axes
    assert over.get_xlabel() == "symbols" and "bytes" in sized.get_xlabel()
    assert over.get_ylabel() == "objective: cost + 0.02 time"
    bars = {one.get_label(): one for one in over.containers}
    assert set(bars) == {"chosen", "uniform", "random"}  # none of the user's own
    line, _, (ends,) = bars["chosen"]
    assert line.get_ydata().tolist() == [804.0, 555.0]
    assert [round(x) for x in line.get_xdata()] == [2, 3]
    assert [segment[:, 1].tolist() for segment in ends.get_segments()] == [[784, 824], [535, 575]]
    told = [text.get_text() for text in over.texts]
    assert sorted(told) == ["98.0%", "infinite"]  # of the chosen, and of the one that loses loops
    assert sized.get_xscale() == "log" and len(sized.containers) == 2
    assert [text.get_text() for text in sized.texts] == ["2", "3", "2"]


def test_without_policies_there_is_one_panel(tmp_path):
    study = motor_study()
    rows = tuple(dataclasses.replace(row, bytes=None) for row in study.table)
    assert len(dataclasses.replace(study, table=rows).plot().axes) == 1
    paths = [tmp_path / "a.png", tmp_path / "b.png"]
    for path in paths:
        save_alphabet_plot(rows, study.objective, "$motor", path)
    first, second = (path.read_bytes() for path in paths)
    assert first == second and first.startswith(b"\x89PNG")
    with pytest.raises(ProblemError, match="a picture must end in"):
        save_alphabet_plot(rows, study.objective, "motor", tmp_path / "a.txt")


def test_objectives_far_apart_have_a_logarithmic_axis():
    study = motor_study()
    far = dataclasses.replace(study.table[3], objective=9e4, low=8e4, high=1e5)
    wide = dataclasses.replace(study, table=(*study.table[:3], far))
    assert wide.plot().axes[0].get_yscale() == "log"
    assert study.plot().axes[0].get_yscale() == "linear"
