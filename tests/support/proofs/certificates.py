"""Certificates made by hand, of which every figure is known."""

import numpy as np

from capsyn.certification.certificate import Certificate, ProvedCells


def by_hand(domain, counts, conditions=None, **changes):
    """Return a certificate over a grid of an even number of cells along each axis.

    Starts are the cells within 0.4 of the middle, in widths; those whose first state is above 0.75
    are open but for the very last, which is refuted. The loop arrives 4 s for each width from the
    middle, and stays in the cells within 0.1 of it.
    """
    axes = [(np.arange(count) + 0.5) / count for count in counts]
    shares = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(counts))
    away = np.abs(shares - 0.5).max(axis=1)
    starts = (away < 0.4).astype(float)
    arrives = starts * (shares[:, 0] < 0.75)
    last = int(np.flatnonzero(starts)[-1])
    refuted = np.arange(len(starts)) == last
    proved = float(arrives.sum() / starts.sum())
    cells = ProvedCells(
        domain, tuple(counts), starts, arrives, np.where(arrives, 4 * away, np.inf),
        away < 0.1, refuted,
    )  # fmt: skip
    ripple = domain.lower[:, None] + domain.widths[:, None] * [0.45, 0.55]
    figures = {
        "conditions": {"initial": "the middle", "target": "a ball", "rate": 1000.0}
        | (conditions or {}),
        "method": "boxes",
        "cells": cells,
        "arrival": proved,
        "staying": proved,
        "avoiding": 1.0,
        "within": 4 * float(away[arrives > 0].max()),
        "switch_rate": 13.23456,
        "ripple": ripple,
        "refuted": (domain.lower + domain.widths * shares[last])[None],
        "failures": ("stands still",),
        "open": float((starts * (arrives == 0) * ~refuted).sum() / starts.sum()),
        "seconds": 0.7,
    }
    return Certificate(**figures | changes)


def complete(domain, counts, **changes):
    """Return a certificate by hand with nothing open or refuted."""
    made = by_hand(domain, counts)
    cells = made.cells
    whole = ProvedCells(
        domain, cells.counts, cells.starts, cells.starts, np.where(cells.starts, 1.5, np.inf),
        cells.stays, np.zeros(len(cells.starts), bool),
    )  # fmt: skip
    figures = {
        "cells": whole, "arrival": 1.0, "staying": 1.0, "within": 1.5, "open": 0.0,
        "refuted": np.empty((0, domain.n)), "failures": (),
    }  # fmt: skip
    return by_hand(domain, counts, **figures | changes)
