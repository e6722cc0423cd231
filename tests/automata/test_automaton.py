"""The automaton of Definition 2, as data, as a graph, as text and as a picture."""

import matplotlib

matplotlib.use("Agg")

import dataclasses
import json
import sys

import networkx
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

import capsyn
from capsyn import Alphabet, Box, problems, synthesize
from capsyn.automata.automaton import Automaton, Edge
from capsyn.errors import ProblemError
from capsyn.plots.automaton import plot_automaton, save_automaton, vertex_colors
from support.relays import below, hysteresis, relay
from support.trees import GRIDS, random_policy, states_at_faces

PLANE = Box([-2.0, -2.0], [2.0, 2.0])


def one_way():
    """Return the automaton of a drift through three bands: 0 to 1 to 2, never back."""

    def label(x):
        return np.digitize(x[:, 0], [-1.0, 1.0])

    policy = relay(lambda x, u: [1.0, -x[1]], PLANE, label, [1.0, 2.0, 3.0], partitions=8)
    return Automaton.of(policy)


def fan(symbols, names=None, model=True):
    """Return the automaton of a policy with many symbols, in bands that slide or let through."""
    alphabet = Alphabet(np.round(np.cos(np.arange(symbols) * 2.0), 3), names=names)
    edges = np.linspace(-2, 2, symbols + 1)[1:-1] - 1e-9

    def label(x):
        return np.digitize(x[:, 0], edges)

    policy = relay(lambda x, u: [u[0], 1.0], PLANE, label, alphabet, partitions=[symbols, 1])
    return Automaton.of(policy if model else dataclasses.replace(policy, model=None))


@pytest.mark.parametrize(
    ("name", "options", "count"),
    [
        ("cart-pendulum", {}, 2),
        ("cart-pendulum", {"alphabet": [-5.0, -2.0, 2.0, 5.0]}, 4),
    ],
)
def test_the_machines_of_the_paper_have_a_vertex_per_symbol_and_all_edges(name, options, count):
    problem = dataclasses.replace(problems.plain(name), **options)
    policy = synthesize(problem, max_level=2)
    machine = Automaton.of(policy)
    assert len(machine.vertices) == len(machine.regions) == count
    assert len(machine.edges) == count**2
    assert {(e.source, e.target) for e in machine.edges} == {
        (i, j) for i in machine.vertices for j in machine.vertices
    }
    for edge in machine.edges:  # the guard is the region of the target
        assert machine.regions[edge.region].label == edge.target
        assert machine.edge(edge.source, edge.target) is edge
    assert sum(r.share for r in machine.regions) == pytest.approx(1)
    assert [machine.region_name(k) for k in machine.vertices] == [f"A{k + 1}" for k in range(count)]
    assert np.array_equal(machine.controls, policy.alphabet.values)


def house():
    """Return a policy that goes from heating to cooling and back by way of off only."""
    alphabet = Alphabet([0.0, 1.0, -1.0], names=["off", "heat", "cool"])

    def label(x):
        cold, warm = x[:, 0] < -1.0, x[:, 0] > 1.0
        off = np.where(cold, 1, np.where(warm, 2, 0))
        return np.stack([off, np.where(warm, 0, 1), np.where(cold, 0, 2), off], axis=1)

    policy = relay(lambda x, u: [u[0], -x[1]], PLANE, label, alphabet, partitions=8, in_force=True)
    forbidden = [("heat", "cool"), ("cool", "heat")]
    return dataclasses.replace(policy, switching=capsyn.Switching(forbidden=forbidden))


@pytest.fixture(scope="module")
def priced():
    problem = problems.plain("cart-pendulum-4").replace(switching=capsyn.Switching(price="3%"))
    return synthesize(problem, max_level=3)


