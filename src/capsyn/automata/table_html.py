"""Automata as tables for notebooks."""

from __future__ import annotations

from typing import Any

from capsyn.notebook import table

MOST = 30
"""More symbols than these are not in the table."""
SIGNS = {True: "●", None: "○", False: "×"}
"""Of edges that are possible, not decided and proved impossible."""


def automaton_html(automaton: Any) -> str:
    """Return which symbol may follow which: a row for each in force, a column for each that may."""
    shown = automaton.vertices[:MOST]
    signs = {
        (edge.source, edge.target): SIGNS[edge.possible] + ("*" if edge.sliding else "")
        for edge in automaton.edges
    }
    names = dict(zip(automaton.vertices, automaton.names))
    rows = [
        [names[source], *(signs.get((source, target), "") for target in shown)] for source in shown
    ]
    more = len(automaton.vertices) - len(shown)
    title = f"{automaton!r}: ● may follow, ○ undecided, × impossible, * chatters"
    title += f"; {more} more symbols" if more else ""
    return table(title, rows, ["in force", *(names[target] for target in shown)])
