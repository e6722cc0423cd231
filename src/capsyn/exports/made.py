"""What a target makes of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from capsyn.exports.golden import Golden
from capsyn.exports.plan import Files


@dataclass(frozen=True)
class Made:
    """Files of a target, and what a user must be told.

    Parameters
    ----------
    files : dict of bytes by name
        Its files.
    renamed : dict, optional
        Names that are no identifiers of the language, and what they became.
    notes : tuple of texts, optional
        What a user must be told.
    changed : float, optional
        Share of random states in the domain whose symbol is another than the policy's, as numbers
        are rounded for the target. None: no state at all, since the target rounds to the policy's
        own lattice.
    golden : Golden, optional
        Vectors of readings as the target holds them. None: those of the plan.
    """

    files: Files
    renamed: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    changed: float | None = None
    golden: Golden | None = None