def test_the_switches_of_a_policy_that_remembers_are_edges_with_regions_of_their_own(priced):
    for policy in (house(), priced):
        machine = Automaton.of(policy)
        states = policy.domain.sample(2000)
        found = set()
        for source in machine.vertices:
            symbols = policy(states, current=source)
            found |= {(source, target) for target in set(symbols.tolist())}
            hits = np.zeros(len(states), dtype=int)
            for target in set(symbols.tolist()):
                lower, upper = machine.bounds(target, source)
                x = states[:, None]
                inside = ((lower <= x) & (x < upper)).all(axis=2).sum(axis=1)
                assert (inside == (symbols == target)).all()
                hits += inside
                region = machine.region(target, source)
                assert machine.regions[machine.edge(source, target).region] is region
                share = (symbols == target).mean()
                assert region.share == pytest.approx(share, abs=0.05)
            assert (hits == 1).all()
        assert found == {(edge.source, edge.target) for edge in machine.edges}


def test_forbidden_transitions_are_no_edges():
    machine = Automaton.of(house())
    assert machine.vertices == (0, 1, 2)
    pairs = {(edge.source, edge.target) for edge in machine.edges}
    assert pairs == {(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0), (2, 2)}
    with pytest.raises(ProblemError, match="`target` must be a symbol that follows 1"):
        machine.edge(1, 2)
    # heat warms up to 1, there it becomes off and at once cool: the start in the cold is heat
    assert all(edge.possible for edge in machine.edges)
    assert machine.edge(0, 2).rate == machine.edge(1, 0).rate > 0
    assert machine.region_name(1, 0) == "A12" and machine.region_name(0) == "A11"
    data = json.loads(json.dumps(machine.to_json()))
    assert data["remembers"] and data["vertices"][1]["volume_share"] == pytest.approx(0.75)
    assert {"region": "A31", "volume_share": 0.25}.items() <= data["edges"][5].items()
    assert "A12 is where heat follows off" in machine.to_dot()
    assert "1 -> 2" not in machine.to_dot()
    ax = drawn(machine)
    assert "A31" in {text.get_text() for text in ax.texts}
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert "A12 is where heat follows off" in legend


@pytest.mark.parametrize("name", ["house", "priced"])
def test_the_switches_of_a_fast_loop_are_not_called_impossible(name, request):
    policy = house() if name == "house" else request.getfixturevalue(name)
    machine = Automaton.of(policy)
    starts = policy.domain.sample(200, 1)
    run = capsyn.simulate(policy, starts, 5.0, 200.0, outside="nearest")
    before, after = run.symbols[:, :-1].ravel(), run.symbols[:, 1:].ravel()
    known = (before >= 0) & (after >= 0)
    taken = set(zip(before[known].tolist(), after[known].tolist()))
    assert len(taken) > 4
    for source, target in taken:
        assert machine.edge(source, target).possible is not False


def test_a_symbol_that_never_stays_is_a_vertex_without_a_region():
    def label(x):  # 0 and 1 in turn
        return np.stack([1 + 0 * x[:, 0], 0 * x[:, 0], 0 * x[:, 0]], axis=1).astype(int)

    policy = relay(lambda x, u: [u[0]], Box([-1.0], [1.0]), label, in_force=True)
    machine = Automaton.of(policy)
    assert {(e.source, e.target, e.possible, e.sliding) for e in machine.edges} == {
        (0, 1, True, True),
        (1, 0, True, True),
    }
    assert len(machine.region(0)) == 0 and machine.region(0).share == 0.0
    assert machine.to_json()["vertices"][0]["partitions"] == 0


def test_the_safe_symbol_outside_may_be_in_force():
    def label(x):
        return hysteresis(x)[:, [0, 1, 2, 2]]

    line = Box([-1.0], [1.0])
    policy = relay(lambda x, u: [u[0]], line, label, [1.0, -1.0, 0.5], partitions=6, in_force=True)
    assert Automaton.of(policy).vertices == (0, 1)
    machine = Automaton.of(dataclasses.replace(policy, outside=2))
    assert machine.vertices == (0, 1, 2)
    assert [machine.edge(2, target).possible for target in (0, 1)] == [None, None]


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("grid", range(len(GRIDS)))
def test_every_state_is_in_one_box_of_its_symbol(grid, turning):
    policy = random_policy(grid, turning)
    machine = Automaton.of(policy)
    states = states_at_faces(policy.domain, policy.cells.counts, 200)
    states = states[policy.domain.contains(states)]
    wrapped = policy.domain.wrap(states)
    symbols = policy(states) % 3
    hits = np.zeros(len(states), dtype=int)
    for label in machine.vertices:
        lower, upper = machine.bounds(label)
        last = (upper == policy.domain.upper) & ~np.array(policy.domain.periodic)
        x = wrapped[:, None]
        inside = ((lower <= x) & ((x < upper) | (last & (x == upper)))).all(axis=2).sum(axis=1)
        assert (inside[symbols != label] == 0).all()
        hits += inside
    assert (hits == 1).all()


