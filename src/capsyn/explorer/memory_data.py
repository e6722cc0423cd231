"""What the page of a policy needs where the symbol in force matters: plain data and words."""

from __future__ import annotations

from typing import Any

import numpy as np

from capsyn.automata.automaton import edges_between
from capsyn.cells.cell_tree import CellTree
from capsyn.policies.in_force import followers, reachable
from capsyn.policies.policy import Policy


def needs_memory(policy: Policy) -> bool:
    """Return whether a page must know more than one least time: of all symbols, of inputs, a delay.

    Pages of other policies have nothing of what the symbol in force brings with it.
    """
    return policy.remembers or policy.switching is not None or policy.delay > 0


def memory_data(policy: Policy) -> dict[str, Any]:
    """Return what the symbol in force decides, as plain data.

    Labels are symbols, and N for the default control, which is in force before the first decision:

    - ``transitions`` (R - N - 1, N + 1), an array: which label follows each, of the rows that are
      not constant, whose numbers begin with N + 1;
    - ``in_force``: the labels that may ever be in force, but for the start;
    - ``kinds`` (N + 1): equal where a change is no switch;
    - ``forbidden`` (N + 1, N + 1): whether a change must not be, from each to each;
    - ``holds`` (N + 1), ``input_holds`` (m): least times [time unit].
    """
    rules = policy.rules
    return {
        "transitions": policy.transitions[len(policy.alphabet) + 1 :],
        "in_force": reachable(policy).tolist(),
        "kinds": rules.kinds.tolist(),
        "forbidden": rules.forbidden.tolist(),
        "holds": rules.holds.tolist(),
        "input_holds": rules.input_holds.tolist(),
    }


def one_hold(policy: Policy) -> float:
    """Return the least time of all symbols [time unit], 0 where they have several."""
    holds, inputs = policy.rules.holds, policy.rules.input_holds
    return 0.0 if np.ptp(holds) or inputs.any() else float(holds[0])


def memory_automaton(policy: Policy) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return vertices and edges, with the cells in which a symbol stays or is followed by another.

    An affine leaf is one of the cells of every edge to a symbol of its rows that is not forbidden.
    """
    labels, counts = reachable(policy).tolist(), _cells_of_edges(policy)
    keys = ("source", "target", "possible", "sliding")
    if policy.has_planes:
        follows = followers(policy)
        pairs: list[Any] = [(s, t, None, None) for s in labels for t in labels if follows[s, t]]
    else:
        found = edges_between(policy, labels)
        pairs = [(e.source, e.target, e.possible, e.sliding) for e in found]
    edges = [dict(zip(keys, pair)) | {"cells": int(counts[pair[:2]])} for pair in pairs]
    return [{"symbol": k, "cells": int(counts[k, k])} for k in labels], edges


def _cells_of_edges(policy: Policy) -> np.ndarray:
    """Return in how many leaves which label follows which, (N + 1, N + 1)."""
    table, cells = policy.transitions, policy.cells
    labels = table.shape[1]
    numbers, times = np.unique(cells.constant_leaves(len(table)), return_counts=True)
    counts = np.zeros((labels, labels), dtype=np.int64)
    for now in range(labels):
        counts[now] = np.bincount(table[numbers, now], times, labels)
    if isinstance(cells, CellTree) and cells.affine is not None:
        of_symbols = np.bincount(cells.affine.symbols, minlength=labels)
        ratios = cells.affine.ratios
        counts += of_symbols if ratios is None else np.where(ratios < 0, 0, of_symbols)
    return counts


def memory_facts(policy: Policy) -> list[tuple[str, str]]:
    """Return what switching costs and waits for, in rows of name and text."""
    rules, unit = policy.rules, policy.time_unit
    names = [*policy.alphabet.names, "default"]
    prices = rules.prices[:-1, :-1]
    paid = prices[np.isfinite(prices) & (prices > 0)]
    rows = []
    if paid.size:
        span = f"{paid.min():.4g}" + (f" to {paid.max():.4g}" if np.ptp(paid) else "")
        rows.append(("price", f"{span} for each switch, in cost per {unit}"))
    if hold := one_hold(policy):
        rows.append(("least dwell", f"{hold:g} {unit}"))
    else:
        times = [*zip(names, rules.holds), *zip(policy.alphabet.inputs, rules.input_holds)]
        held = [f"{name} for {time:g} {unit}" for name, time in times if time]
        rows += [("held at least", ", ".join(held))] if held else []
    if rules.forbidden.any():
        pairs = (f"{names[j]} → {names[i]}" for j, i in np.argwhere(rules.forbidden))
        rows.append(("forbidden", ", ".join(pairs)))
    if policy.delay:
        rows.append(("input delay", f"{policy.delay:g} {unit}, compensated"))
    return rows
