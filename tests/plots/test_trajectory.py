"""Pictures of trajectories: seams, inputs that chatter, strips of symbols, the end of time."""

import dataclasses

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from capsyn.plots.pieces import input_of_all, input_pieces, piece_starts, stacked, symbol_shares
from capsyn.plots.trajectory import PIECES, plot_trajectory, save_trajectory_plot
from capsyn.policies.colors import PALETTE, symbol_looks
from capsyn.simulation.simulate import Trajectory

matplotlib.use("Agg")


def made(states, symbols, names=("off", "on"), last=None, **more):
    """Return a trajectory of one state and an input that is the symbol."""
    states, symbols = np.asarray(states, dtype=float), np.asarray(symbols)
    shape, samples = symbols.shape[:-1], symbols.shape[-1]
    last = np.full(shape, samples)[()] if last is None else np.asarray(last)
    nothing = np.zeros(shape)[()]
    return Trajectory(
        times=np.arange(samples + 1) / 10,
        states=states[..., None],
        symbols=symbols,
        controls=symbols[..., None].astype(float),
        costs=np.zeros((*shape, samples + 1)),
        terminal_cost=nothing,
        switches=nothing,
        outside=nothing,
        ended=np.full(shape, "time"),
        last=last,
        arrived=nothing,
        names=("x", "u"),
        units=("rad", "V"),
        **{"periods": (0.0,), "lower": (0.0,), "symbol_names": names} | more,
    )


def drawn(trajectory, panels=3, **options):
    return plot_trajectory(trajectory, Figure().subplots(panels), **options)


@pytest.mark.parametrize("folded", [False, True])
def test_a_line_ends_at_the_seam_and_goes_on_at_the_other_side(folded):
    turning = np.linspace(0.5, 3.7, 33)
    period, low = 1.0, 0.0
    states = turning % period if folded else turning
    ax = drawn(made(states, np.zeros(32, int), periods=(period,), lower=(low,)))[0]
    x, y = ax.get_lines()[0].get_data()
    gaps = np.flatnonzero(np.isnan(y))
    assert len(gaps) == 3 and (y[gaps - 1] == 1).all() and (y[gaps + 1] == 0).all()
    assert x[gaps] == pytest.approx([0.5, 1.5, 2.5]) and (x[gaps - 1] == x[gaps + 1]).all()
    assert np.nanmax(np.abs(np.diff(y))) < 0.11  # no line from bound to bound
    kept = ~np.isin(np.arange(len(y)), np.concatenate([gaps - 1, gaps, gaps + 1]))
    assert y[kept] == pytest.approx(turning % 1, abs=1e-12) and len(x[kept]) == 33


def test_a_state_within_its_period_is_drawn_as_it_is():
    states = np.array([0.1, 0.5, 0.3])
    ax = drawn(made(states, [0, 1], periods=(1.0,)))[0]
    assert np.array_equal(ax.get_lines()[0].get_ydata(), states)
    falling = made([-0.9, -1.1, np.nan], [0, 0], periods=(2.0,), lower=(-1.0,), last=1)
    y = drawn(falling)[0].get_lines()[0].get_ydata()
    assert y == pytest.approx([-0.9, -1, np.nan, 1, 0.9, np.nan], nan_ok=True)


def test_what_should_be_followed_is_within_the_period_too():
    run = made([0.1, 0.2, 0.3], [0, 1], periods=(1.0,))
    assert drawn(run, track={"x": 3.25})[0].get_lines()[1].get_ydata() == [0.25, 0.25]


def test_the_time_goes_to_the_end_that_was_reached():
    states = np.full((2, 11), np.nan)
    states[0, :4], states[1, :7] = 1.0, 2.0
    symbols = np.full((2, 10), -2)
    symbols[0, :3], symbols[1, :6] = 0, 1
    axes = drawn(made(states, symbols, last=[3, 6]))
    assert all(ax.get_xlim() == (0, 0.6) for ax in axes)
    assert axes[2].get_xlabel() == "time [s]"
    at_once = made(states[0], symbols[0], last=0)
    assert drawn(at_once)[0].get_xlim() == (0, 0.1)


def test_inputs_that_chatter_are_drawn_as_mean_and_range():
    calm, fast = np.repeat([0.0, 1.0], 500), np.tile([0.0, 0.0, 0.0, 2.0], 250)
    found = input_pieces(np.concatenate([calm, fast]), 100)  # of 20 samples
    assert np.array_equal(found.values[:1000], calm)
    assert np.array_equal(found.starts, np.arange(1000, 2000, 20))
    assert (found.ends - found.starts == 20).all()
    assert (found.low == 0).all() and (found.high == 2).all()
    assert np.array_equal(found.values[1000:], np.full(1000, 0.5))
    assert len(input_pieces(fast, 1000).starts) == 0  # every sample can be seen
    assert np.array_equal(input_pieces(fast, 1000).values, fast)