def test_edges_that_the_flow_cannot_take_drop_out():
    machine = one_way()
    possible = {(e.source, e.target) for e in machine.edges if e.possible}
    assert possible == {(0, 0), (1, 1), (2, 2), (0, 1), (1, 2)}
    assert all(e.possible is False for e in machine.edges if (e.source, e.target) not in possible)
    assert machine.edge(0, 1).rate == pytest.approx(1 / 4)
    assert machine.edge(0, 1).sliding is False and machine.edge(0, 1).sliding_rate == 0
    assert machine.edge(0, 0) == Edge(0, 0, 0, True, False)
    assert repr(machine) == (
        "Automaton('relay', 3 vertices, 9 edges (5 possible), 3 partitions, 3 boxes)"
    )


def test_without_a_model_nothing_is_known_of_the_dynamics():
    machine = fan(3, model=False)
    assert machine.switching is None
    assert machine.edge(0, 1) == Edge(0, 1, 1)
    assert machine.to_json()["switching"] is None
    assert "style=dotted" not in machine.to_dot() and "dashed" not in machine.to_dot()
    assert len(machine.to_networkx().edges) == 9


def test_the_default_control_is_a_vertex_where_it_occurs_and_symbols_that_do_not_are_none():
    box = Box([-1.0], [1.0])
    policy = capsyn.subdivide(lambda x: np.where(x[:, 0] > 0, -1, 1), box, 3, max_level=0)
    machine = Automaton.of(policy)
    assert machine.vertices == (1, 3) and machine.names == ("1", "default")
    assert machine.region_name(3) == "A0" and machine.region_name(1) == "A2"
    assert machine.region(3).share == pytest.approx(4 / 9)
    assert vertex_colors(machine)[3] == "#ffffff"
    with pytest.raises(ProblemError, match="`label` must be one of 1, 3; got 0"):
        machine.region(0)


def test_plain_data():
    machine = one_way()
    data = json.loads(json.dumps(machine.to_json()))
    assert [v["name"] for v in data["vertices"]] == ["1", "2", "3"]
    assert sum(v["volume_share"] for v in data["vertices"]) == pytest.approx(1)
    assert data["vertices"][0] | {"volume_share": 0} == {
        "symbol": 0,
        "name": "1",
        "value": [1.0],
        "region": "A1",
        "volume_share": 0,
        "cells": 16,
        "boxes": 1,
        "partitions": 1,
    }
    assert data["switching"]["rate"] == pytest.approx(0.5)
    assert data["switching"]["exit_rate"] == pytest.approx(1 / 4)
    assert data["partitions"] == 3 and len(data["edges"]) == 9


def test_networkx_gets_the_multigraph():
    machine = one_way()
    graph = machine.to_networkx()
    assert isinstance(graph, networkx.MultiDiGraph) and graph.name == "relay"
    assert len(graph) == 3 and graph.number_of_edges() == 9
    assert graph.nodes[2]["name"] == "3" and graph.nodes[2]["boxes"] == 1
    assert graph.edges[0, 1, "A2"]["possible"] is True
    taken = [(a, b, k) for a, b, k, yes in graph.edges(keys=True, data="possible") if yes]
    loop_free = [(a, b) for a, b, _ in graph.edge_subgraph(taken).edges if a != b]
    assert networkx.is_directed_acyclic_graph(networkx.DiGraph(loop_free))
    again = networkx.parse_graphml("\n".join(networkx.generate_graphml(graph)), node_type=int)
    assert again.nodes[1] == graph.nodes[1] and again.number_of_edges() == 9


