"""The automaton of a policy: Definition 2 as a directed multigraph."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsyn.automata.face_rates import POSSIBLE, SLIDING, UNDECIDED
from capsyn.automata.regions import Partitions, Region, connected_partitions, guards, regions
from capsyn.automata.switching import SlidingFace, Switching, known_switching
from capsyn.automata.table_html import automaton_html
from capsyn.errors import ProblemError
from capsyn.modelling.domain import Box
from capsyn.policies.colors import ink_on
from capsyn.policies.in_force import followers, reachable
from capsyn.policies.policy import Policy
from capsyn.validation import describe

TOLD = 20
"""Most sliding faces among plain data."""


@dataclass(frozen=True)
class Edge:
    """A transition: a state in region A_j takes the machine to symbol j, whatever symbol is held.

    For a policy that remembers, each pair has a region: A_ij takes the machine from i to j.

    An edge with the same source and target holds the symbol. `possible` is False if the closed loop
    in continuous time is proved never to take the edge, True if it is proved to take it at some
    state, and None if neither is proved or there is no model. `sliding` says in the same way
    whether the loop slides (chatters) between the two symbols anywhere. Rates are from evenly
    spread states, see `Switching`. They are None without a model, and for edges that hold.
    """

    source: int  # symbols, N for the default control
    target: int
    region: int  # its guard, by its place in ``Automaton.regions``
    possible: bool | None = None
    sliding: bool | None = None
    rate: float | None = None  # of crossings [1 / time unit]
    sliding_rate: float | None = None  # of arrivals where the loop then slides [1 / time unit]


@dataclass(frozen=True, eq=False)
class Automaton:
    """A policy as a finite state machine ``<U, L, T>`` (Definition 2 of the paper).

    The vertices are the V symbols that the policy uses. There are V^2 edges, with regions as
    guards. For a policy that remembers, the vertices are the symbols that may be in force. Its
    edges are the switches that the policy makes somewhere, each with a region of its own.

    Parameters
    ----------
    name : str
        Name of the policy.
    domain : Box
        Domain of the policy, with the axes of exogenous inputs.
    counts : n ints
        Finest cells along each axis.
    symbols : int
        Number N of symbols, which also stands for the default control.
    vertices : tuple of int
        The symbols that occur, or that may be in force, ascending; N is the default control.
    names : tuple of str
        Names of the vertices.
    controls : (V, m)
        Control vectors of the vertices [input units].
    regions : tuple of Region
        Regions of the vertices, or of the edges, as boxes that tile them.
    edges : tuple of Edge
        All edges, by source and then by target.
    partitions : Partitions
        The connected partitions L of the regions. For a policy that remembers, their labels are
        rows of `Policy.transitions`; a region counts those of what follows its source.
    switching : Switching or None
        The vector field on the faces between symbols; None without a model.
    time_unit : str
        Unit of time of the rates, see `Problem`.
    remembers : bool
        Whether the next symbol depends on the symbol in force.
    told : int
        Number of exogenous inputs (the last axes). Partitions connect along them; switches do not.
    """

    name: str
    domain: Box
    counts: tuple[int, ...]
    symbols: int
    vertices: tuple[int, ...]
    names: tuple[str, ...]
    controls: np.ndarray
    regions: tuple[Region, ...]
    edges: tuple[Edge, ...]
    partitions: Partitions
    switching: Switching | None
    time_unit: str = "s"
    remembers: bool = False
    told: int = 0

    @staticmethod
    def of(policy: Policy) -> Automaton:
        """Return a policy as a finite state machine.

        Parameters
        ----------
        policy : Policy
            The policy. Without a model, nothing is known of which edges its loop can take.

        Raises
        ------
        ProblemError
            `policy` is no policy, or its tree has oblique splits.
        """
        if not isinstance(policy, Policy):
            raise ProblemError(f"`policy` must be a Policy; got {describe(policy)}")
        if policy.has_planes:
            raise ProblemError(
                f"`policy` must have cells of one symbol each or splits along the axes; {policy!r} "
                f"has {policy.cells.planes_are}"
            )
        vertices = tuple(reachable(policy).tolist())
        partitions = connected_partitions(policy.cells, policy.space.periodic)
        if policy.remembers:
            areas = tuple(guards(policy.cells, policy.space.periodic, policy.transitions, vertices))
        else:
            areas = tuple(regions(policy.cells, partitions))
        names = (*policy.alphabet.names, policy.symbol_name(-1))
        analysis = known_switching(policy)
        return Automaton(
            name=policy.name,
            domain=policy.space,
            counts=tuple(policy.cells.counts),
            symbols=len(policy.alphabet),
            vertices=vertices,
            names=tuple(names[label] for label in vertices),
            controls=policy.controls[list(vertices)],
            regions=areas,
            edges=tuple(_edge(*pair, analysis) for pair in _pairs(policy, vertices)),
            partitions=partitions,
            switching=analysis,
            time_unit=policy.time_unit,
            remembers=policy.remembers,
            told=policy.space.n - policy.domain.n,
        )

    def region_name(self, label: int, source: int | None = None) -> str:
        """Return the name of the region of symbol `label`: A1 for the first, A0 for the default.

        For a policy that remembers, it is the region of the edge from `source`, such as A21 from
        the second symbol to the first. The default `source` is the symbol itself.
        """
        if not self.remembers:
            return f"A{self.symbol_number(label)}"
        numbers = (self.symbol_number(k) for k in (label if source is None else source, label))
        return "A" + ("" if self.symbols < 10 else ",").join(map(str, numbers))

    def symbol_number(self, label: int) -> int:
        """Return the paper's number of symbol `label`: 1 for the first, 0 for the default."""
        self._vertex(label)
        return (label + 1) % (self.symbols + 1)

    def region(self, label: int, source: int | None = None) -> Region:
        """Return the region of symbol `label`, N for the default control.

        For a policy that remembers, it is the region in which the symbol follows `source`, by
        default the symbol itself. This region may be empty.
        """
        place = self._vertex(label)
        if not self.remembers:
            return self.regions[place]
        source = label if source is None else source
        self._vertex(source)
        for region in self.regions:
            if (region.source, region.label) == (source, label):
                return region
        none = np.zeros((0, self.domain.n), dtype=np.int64)
        return Region(label, none, none, none[:, 0], 0, 0.0, source)

    def edge(self, source: int, target: int) -> Edge:
        """Return the edge from symbol `source` to `target`; `ProblemError` if there is none."""
        for label in (source, target):
            self._vertex(label)
        for edge in self.edges:
            if (edge.source, edge.target) == (source, target):
                return edge
        raise ProblemError(
            f"`target` must be a symbol that follows {source} somewhere; got {target}"
        )

    def bounds(self, label: int, source: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the `Region.bounds` (K, n) [state units] of `region`, for `label` and `source`."""
        return self.region(label, source).bounds(self.domain, self.counts)

    def sliding_faces(self) -> list[SlidingFace]:
        """Return the faces on which the loop slides, largest sliding area first.

        Without a model there are none.
        """
        analysis, domain = self.switching, self.domain
        if analysis is None:
            return []
        area = analysis.areas * analysis.shares[:, SLIDING]
        rows = np.flatnonzero(analysis.statuses[:, SLIDING] == POSSIBLE)
        rows = rows[np.argsort(-area[rows], kind="stable")]
        lower = domain.points(analysis.faces.lower[rows], self.counts)
        upper = domain.points(analysis.faces.upper[rows], self.counts)
        axes, pairs = analysis.faces.axis[rows].tolist(), analysis.labels[rows].tolist()
        return [
            SlidingFace(axis, tuple(low), tuple(high), below, above, share)
            for axis, low, high, (below, above), share in zip(
                axes, lower.tolist(), upper.tolist(), pairs, analysis.shares[rows, SLIDING].tolist()
            )
        ]

    def _vertex(self, label: int) -> int:
        if label not in self.vertices:
            used = ", ".join(map(str, self.vertices))
            raise ProblemError(f"`label` must be one of {used}; got {describe(label)}")
        return self.vertices.index(label)

    def to_json(self) -> dict[str, Any]:
        """Return the automaton as plain data, without the corners of its boxes.

        The data have only the first `TOLD` sliding faces.
        """
        analysis = self.switching
        kept = [self.region(label) for label in self.vertices]
        names, n = self.domain.names, self.domain.n - self.told
        return {
            **({} if self.time_unit == "s" else {"time_unit": self.time_unit}),
            **({"remembers": True} if self.remembers else {}),
            "name": self.name,
            "states": list(names[:n]),
            **({"exogenous": list(names[n:])} if self.told else {}),
            "vertices": [
                {
                    "symbol": region.label,
                    "name": name,
                    "value": control.tolist(),
                    "region": self.region_name(region.label),
                    "volume_share": region.share,
                    "cells": region.cells,
                    "boxes": len(region),
                    "partitions": len(np.unique(region.partitions)),
                }
                for region, name, control in zip(kept, self.names, self.controls)
            ],
            "edges": [
                vars(edge)
                | {"region": self.region_name(edge.target, edge.source)}
                | ({"volume_share": self.regions[edge.region].share} if self.remembers else {})
                for edge in self.edges
            ],
            "partitions": len(self.partitions),
            "switching": None
            if analysis is None
            else {
                "faces": len(analysis.faces),
                "rate": analysis.rate,
                "sliding_rate": float(analysis.sliding_rates.sum()),
                "sliding_share": analysis.sliding_share,
                "exit_rate": float(analysis.exit_rates.sum()),
                "sliding_faces": [vars(face) for face in self.sliding_faces()[:TOLD]],
            },
        }

    def to_dot(self, colors: Mapping[int, str] | None = None) -> str:
        """Return the graph in the language of Graphviz; the same automaton gives the same text.

        Edges that are proved impossible are dashed and grey. Undecided edges are dotted. A star
        marks edges on which the loop chatters somewhere.

        Parameters
        ----------
        colors : mapping of symbol to text, optional
            Colours of the vertices by symbol, as ``#rrggbb``.
        """
        lines = [
            f"// Finite state machine of a control alphabet policy; {self.guards_are}.",
            "// Dashed: proved impossible; dotted: undecided; *: the loop chatters somewhere.",
            f"digraph {_quoted(self.name)} {{",
            "    node [shape=circle];",
        ]
        for label, name in zip(self.vertices, self.names):
            filled = _filled(colors[label]) if colors else ""
            lines.append(f"    {label} [label={_quoted(name)}{filled}];")
        for edge in self.edges:
            text = self.edge_text(edge)
            style = ""
            if edge.possible is False:
                style = ', style=dashed, color="#999999", fontcolor="#999999"'
            elif edge.possible is None and self.switching:
                style = ", style=dotted"
            lines.append(f"    {edge.source} -> {edge.target} [label={_quoted(text)}{style}];")
        return "\n".join([*lines, "}"]) + "\n"

    @property
    def guards_are(self) -> str:
        """The meaning of the regions' names, in words."""
        if not self.remembers:
            return "A is the region of a symbol"
        first = min(self.edges, key=lambda edge: edge.source == edge.target)
        names = dict(zip(self.vertices, self.names))
        region = self.region_name(first.target, first.source)
        return f"{region} is where {names[first.target]} follows {names[first.source]}"

    def edge_text(self, edge: Edge) -> str:
        """Return the label of an `edge`: its region, with a star if the loop chatters there."""
        return self.region_name(edge.target, edge.source) + ("*" if edge.sliding else "")

    def to_networkx(self) -> Any:
        """Return the graph as a ``networkx.MultiDiGraph``.

        Its nodes are symbols, with ``name``, ``value``, ``volume_share``, ``cells``, ``boxes`` and
        ``partitions``. The key of an edge is the name of its region, and its attributes have the
        names of `Edge`. All attributes are numbers or text, so graph files can hold them.

        Raises
        ------
        ProblemError
            NetworkX is not installed.
        """
        try:
            import networkx
        except ImportError:
            raise ProblemError(
                "`to_networkx` needs NetworkX: pip install 'capsyn[graphs]'"
            ) from None
        data = self.to_json()
        graph = networkx.MultiDiGraph(name=self.name)
        for vertex in data["vertices"]:
            vertex["value"] = ", ".join(f"{v:g}" for v in vertex["value"])
            graph.add_node(vertex.pop("symbol"), **vertex)
        for edge in data["edges"]:
            known = {key: value for key, value in edge.items() if value is not None}
            graph.add_edge(known.pop("source"), known.pop("target"), known["region"], **known)
        return graph

    def __repr__(self) -> str:
        possible = sum(edge.possible is not False for edge in self.edges)
        edges, boxes = f"{len(self.edges)} edges ({possible} possible)", sum(map(len, self.regions))
        return f"Automaton('{self.name}', {len(self.vertices)} vertices, {edges}, " + (
            f"{len(self.partitions)} partitions, {boxes} boxes)"
        )

    _repr_html_ = automaton_html


def edges_between(policy: Policy, vertices: Sequence[int]) -> tuple[Edge, ...]:
    """Return all edges between symbols, by source and then by target, without their regions.

    The policy is as in `Automaton.of`; N is the default control.
    """
    analysis = known_switching(policy)
    return tuple(_edge(*pair, analysis) for pair in _pairs(policy, vertices))


def _pairs(policy: Policy, vertices: Sequence[int]) -> list[tuple[int, int, int]]:
    """Return the edges between symbols: sources, targets, and the places of their regions."""
    pairs = list(itertools.product(vertices, enumerate(vertices)))
    if not policy.remembers:
        return [(source, target, place) for source, (place, target) in pairs]
    follows = followers(policy)
    some = [(source, target) for source, (_, target) in pairs if follows[source, target]]
    return [(source, target, place) for place, (source, target) in enumerate(some)]


def _edge(source: int, target: int, region: int, analysis: Switching | None) -> Edge:
    if source == target:
        return Edge(source, target, region, True, False)
    if analysis is None:
        return Edge(source, target, region)
    return Edge(
        source,
        target,
        region,
        _known(analysis.switches[source, target]),
        _known(analysis.slidings[source, target]),
        float(analysis.switch_rates[source, target]),
        float(analysis.sliding_rates[source, target]),
    )


def _filled(color: str) -> str:
    """Return the attributes of a vertex of a colour ``#rrggbb``, with a text that can be read."""
    return f', style=filled, fillcolor="{color}", fontcolor="{ink_on(color)}"'


def _known(status: int) -> bool | None:
    return None if status == UNDECIDED else bool(status == POSSIBLE)


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