def test_pulses_are_no_chatter():
    values = np.zeros(1000)
    values[[105, 505, 525]] = 1.0
    found = input_pieces(values, 50)  # one alone, two in pieces beside each other
    assert found.starts.tolist() == [500, 520] and found.values[105] == 1
    assert found.values[505] == 1 / 20


def test_pieces_share_samples_as_equally_as_can_be():
    for samples, pieces in ((7, 3), (120, 120), (5, 120), (1001, 120)):
        starts = piece_starts(samples, pieces)
        sizes = np.diff([*starts, samples])
        assert starts[0] == 0 and sizes.sum() == samples and np.ptp(sizes) <= 1
        assert len(starts) == min(samples, pieces)


def test_inputs_of_many_loops_have_one_mean_and_range():
    values = np.array([[0.0, 2.0, np.nan, np.nan], [1.0, 4.0, 3.0, np.nan]])
    found = input_of_all(values, 2)
    assert found.values[:2].tolist() == [1.75, 1.75] and found.values[2:].tolist() == [3.0, 3.0]
    assert (found.low.tolist(), found.high.tolist()) == ([0, 3], [4, 3])


def test_the_panel_of_an_input_says_that_it_chatters():
    symbols = np.tile([0, 1], 5 * PIECES)
    states = np.zeros(len(symbols) + 1)
    ax = drawn(made(states, symbols))[1]
    assert [t.get_text() for t in ax.texts] == ["chatters: mean and range"]
    y = ax.get_lines()[0].get_ydata()
    assert np.nanmin(y) > 0.3 and np.nanmax(y) < 0.7
    (band,) = ax.collections
    assert len(band.get_paths()) == PIECES
    assert not drawn(made(states[:11], symbols[:10]))[1].texts
    many = made(np.zeros((9, 11)), np.tile(symbols[:10], (9, 1)))
    ax = drawn(many)[1]
    assert [t.get_text() for t in ax.texts] == ["mean and range of all"] and len(ax.lines) == 1


def test_shares_are_stacked_from_the_lowest_symbol():
    shares = symbol_shares(np.array([2, 2, 0, 2, 0, 0, 0, 0]), np.array([0, 4]))
    assert {k: v.tolist() for k, v in shares.items()} == {0: [0.25, 1.0], 2: [0.75, 0.0]}
    assert stacked(shares, 4).tolist() == [[0, 0], [2, 0], [2, 0], [2, 0]]


def test_the_strip_has_the_looks_of_symbols_and_names_those_that_occur():
    names = [f"<{k}>" for k in range(30)]
    symbols = np.repeat([3, 29, -1, 3], 60)
    ax = drawn(made(np.zeros(241), symbols, names))[2]
    (image,) = ax.get_images()
    pixels, looks = image.get_array(), symbol_looks(30)
    assert (pixels[:, :120] == to_rgb(looks[3].color)).all()
    assert (pixels[:, 240:360] == 1).all()  # the default control
    seen = {tuple(color) for color in pixels[:, 120:240].reshape(-1, 3)}
    assert seen == {to_rgb(looks[29].color), to_rgb(looks[29].ink)} and looks[29].marks
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["default", "<3>", "<29>"]


def test_many_trajectories_have_one_strip():
    symbols = np.tile(np.repeat([0, 1], 30), (9, 1))
    states = np.zeros((9, 61))
    few = drawn(made(states[:8], symbols[:8]))[2]
    assert len(few.get_images()) == 8 and few.get_ylim() == (0, 8)
    (image,) = drawn(made(states, symbols))[2].get_images()
    assert (image.get_array()[:, :240] == to_rgb(PALETTE[0])).all()


def test_saved_pictures_have_a_strip_where_controls_are_symbols(tmp_path, monkeypatch):
    sizes = []
    monkeypatch.setattr(
        "capsyn.plots.trajectory.plot_trajectory", lambda run, axes, track: sizes.append(len(axes))
    )
    run = made([0.0, 0.1, 0.2], [0, 1])
    save_trajectory_plot(run, tmp_path / "a.svg")
    save_trajectory_plot(dataclasses.replace(run, symbols=np.array([-2, -2])), tmp_path / "b.svg")
    assert sizes == [3, 2]
