"""The cart-pendulum with its law's features, and their values written out once more."""

import functools
import re

import casadi as ca
import numpy as np

from capsyn import compress, problems, synthesize

FEATURES = {
    "energy": lambda x: 2 * x[1] ** 2 + 19.62 * (ca.cos(x[0]) - 1),
    "unused": lambda x: ca.exp(x[1]),
    "cos(theta) * omega": lambda x: ca.cos(x[0]) * x[1],
}
BY_NUMPY = {
    "energy": lambda x: 2 * x[:, 1] ** 2 + 19.62 * (np.cos(x[:, 0]) - 1),
    "cos(theta) * omega": lambda x: np.cos(x[:, 0]) * x[:, 1],
}
"""The features of the tree, of states (B, n)."""


def value_of(name, states):
    """Return the values (B,) of a feature at states, or of a sum of the two as its name says."""
    if name in BY_NUMPY:
        return BY_NUMPY[name](states)
    energy, pace = (function(states) for function in BY_NUMPY.values())
    text = re.sub(r"([\d.]+) (?=[(e])", r"\1 * ", name)
    return eval(text.replace("(cos(theta) * omega)", "pace"), {"energy": energy, "pace": pace})


@functools.cache
def pendulum():
    return synthesize(problems.plain("cart-pendulum"))


@functools.cache
def exact():
    return compress(pendulum(), features=FEATURES)


def all_steps(counts):
    return np.stack(np.unravel_index(np.arange(np.prod(counts)), counts), axis=1)


def walked(tree, steps):
    """Return the labels (B,) of lattice steps by the documented rules, features by NumPy."""
    cells, domain = tree.cells, tree.domain
    centres = domain.lower + (steps + 0.5) / np.array(cells.counts) * domain.widths
    columns = list(steps.T)
    for name, thresholds in zip(cells.features.names, cells.features.thresholds):
        columns.append((value_of(name, centres)[:, None] >= thresholds).sum(axis=1))
    z, labels = np.stack(columns, axis=1), np.empty(len(steps), dtype=int)
    for b, row in enumerate(z.tolist()):
        node = 0
        while (split := cells.split[node]) >= 0:
            value = row[split] if split < len(row) else cells.planes[split - len(row)] @ row
            node = cells.second[node] if value >= cells.threshold[node] else node + 1
        labels[b] = cells.threshold[node]
    return labels
