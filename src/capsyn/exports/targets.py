"""All targets by name, each of them loaded when it is asked for."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from capsyn.exports.target import Target

TARGETS = {
    "c": "c.target",
    "structured-text": "structured_text.target",
    "verilog": "verilog.target",
    "fmu": "fmu.target",
    "python": "python_module",
    "javascript": "javascript.target",
    "dot": "dot",
    "json": "policy_json.target",
}
"""Targets and their modules, each of which has its `Target` as ``TARGET``."""


def load(name: str) -> Target:
    """Return a target of `TARGETS`."""
    target: Target = importlib.import_module(f"capsyn.exports.{TARGETS[name]}").TARGET
    return target