def test_networkx_is_asked_for_where_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "networkx", None)
    with pytest.raises(ProblemError, match=r"pip install 'capsyn\[graphs\]'$"):
        fan(2).to_networkx()


def test_dot_text():
    text = one_way().to_dot({0: "#112233", 1: "#445566", 2: "#778899"})
    assert text == one_way().to_dot({0: "#112233", 1: "#445566", 2: "#778899"})
    assert '    0 [label="1", style=filled, fillcolor="#112233", fontcolor="#ffffff"];' in text
    assert '    0 -> 1 [label="A2"];' in text
    assert '    1 -> 0 [label="A1", style=dashed, color="#999999", fontcolor="#999999"];' in text
    assert text.count("->") == 9 and text.count("dashed") == 4
    assert (
        '0 -> 1 [label="A2*"];'
        in Automaton.of(relay(lambda x, u: [u[0]], Box([-1.0], [1.0]), below())).to_dot()
    )
    names = ['say "go"', "back\\slash"]
    assert '[label="say \\"go\\""' in fan(2, names).to_dot()
    assert '[label="back\\\\slash"' in fan(2, names).to_dot()


@pytest.mark.parametrize("ending", ["dot", "svg", "png", "pdf"])
def test_the_same_automaton_gives_the_same_bytes(tmp_path, ending):
    one, two = tmp_path / f"one.{ending}", tmp_path / f"two.{ending}"
    save_automaton(fan(3), one)
    save_automaton(fan(3), two)
    assert one.read_bytes() == two.read_bytes() and one.stat().st_size > 100
    assert b"date>" not in one.read_bytes()


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(ProblemError, match=r"`path` must end in .dot, .png, .pdf, .svg; got"):
        save_automaton(fan(2), tmp_path / "machine.gif")


def drawn(machine):
    few = len(machine.vertices) <= 2
    figure = Figure(figsize=(5.4, 2.8) if few else (6.6, 7.2), layout="constrained")
    ax = plot_automaton(machine, figure.add_subplot())
    figure.canvas.draw()
    return ax


@pytest.mark.parametrize("symbols", [1, 2, 3, 4, 6, 8])
def test_the_picture_has_every_vertex_edge_and_label_clear_of_each_other(symbols):
    machine = fan(symbols)
    ax = drawn(machine)
    circles = [p for p in ax.patches if isinstance(p, Circle)]
    arrows = [p for p in ax.patches if isinstance(p, FancyArrowPatch)]
    assert len(circles) == symbols and len(arrows) == symbols**2
    texts = [text.get_text() for text in ax.texts]
    assert len(texts) == symbols**2 + symbols and set(machine.names) <= set(texts)
    dashed = [a for a in arrows if a.get_linestyle() not in ("-", "solid")]
    assert len(dashed) == sum(e.possible is False for e in machine.edges)
    boxes = [t.get_window_extent() for t in ax.texts]
    for i, one in enumerate(boxes):
        assert ax.figure.bbox.containsx(one.x0) and ax.figure.bbox.containsx(one.x1)
        assert not any(one.overlaps(other) for other in boxes[:i]), (texts[i], i)
    for circle, name in zip(circles, machine.names):  # names fit their circles
        text = next(t for t in ax.texts if t.get_text() == name)
        assert text.get_window_extent().width < circle.get_window_extent().width


def test_long_names_stand_beside():
    machine = fan(2, ["a rather long name", "short"])
    ax = drawn(machine)
    assert {"u1", "u2"} < {text.get_text() for text in ax.texts}
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert {"u1 = a rather long name", "u2 = short"} <= set(legend)


def test_what_is_no_policy_is_refused():
    with pytest.raises(ProblemError, match="`policy` must be a Policy; got 'x'"):
        Automaton.of("x")
    assert isinstance(fan(2), Automaton)
