"""Colours of symbols."""

from __future__ import annotations

from typing import Any

import numpy as np

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999")
"""Colours that stay apart under colour blindness (Okabe and Ito)."""


def symbol_colors(count: int) -> list[Any]:
    """Return `count` colours that stay apart under colour blindness."""
    if count <= len(PALETTE):
        return list(PALETTE[:count])
    from matplotlib import colormaps

    return list(colormaps["cividis"](np.linspace(0, 1, count)))
