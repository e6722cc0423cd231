"""The page's lookup against Python's, on the same states."""

import dataclasses
import functools

import numpy as np
import pytest

from capsyn import Alphabet, Box, Policy, compress, problems, synthesize
from capsyn.cells.cell_tree import CellTree
from capsyn.errors import OutsideDomainError
from capsyn.policies.in_force import reachable
from support.explorer.node import BEGIN, node, texts
from support.exports.policies import built_in, oblique
from support.exports.remembering import pendulum, random_prices, random_rows
from support.features import exact
from support.trees import GRIDS, random_affine_policy, random_policy, random_tree, states_at_faces

LOOKUP = (
    'import { makeLookup } from "#page/policy/lookup.js";'
    'import { features } from "./features.js";'
    + BEGIN
    + "const lookup = makeLookup(input.policy, features);"
)
INSIDE, OUTSIDE, NOT_FINITE = 0, 1, 2


def states_for(policy, count=10_000, seed=0):
    """Return states in the domain, on faces and seams and beside them, outside, not finite."""
    domain, rng = policy.domain, np.random.default_rng(seed)
    at_faces = states_at_faces(domain, policy.cells.counts, count // 6, seed)
    wide = domain.lower + domain.widths * rng.uniform(-3, 4, (count // 6, domain.n))
    far = rng.normal(size=(count // 20, domain.n)) * 10.0 ** rng.integers(0, 290, (count // 20, 1))
    odd = domain.sample(60, seed)
    rows = rng.integers(0, domain.n, len(odd))
    odd[np.arange(len(odd)), rows] = rng.choice([np.nan, np.inf, -np.inf], len(odd))
    corners = np.stack([domain.lower, domain.upper, -domain.lower * 0.0])
    turns = domain.lower + domain.widths * rng.integers(-3, 4, (200, domain.n))
    some = [at_faces, wide, far, odd, corners, turns]
    inside = domain.sample(count - sum(map(len, some)), seed)
    return np.concatenate([inside, *some])


def expected(policy, states, outside, now=None):
    """Return symbols, while `now` is in force, and statuses, as `Policy` tells them."""
    finite = np.isfinite(states).all(axis=1)
    inside = policy.domain.contains(states)
    statuses = np.where(inside, INSIDE, np.where(finite, OUTSIDE, NOT_FINITE))
    symbols = np.full(len(states), -2 if isinstance(outside, str) else outside)
    known = finite if outside == "nearest" else inside
    symbols[known] = policy(states[known], outside="nearest", current=now)
    return symbols, statuses


@functools.cache
def many_symbols():
    """Return a policy of 40 symbols, whose masks need two words."""
    tree = random_tree((3, 2), (2, 2), 3, leaf_count=41, seed=5)
    box = Box([0.1, -2], [0.7, 3], periodic=[False, True])
    return Policy("many", box, Alphabet(np.arange(40.0)), [0.5], tree)


POLICIES = {
    "cart-pendulum": lambda: built_in("cart-pendulum"),
    "cart-pole": lambda: built_in("cart-pole"),
    "exact": lambda: compress(built_in("cart-pendulum-4"), "exact"),
    "oblique": oblique,
    "features": exact,
    "periodic 1-D": lambda: random_policy(2, periodic=True),
    "many symbols": many_symbols,
    **{
        f"random {grid}{kind}": functools.partial(random_policy, grid, True, 0, bool(kind))
        for grid in range(len(GRIDS))
        for kind in ("", " adaptive")
    },
    **{
        f"affine {grid}{kind}": functools.partial(random_affine_policy, grid, True, 0, bool(kind))
        for grid in (1, 3, 6)
        for kind in ("", " adaptive")
    },
}
REMEMBERING = {
    "priced": pendulum,
    "priced exact": lambda: compress(pendulum(), "exact"),
    "rows": random_rows,
    "rows adaptive": lambda: random_rows(6, True),
    "prices": random_prices,
}
POLICIES |= REMEMBERING


@pytest.mark.parametrize("name", POLICIES)
def test_symbols_are_those_of_python(name, tmp_path):
    policy = POLICIES[name]()
    states = states_for(policy)
    assert len(states) == 10_000
    rules = [(rule, -1) for rule in ("error", "nearest", len(policy.alphabet) - 1, -1)]
    rules += [("error", now) for now in range(len(policy.alphabet)) if policy.remembers]
    code = (
        LOOKUP
        + """
      const states = numbers(input.states);
      print(input.rules.map(([rule, now]) => states.map(x => {
        const { symbol, status } = lookup.symbol(x, rule, now);
        return [symbol, status];
      })));
    """
    )
    assert policy.remembers == (name in REMEMBERING)
    by_rule = np.array(node(tmp_path, code, policy, states=texts(states), rules=rules))
    for (rule, now), answers in zip(rules, by_rule):
        symbols, statuses = expected(policy, states, rule, now)
        np.testing.assert_array_equal(answers[:, 0], symbols)
        np.testing.assert_array_equal(answers[:, 1], statuses)


def test_the_rule_is_the_policys_own_unless_given(tmp_path):
    for rule in ("error", "nearest", 1, -1):
        policy = dataclasses.replace(random_policy(3), outside=rule)
        away = policy.domain.upper + 1
        code = LOOKUP + "print(lookup.symbol(numbers(input.states)[0]));"
        answer = node(tmp_path, code, policy, states=texts(away[None]))
        assert answer["status"] == OUTSIDE
        if rule == "error":
            assert answer["symbol"] == -2
            with pytest.raises(OutsideDomainError):
                policy(away)
        else:
            assert answer["symbol"] == policy(away)


CELL = """
  print(numbers(input.states).map(x => lookup.cell(x)));
"""


@pytest.mark.parametrize("name", ["cart-pendulum", "many symbols", "random 6", "exact"])
def test_cells_are_those_of_python(name, tmp_path):
    policy = POLICIES[name]()
    cells, domain = policy.cells, policy.domain
    states = states_for(policy, 2000)
    shown = node(tmp_path, LOOKUP + CELL, policy, states=texts(states))
    inside = domain.contains(states)
    assert [cell is not None for cell in shown] == inside.tolist()
    boxes = cells.boxes()
    row_of = {place: row for row, place in enumerate(boxes.places.tolist())}
    places = cells.find(domain.locate(states[inside], cells.counts))
    lower, upper = (domain.points(corner, cells.counts) for corner in (boxes.lower, boxes.upper))
    seen_in = getattr(cells, "mixed_labels", np.empty((0, 1, 1)))[:, 0, 0]
    masks = dict(zip(cells.mixed_cells.tolist(), seen_in.tolist()))
    labels = len(policy.alphabet) + 1
    several = 0
    for place, cell in zip(places.tolist(), (cell for cell in shown if cell)):
        row = row_of[place]
        label = int(boxes.labels[row])
        mask = masks.get(place, 1 << label)
        seen = [b if b < labels - 1 else -1 for b in range(labels) if mask >> b & 1]
        level = boxes.levels[row] if isinstance(cells, CellTree) else cells.depths[place]
        assert cell["leaf"] == place and cell["level"] == level
        assert cell["lower"] == lower[row].tolist() and cell["upper"] == upper[row].tolist()
        assert cell["symbol"] == (label if label < labels - 1 else -1)
        assert cell["allowed"] == seen
        several += len(seen) > 1
    assert several > 10 or not isinstance(cells, CellTree)


@pytest.mark.parametrize("name", ["affine 3", "affine 6 adaptive"])
def test_affine_cells_are_those_of_python(name, tmp_path):
    policy = POLICIES[name]()
    cells, labels = policy.cells, len(policy.alphabet) + 1
    states = policy.domain.sample(500)
    shown = node(tmp_path, LOOKUP + CELL, policy, states=texts(states))
    steps = policy.domain.locate(states, cells.counts)
    places = cells.find(steps)
    assert [cell["leaf"] for cell in shown] == places.tolist()
    assert [cell["symbol"] for cell in shown] == policy(states).tolist()
    masks = dict(zip(cells.mixed_cells.tolist(), cells.mixed_labels[:, 0, 0].tolist()))
    for leaf, place, cell in zip(cells.labels_at(places), places.tolist(), shown):
        own = 1 << leaf if leaf < labels else int(cells.affine.masks(labels)[leaf - labels, 0])
        mask = masks.get(place, own)
        seen = [b if b < labels - 1 else -1 for b in range(labels) if mask >> b & 1]
        assert cell["allowed"] == seen


def test_cells_of_oblique_splits_have_no_corners(tmp_path):
    policy = oblique()
    states = policy.domain.sample(500)
    cells = node(tmp_path, LOOKUP + CELL, policy, states=texts(states))
    places = policy.cells.find(policy.domain.locate(states, policy.cells.counts))
    assert [cell["leaf"] for cell in cells] == places.tolist()
    assert any(cell["lower"] is None for cell in cells)
    assert [cell["symbol"] for cell in cells] == policy(states).tolist()


RASTER = """
  print(input.views.map(view => lookup[input.what ?? "raster"](view)));
"""


def centres(policy, view):
    """Return the states (height, width, n) at the centres of a view's pixels."""
    (i, j), (x0, x1, y0, y1) = view["axes"], view["bounds"]
    width, height = view["width"], view["height"]
    states = np.tile(np.array(view["fixed"], dtype=float), (height, width, 1))
    states[:, :, i] = x0 + (np.arange(width) + 0.5) / width * (x1 - x0)
    states[:, :, j] = (y1 - (np.arange(height) + 0.5) / height * (y1 - y0))[:, None]
    return states


def views_of(policy, seed=0):
    """Return views of planes: the whole domain, beyond it, and close up; both orders of axes."""
    domain, rng = policy.domain, np.random.default_rng(seed)
    for i, j in ((0, domain.n - 1), (domain.n - 1, 0)):
        for low, high in ((0, 1), (-0.7, 2.3), (0.41, 0.47)):
            bounds = [
                float(domain.lower[k] + share * domain.widths[k])
                for k in (i, j)
                for share in (low, high)
            ]
            fixed = domain.sample(1, int(rng.integers(1000)))[0].tolist()
            yield {"axes": [i, j], "fixed": fixed, "bounds": bounds, "width": 83, "height": 57}


def seen_at_level(policy, states, level):
    """Return what Algorithm 1 knew of states (B, n) in the domain at a level: a symbol or -3."""
    cells = policy.cells
    steps = policy.domain.locate(states, cells.counts)
    symbols = np.full(len(states), -3)
    for here, places, lower, sizes in cells.levels():
        if here > level:
            break
        for entry, corner, size in zip(cells.entries[places], lower, sizes):
            inside = ((steps >= corner) & (steps < corner + size)).all(axis=1)
            if entry < 0:
                symbols[inside] = -1 - entry
    symbols[symbols == len(policy.alphabet)] = -1
    return symbols


@pytest.mark.parametrize(
    "name",
    ["cart-pendulum", "cart-pole", "exact", "features", "oblique", "oblique 4-D"]
    + ["random 6", "random 7"]
    + [f"random {grid} adaptive" for grid in (3, 6, 7)]
    + ["affine 3", "affine 3 adaptive", "affine 6 adaptive"],
)
def test_pixels_have_the_symbols_of_their_centres(name, tmp_path):
    policy = oblique_4() if name == "oblique 4-D" else POLICIES[name]()
    views = list(views_of(policy))
    rasters = node(tmp_path, LOOKUP + RASTER, policy, views=views)
    for view, pixels in zip(views, rasters):
        states = centres(policy, view).reshape(-1, policy.domain.n)
        symbols, _ = expected(policy, states, "error")
        np.testing.assert_array_equal(pixels, symbols)


@functools.cache
def oblique_4():
    problem = problems.plain("cart-pole").replace(partitions=2, max_level=2)
    return compress(synthesize(problem), "linear", agreement=0.9, states=5000)


@pytest.mark.parametrize("name", ["cart-pendulum", "random 3", "random 7", "random 7 adaptive"])
def test_levels_show_what_the_algorithm_knew(name, tmp_path):
    policy = POLICIES[name]()
    views = [
        view | {"level": level}
        for view in list(views_of(policy))[:2]
        for level in range(policy.cells.depth + 1)
    ]
    rasters = node(tmp_path, LOOKUP + RASTER, policy, views=views)
    mixed = 0
    for view, pixels in zip(views, rasters):
        states = centres(policy, view).reshape(-1, policy.domain.n)
        inside = policy.domain.contains(states)
        symbols = np.full(len(states), -2)
        symbols[inside] = seen_at_level(policy, states[inside], view["level"])
        np.testing.assert_array_equal(pixels, symbols)
        mixed += (symbols == -3).sum()
    assert mixed


@pytest.mark.parametrize(
    "name", ["cart-pendulum", "random 7", "random 7 adaptive", "exact", "affine 3"]
)
def test_levels_are_as_many_as_the_slider_shows(name, tmp_path):
    policy = POLICIES[name]()
    levels = node(tmp_path, LOOKUP + "print(lookup.levels);", policy)
    if not isinstance(policy.cells, CellTree):
        assert levels == 0
    else:
        adaptive = policy.cells.splits is not None
        deepest = adaptive or policy.has_planes
        assert levels == (policy.cells.depth if deepest else policy.cells.max_level)
        assert not adaptive or levels > policy.cells.max_level


def test_places_are_those_of_cells(tmp_path):
    policy = built_in("cart-pendulum")
    view = next(views_of(policy))
    pixels = node(tmp_path, LOOKUP + RASTER, policy, views=[view], what="places")[0]
    states = centres(policy, view).reshape(-1, 2)
    places = policy.cells.find(policy.domain.locate(states, policy.cells.counts))
    np.testing.assert_array_equal(pixels, places)


@pytest.mark.parametrize("name", REMEMBERING)
def test_what_follows_is_shown_for_each_symbol_in_force_and_for_any(name, tmp_path):
    policy = POLICIES[name]()
    view, count = next(views_of(policy)), len(policy.alphabet)
    states = centres(policy, view).reshape(-1, policy.domain.n)
    now = [*range(count), -1]
    code = (
        LOOKUP
        + """
      const shown = input.now.map(now => {
        lookup.shown = now;
        return lookup.raster(input.view);
      });
      const rows = numbers(input.states).map(x => lookup.cell(x));
      print({ shown, rows });
    """
    )
    some = states[:: len(states) // 200]
    answer = node(tmp_path, code, policy, view=view, states=texts(some), now=[*now, None])
    wanted = [expected(policy, states, "error", j)[0] for j in now]
    np.testing.assert_array_equal(answer["shown"][:-1], wanted)
    rows = [cell["row"] for cell in answer["rows"]]
    np.testing.assert_array_equal(rows, np.transpose([policy(some, current=j) for j in now]))
    assert all(set(cell["row"]) <= set(cell["allowed"]) for cell in answer["rows"])
    reached = [j - (count + 1) * (j == count) for j in reachable(policy)]
    follow = np.array([wanted[j] for j in reached])
    stripes = np.array(answer["shown"][-1])
    assert (stripes == follow).any(axis=0).all()  # each pixel is of something that may follow
    depends = (follow != follow[0]).any(axis=0)
    assert depends.any() and not depends.all()
    assert set(stripes[depends]) == set(follow[:, depends].ravel())
