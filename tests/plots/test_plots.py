"""Pictures of policies, asserted by what was put on the axes."""

import dataclasses

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import capsyn
from capsyn import problems, simulate
from capsyn.errors import ProblemError
from capsyn.plots.policy import plot_policy, save_policy_plot
from capsyn.policies.colors import PALETTE
from support.split_trees import tree_of

matplotlib.use("Agg")


from capsyn import Problem, synthesize
from capsyn.plots.trajectory import plot_trajectory, save_trajectory_plot


def policy_of(n, symbols=2, level=2):
    names = ["a", "b", "c", "d"][:n]
    box = capsyn.Box([-1.0] * n, [1.0] * n, names=names, units=["m"] + [""] * (n - 1))
    return capsyn.subdivide(
        lambda x: np.minimum((np.abs(x).sum(axis=1) * 2).astype(int), symbols - 1),
        box,
        symbols,
        partitions=3,
        max_level=level,
    )


def area(path):
    x, y = path.vertices[:4].T
    return np.ptp(x) * np.ptp(y)


@pytest.mark.parametrize(("n", "plane"), [(2, (0, 1)), (3, (2, 0)), (4, ("d", "b"))])
def test_the_cells_in_a_plane_tile_it_and_have_the_lookups_colours(n, plane):
    policy = policy_of(n)
    indices = [policy.domain.names.index(p) if isinstance(p, str) else p for p in plane]
    at = {name: 0.3 for i, name in enumerate(policy.domain.names) if i not in indices}
    ax = plot_policy(policy, plane, at, Figure().add_subplot())
    paths = [path for cells in ax.collections for path in cells.get_paths()]
    colours = [color for cells in ax.collections for color in cells.get_facecolor()]
    assert sum(map(area, paths)) == pytest.approx(4.0)
    states = np.full((len(paths), n), 0.3)
    states[:, indices] = [path.vertices[:4].mean(axis=0) for path in paths]
    wanted = [PALETTE[k] for k in policy(states)]
    assert [to_hex(c).upper() for c in colours] == wanted


def test_axes_carry_names_units_bounds_and_a_legend_with_the_symbols_seen():
    ax = plot_policy(policy_of(2, symbols=3), ax=Figure().add_subplot())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a [m]", "b")
    assert (*ax.get_xlim(), *ax.get_ylim()) == (-1, 1, -1, 1)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["0", "1", "2"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"plane": (0, 0)}, "`plane`"),
        ({"plane": (0, 5)}, "`plane`"),
        ({"plane": ("a", "z")}, "`plane`"),
        ({"plane": ("a",)}, "`plane`"),
        ({"at": {"z": 0.0}}, "`at`"),
        ({"at": {"a": 0.0}}, "`at` must name states outside the plane"),
        ({"at": {"c": np.nan}}, "`at c`"),
        ({"at": {"c": 7.0}}, r"`at c` must lie in \[-1, 1\]; got 7"),
    ],
)
def test_bad_arguments(options, words):
    with pytest.raises(ProblemError, match=words):
        plot_policy(policy_of(3), **options)


def test_one_state_cannot_be_drawn():
    with pytest.raises(ProblemError, match="two states"):
        plot_policy(policy_of(1))


def test_a_failing_save_keeps_the_old_picture(tmp_path):
    path = tmp_path / "p.png"
    path.write_text("old")
    with pytest.raises(ProblemError):
        save_policy_plot(policy_of(2), path, plane=(0, 7))
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_trajectories_are_drawn_by_state_and_control():
    policy = policy_of(2, symbols=3)
    problem = Problem(
        name="drift",
        dynamics=lambda x, u: [0.1, -0.2],
        domain=policy.domain,
        alphabet=policy.alphabet,
        default=policy.default,
        horizon=1.0,
        running_cost=lambda x: x[0] ** 2,
    )
    for x0 in ([0.0, 0.0], [[0.0, 0.0], [0.5, -0.5]]):
        run = simulate(policy, x0, 1.0, 10.0, model=problem)
        axes = plot_trajectory(run, Figure().subplots(2 + policy.alphabet.m))
        lines = [ax.get_lines() for ax in axes]
        assert all(len(drawn) == np.ndim(x0) for drawn in lines)
        states, controls = run.states.reshape(-1, 11, 2), run.controls.reshape(-1, 10, 1)
        for k in range(np.ndim(x0)):
            assert np.array_equal(lines[0][k].get_ydata(), states[k, :, 0])
            assert np.array_equal(lines[2][k].get_ydata()[:-1], controls[k, :, 0])
        assert axes[0].get_ylabel() == "a [m]" and axes[-1].get_xlabel() == "time [s]"
    with pytest.raises(ProblemError, match="`axes` must be 3 Axes"):
        plot_trajectory(run, Figure().subplots(2))


