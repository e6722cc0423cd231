"""What the command line prints of a certificate."""

from __future__ import annotations

from typing import Any

from capsyn.cli.console import print_line
from capsyn.verification.sentences import circumstances, headlines, vector

MOST_REFUTED = 5
"""Most refuted starts that are printed."""


def print_certificate(data: dict[str, Any]) -> None:
    """Print what ``Certificate.to_json`` returns."""
    conditions, refuted = data["conditions"], data["refuted"]
    print_line("certificate", headlines({"certificate": data})["certificate"])
    for key, name in (("initial", "from"), ("target", "to"), ("avoid", "avoiding")):
        if conditions.get(key):
            print_line(name, str(conditions[key]))
    if by := circumstances(conditions):
        print_line("by", by)
    cells = " x ".join(map(str, data["cells"]))
    print_line("proof", f"{data['method']} on {cells} cells, in {data['seconds']:.3g} s")
    for start in refuted[:MOST_REFUTED]:
        print_line("refuted", f"from {vector(start['state'])} it {_named(start['failure'])}")
        if start.get("replay"):
            print_line("again", start["replay"])
    if len(refuted) > MOST_REFUTED:
        print_line("", f"and {len(refuted) - MOST_REFUTED:,} more, which --json tells")


def _named(failure: str) -> str:
    return failure or "fails"
