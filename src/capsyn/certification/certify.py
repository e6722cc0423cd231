"""`certify`: what is proved of the sampled loop from a drawn set of starts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capsyn.certification.certificate import Certificate
from capsyn.modelling.domain import Ball, Box
from capsyn.policies.policy import Policy


def certify(
    policy: Policy,
    initial: Ball | Box | None = None,
    target: Any = None,
    avoid: Any = None,
    *,
    rate: float | None = None,
    delay: float | None = None,
    noise: Any = None,
    parameters: Mapping[str, Any] | None = None,
    exogenous: Any = None,
    model: Any = None,
    min_dwell: float | None = None,
    counts: Any = None,
    seconds: float | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> Certificate:
    """Return what is proved of the loop of a policy; see `Certificate`."""
    raise NotImplementedError
