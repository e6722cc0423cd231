"""What is said of a state that a policy has no symbol for."""

from __future__ import annotations

import numpy as np

from capsyn.modelling.domain import Box


def outside_text(domain: Box, state: np.ndarray, index: int | None, what: str = "state") -> str:
    """Return what is wrong with a state (n,): not finite, in a gap, or outside the domain.

    `index` is its place among others, if there are any; `what` it is called.
    """
    text = "(" + ", ".join(f"{v:g}" for v in state) + ")"
    which = f"{what} {index}" if index is not None else f"the {what}"
    if not np.isfinite(state).all():
        return f"{which} must be finite; got {text}"
    if domain.contains(state[None])[0]:
        return (
            f"{which} must be where the policy has a symbol; {text} is in a gap "
            "(a safe symbol would answer)"
        )
    bounds = " x ".join(f"[{low:g}, {high:g}]" for low, high in zip(domain.lower, domain.upper))
    return (
        f"{which} must lie in the domain {bounds}; got {text} "
        '(outside="nearest" or a safe symbol would answer)'
    )