def test_a_picture_of_a_trajectory_is_the_same_bytes_each_time(tmp_path):
    run = simulate(synthesize(problems.plain("double-tank-b"), max_level=1), [0.2, 0.3], 0.1, 100.0)
    for name in ("one.svg", "two.svg"):
        save_trajectory_plot(run, tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    with pytest.raises(ProblemError, match="a picture must end in"):
        save_trajectory_plot(run, tmp_path / "one.gif")


def test_gaps_beside_oblique_surfaces_have_the_colour_of_the_default():
    box = capsyn.Box([-1, -1], [1, 1])
    options = {"leaves": "affine", "max_level": 1, "partitions": 4}
    filled = capsyn.subdivide(lambda x: np.where(x[:, 0] < x[:, 1], 0, -1), box, 1, **options)
    images = []
    for policy in (filled, dataclasses.replace(filled, gaps=True)):
        assert policy.has_planes
        images.append(plot_policy(policy, ax=Figure().add_subplot()).images[0].get_array())
    assert np.array_equal(*images) and len(np.unique(images[0].reshape(-1, 3), axis=0)) == 2


def test_a_value_outside_is_refused_or_some_periods_away():
    tree = tree_of((12, 7, 5), periodic=1, seed=3)
    periodic = tree.domain.periodic.index(True)
    name, other = (tree.domain.names[i] for i in (periodic, (periodic + 1) % 3))
    axes = [i for i in range(3) if i != periodic]
    value, width = tree.domain.lower[periodic] + 0.25, tree.domain.widths[periodic]
    with pytest.warns(capsyn.errors.CapsynWarning, match="some periods away"):
        far = plot_policy(tree, axes, {name: value + 8 * width}, ax=Figure().add_subplot())
    near = plot_policy(tree, axes, {name: value}, ax=Figure().add_subplot())
    assert far.get_title() == near.get_title()
    axes = [i for i in range(3) if tree.domain.names[i] != other]
    with pytest.raises(ProblemError, match=f"`at {other}` must lie in .*; got 1e"):
        plot_policy(tree, axes, {other: 1e9}, ax=Figure().add_subplot())


def test_a_picture_of_a_tree_has_its_colours():
    tree = tree_of((12, 7, 5), periodic=1, seed=3)
    ax = plot_policy(tree, (2, 0), ax=Figure().add_subplot())
    paths = [path for cells in ax.collections for path in cells.get_paths()]
    colours = [color for cells in ax.collections for color in cells.get_facecolor()]
    widths = tree.domain.widths
    assert len(paths) > 3 and sum(map(area, paths)) == pytest.approx(widths[2] * widths[0])
    states = np.tile(tree.domain.lower + widths / 2, (len(paths), 1))
    states[:, [2, 0]] = [path.vertices[:4].mean(axis=0) for path in paths]
    palette = [*PALETTE[:2], "#FFFFFF"]
    assert [to_hex(c).upper() for c in colours] == [palette[k] for k in tree(states)]


@pytest.fixture(scope="module")
def priced():
    problem = problems.plain("cart-pendulum").replace(switching=capsyn.Switching(price="10%"))
    return [synthesize(problem, max_level=2, leaves=kind) for kind in ("constant", "affine")]


@pytest.mark.parametrize("current", [None, "-5", 0, -1])
def test_a_picture_of_a_policy_that_remembers_is_of_one_symbol_in_force(current, priced):
    policy = priced[0]
    ax = plot_policy(policy, ax=Figure().add_subplot(), current=current)
    boxes = [cells for cells in ax.collections if isinstance(cells, PolyCollection)]
    paths = [path for cells in boxes for path in cells.get_paths()]
    colours = [to_hex(c).upper() for cells in boxes for c in cells.get_facecolor()]
    states = np.array([path.vertices[:4].mean(axis=0) for path in paths])
    symbols = policy(states, current=current)
    assert colours == [PALETTE[k] for k in symbols]
    stay = {symbol: policy(states, current=symbol) == symbol for symbol in (0, 1)}
    if current is not None:
        stay = {k: v for k, v in stay.items() if current in (k, policy.alphabet.names[k])}
    wanted = np.zeros(len(states), dtype=bool)
    for symbol, there in stay.items():
        wanted |= there & (policy(states) != symbol)
    bands = [cells for cells in ax.collections if cells.get_hatch() is not None]
    assert len(bands) == bool(stay)
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    name = {None: "default", -1: "default", 0: "5"}.get(current, current)
    assert ax.get_title() == f"cart-pendulum, {name} in force"
    if stay:
        (whole,) = bands[0].get_paths()
        hatched = whole.vertices.reshape(-1, 5, 2)[:, :4].mean(axis=1)
        assert set(map(tuple, hatched)) == set(map(tuple, states[wanted])) != set()
        told = "the one in force" if current is None else name
        assert texts == ["5", "-5", f"{told} stays", "target"]


def test_a_picture_of_affine_leaves_that_remember(priced, monkeypatch, tmp_path):
    monkeypatch.setattr("capsyn.plots.policy.PIXELS", 40)
    policy = priced[1]
    assert policy.cells.priced
    ax = plot_policy(policy, ax=Figure().add_subplot(), current="5")
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == ["5", "-5", "5 stays", "target"]
    x, y = ((np.arange(40) + 0.5) / 40 * w for w in policy.domain.widths)
    grid = np.stack(np.meshgrid(x, y - 5), axis=-1)
    pixels = ax.images[0].get_array()
    wanted = np.array([to_hex(PALETTE[k]) for k in policy(grid, current="5").ravel()])
    assert [to_hex(c) for c in pixels.reshape(-1, 3)] == wanted.tolist()
    for name in ("one.svg", "two.svg"):
        save_policy_plot(policy, tmp_path / name, current="5")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    with pytest.raises(ProblemError, match="`current` must be a symbol"):
        plot_policy(policy, current="6")


def test_a_picture_of_an_oblique_tree_has_its_colours(tmp_path, monkeypatch):
    monkeypatch.setattr("capsyn.plots.policy.PIXELS", 40)
    tree = tree_of((12, 7, 5), 3, periodic=1, seed=3)
    point = tree.domain.lower + 0.3 * tree.domain.widths
    ax = plot_policy(tree, (2, 0), {"x2": point[1]}, Figure().add_subplot())
    (image,) = ax.get_images()
    left, right, bottom, top = image.get_extent()
    low, high = tree.domain.lower, tree.domain.upper
    assert (left, right, bottom, top) == (low[2], high[2], low[0], high[0])
    pixels, palette = image.get_array(), [*PALETTE[:2], "#FFFFFF"]
    assert pixels.shape == (40, 40, 3)
    seen = set()
    for i, j in np.random.default_rng(0).integers(0, 40, (200, 2)):
        state = point.copy()
        state[2] = left + (j + 0.5) * (right - left) / 40
        state[0] = bottom + (i + 0.5) * (top - bottom) / 40
        symbol = int(tree(state))
        seen.add(symbol)
        assert to_hex(pixels[i, j]).upper() == palette[symbol]
    assert len(seen) > 1
    assert image.origin == "lower"
    for name in ("one.svg", "two.svg"):
        save_policy_plot(tree, tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
