"""The picture of a study of alphabets."""

from __future__ import annotations

import dataclasses
import warnings

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
    assert [text.get_text() for text in sized.texts] == ["2", "2", "3"]
    for ax in (over, sized):  # the star of the choice
        (star,) = [line for line in ax.lines if line.get_marker() == "*"]
        assert star.get_ydata().tolist() == [555.0]


def test_without_policies_there_is_one_panel(tmp_path):
    study = motor_study()
    rows = tuple(dataclasses.replace(row, bytes=None) for row in study.table)
    study = dataclasses.replace(study, table=rows, problem="$motor")
    assert len(study.plot().axes) == 1
    paths = [tmp_path / "a.png", tmp_path / "b.png"]
    for path in paths:
        save_alphabet_plot(study.table, study.objective, study.problem, path)
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


def test_where_every_objective_is_infinite_the_lost_loops_are_drawn():
    study = motor_study()
    lost = study.table[4]
    rows = tuple(dataclasses.replace(lost, kind=kind) for kind in ("chosen", "own", "uniform"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (ax,) = dataclasses.replace(study, table=rows).plot().axes
        dataclasses.replace(study, table=()).plot()
    assert ax.get_ylabel() == "closed loops that are lost\n(all objectives are infinite)"
    assert [one.lines[0].get_ydata().tolist() for one in ax.containers] == [[12.0]] * 3
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert sorted(names) == ["chosen", "own", "the choice", "uniform"]


def test_sizes_do_not_overprint():
    study = motor_study()
    figure = dataclasses.replace(study, table=study.table[:4] + study.table[:2]).plot()
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[1].texts]
    assert len(boxes) == 3 and not any(a.overlaps(b) for a in boxes for b in boxes if a is not b)
