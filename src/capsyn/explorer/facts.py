"""The facts of a policy as short lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from capsyn.alphabets.judged import chosen_among, columns
from capsyn.verification.sentences import evidence_rows

ROLES = {
    "vertices": "at vertices",
    "centers": "at centres",
    "others": "at other test points",
    "quarter": "second looks at ties",
}

Row = tuple[str, str]


def facts(data: dict[str, Any], switching: Sequence[Row] = ()) -> list[dict[str, Any]]:
    """Return sections of rows (name, text) from what `capsyn.policies.report.report` returns.

    Rows of what switching costs and waits for, if there are any, stand in the place of the least
    dwell. Sections without rows are left out. That of a chosen alphabet has a ``table``, too: texts
    by row, the first of which is the head, and ``points`` of a picture.
    """
    sections = {
        "Solves": _solves(data["statistics"]),
        "Size": _size(data),
        "Evidence": evidence_rows(data["evidence"]),
        "Controller": _controller(data, switching),
        "Hints": [("", hint) for hint in data["hints"]],
    }
    found: list[dict[str, Any]] = [
        {"title": title, "rows": rows} for title, rows in sections.items() if rows
    ]
    if study := data["statistics"].get("alphabet"):
        found.append(_alphabet(study))
    return found


def _alphabet(study: dict[str, Any]) -> dict[str, Any]:
    """Return how the alphabet was chosen, with the table of the study, and its points."""
    rows = columns(study["rows"], study["time_unit"], study["count"])
    table = [list(rows[0]), *(list(row.values()) for row in rows)] if rows else []
    names = ("kind", "objective", "low", "high")
    points = [
        {"symbols": row["alphabet"]} | {name: row[name] for name in names}
        for row in study["rows"]
        if None not in (row["objective"], row["low"], row["high"])
    ]
    told = [("", chosen_among(study))]
    return {"title": "Choice of the alphabet", "rows": told, "table": table, "points": points}


def _size(data: dict[str, Any]) -> list[Row]:
    axes = [*data["states"], *data.get("exogenous", ())]
    grid = " x ".join(str(axis["steps"]) for axis in axes)
    if "cells" not in data:
        oblique = f", {data['planes']:,} of them oblique" if data["planes"] else ""
        return [
            ("nodes", f"{data['nodes']:,}{oblique}"),
            *([("features", ", ".join(data["features"]["names"]))] if data["features"] else ()),
            ("comparisons", f"{data['depth']} at most"),
            ("lattice", f"{grid} steps"),
            ("packed", f"{data['packed_bytes']:,} bytes"),
            ("guarantee", data["guarantee"]["text"]),
        ]
    root = " x ".join(str(axis["partitions"]) for axis in axes)
    way = "along some axes" if data["adaptive"] else "along all axes"
    return [
        ("cells", f"{data['cells']:,}"),
        ("root grid", f"{root}, split up to {data['max_level']} times {way}"),
        ("finest grid", grid),
        ("mixed", f"{data['mixed_cells']:,} cells, {data['mixed_share']:.2%} of the volume"),
        ("packed", f"{data['packed_bytes']:,} bytes"),
    ]


def _solves(statistics: dict[str, Any]) -> list[Row]:
    """Return the number of solves beside what Proposition 2 allows, and what they were for."""
    if "solves" not in statistics:
        return []
    solves, worst = statistics["solves"], statistics.get("worst_case_solves")
    rows = [("solves", f"{solves:,}")]
    if worst:
        needed = f": {solves / worst:.1%} were needed" if solves <= worst else ""
        rows.append(("Proposition 2", f"{worst:,} at worst{needed}"))
    roles = statistics.get("solves_by_role", {})
    rows += [(text, f"{roles[role]:,}") for role, text in ROLES.items() if roles.get(role)]
    for key, text in (
        ("indifferent_points", "ties"),
        ("not_finite_points", "not finite"),
        ("limit_points", "solved inside a cell"),
    ):
        if statistics.get(key):
            points = statistics[key]
            rows.append((text, f"{points:,} test point{'' if points == 1 else 's'}"))
    return rows


def _controller(data: dict[str, Any], switching: Sequence[Row]) -> list[Row]:
    rows: list[Row] = []
    settings, unit, mapped = data["settings"], data.get("time_unit", "s"), "discrete" in data
    if data["horizon"] is not None:
        rows.append(("horizon", f"{data['horizon']:g} {'samples' if mapped else unit}"))
    if settings and data["horizon"] is not None:
        rows.append(("rule", settings["rule"]))
        if settings["rule"] == "schedule":
            wanted = "gamma" if settings["alpha_d"] is None else "alpha_d"
            rows.append((wanted, f"{settings[wanted]:g}"))
        weight, steps = np.atleast_2d(settings["control_weight"]), settings["steps"]
        how = "steps chosen by accuracy" if steps is None else f"{steps} steps over the horizon"
        rows += [
            ("control weight", "; ".join(", ".join(f"{v:g}" for v in row) for row in weight)),
            ("integration", f"{how}, {settings['precision']} precision"),
        ]
        if mapped:
            rows[-1] = ("model", f"a map, once a sample, {settings['precision']} precision")
            rows.append(("sensitivity", settings.get("sensitivity", "exact")))
    if settings:
        rows.append(("sample time", f"{settings['sample_time']:g} {unit}"))
    if data["target"]:
        rows.append(("target", data["target"]))
    at_once = ", at once" if data.get("outside_at_once") else ""
    rows.append(("outside", f"{data['outside']}{at_once}"))
    if limits := data.get("limits"):
        often = f"sampled every {limits['sample_time']:g} {unit}"
        rows.append(("limits", f"kept from {limits['kept_share']:.2%}, {often}"))
    return rows + list(switching or [("least dwell", f"{data['min_dwell']:g} {unit}")])
