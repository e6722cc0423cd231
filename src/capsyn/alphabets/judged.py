"""What fresh closed loops and syntheses say of an alphabet: a row of the table of a study."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from capsyn.errors import ProblemError
from capsyn.modelling.alphabet import Alphabet
from capsyn.policies.checks import BOUNDS, KINDS, SIZES, checked_row
from capsyn.validation import plain

WIDTH, BETWEEN = 80, 3
"""Of a brief table, and what a column takes besides its texts [characters]."""


@dataclass(frozen=True, eq=False)
class Judged:
    """An alphabet, and what closed loops from starts that the search did not see say of it.

    Parameters
    ----------
    count : int
        Number of symbols that were asked for; the alphabet may have fewer.
    kind : "chosen", "own", "uniform" or "random"
        Where the alphabet comes from: the search, the user, levels that are evenly spread, or
        random candidates.
    alphabet : Alphabet
        The alphabet.
    objective, low, high : float
        Mean of the objective over the loops, with the prices of the symbols, and its interval of
        95 %. All are infinite if loops are lost.
    success, success_low, success_high : float, optional
        Share of the loops that succeed (see `capsyn.monte_carlo`), and its interval of 95 %; None
        without a target.
    figures : dict of name to float
        Means over the loops that are not lost. Those of ``switches`` are per time unit.
    cells, solves, nodes, bytes : int, optional
        Of the policy of the alphabet: its leaves, its solves, the nodes of its exact tree, and the
        bytes of the tables of its export to C. None where there is no policy, or no tree.
    lost : int
        Number of loops that are lost: that leave the domain where this is an error, or become not
        finite.
    tried : int
        Number of alphabets of this kind of which this one is the best.
    """

    count: int
    kind: str
    alphabet: Alphabet
    objective: float
    low: float
    high: float
    success: float | None = None
    success_low: float | None = None
    success_high: float | None = None
    figures: Mapping[str, float] = field(default_factory=dict)
    cells: int | None = None
    solves: int | None = None
    nodes: int | None = None
    bytes: int | None = None
    lost: int = 0
    tried: int = 1

    def to_json(self) -> dict[str, Any]:
        """Return the row as plain data; None stands for what is infinite."""
        bounds = {name: _finite(getattr(self, name)) for name in BOUNDS}
        own = {"alphabet": self.alphabet.to_json(), "figures": dict(self.figures)}
        return plain(self) | bounds | own

    @staticmethod
    def from_json(data: Any) -> Judged:
        """Return the row of the `data` of `to_json`; other data raise `ProblemError`."""
        known = {one.name for one in dataclasses.fields(Judged)}
        if not isinstance(data, dict) or set(data) != known:
            raise ProblemError("a row of the table has other keys")
        checked_row(data)
        fields = data | {name: math.inf for name in BOUNDS if data[name] is None}
        return Judged(**fields | {"alphabet": alphabet_of(data["alphabet"])})

    def summary(self) -> dict[str, Any]:
        """Return the row with the number of its symbols in their place, as plain data."""
        data = self.to_json()
        return data | {"alphabet": len(self.alphabet)}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def alphabet_of(data: Any) -> Alphabet:
    """Return the alphabet of the `data` of its ``to_json``; other data raise `ProblemError`."""
    if not isinstance(data, dict) or set(data) != {f.name for f in dataclasses.fields(Alphabet)}:
        raise ProblemError("an alphabet has other keys")
    return Alphabet(**data)


def weighed(objective: Mapping[str, float]) -> str:
    """Return weights of figures by name as a sum in words."""
    terms = (name if weight == 1 else f"{weight:g} {name}" for name, weight in objective.items())
    return " + ".join(terms)


def chosen_among(study: Mapping[str, Any]) -> str:
    """Return how an alphabet was chosen, in words, of the summary of its study."""
    return (
        f"chosen for {study['problem']} from {study['candidates']:,} candidates: the least "
        f"{weighed(study['objective'])} of {study['searched']:,} alphabets; judged on "
        f"{study['fresh']:,} fresh closed loops"
    )


def columns(
    rows: Sequence[Mapping[str, Any]], time_unit: str = "s", best: int | None = None
) -> list[dict[str, str]]:
    """Return a table of rows, each as `Judged.summary` returns it, as texts by column.

    The chosen alphabet of the count `best` has a mark. Columns of which no row says anything are
    left out.
    """
    found = [_texts(row, time_unit, best) for row in rows]
    names = list(dict.fromkeys(name for row in found for name in row))
    names = [name for name in names if any(row.get(name) for row in found)]
    return [{name: row.get(name, "") for name in names} for row in found]


def brief(
    rows: Sequence[Mapping[str, Any]], objective: Mapping[str, float], time_unit: str, best: int
) -> list[dict[str, str]]:
    """Return a table of rows as `columns` does, of what decides and fits a terminal's width.

    Of the figures it has those that are summed in an objective of several. A column that no longer
    fits is left out; those that say how good an alphabet is come before the sizes.
    """
    weighed = [_label(name, time_unit) for name in objective] if len(objective) > 1 else []
    found = []
    for row, texts in zip(rows, columns(rows, time_unit, best)):
        interval = texts.get("95 % interval", "").replace(" to ", " .. ")
        found.append(
            {
                "symbols": texts["symbols"],
                "kind": row["kind"] + (" *" if texts.get("best") else ""),
                "objective (95 %)": texts["objective"] + (f" ({interval})" if interval else ""),
            }
            | {name: texts.get(name, "") for name in ("success", "lost", *weighed, *SIZES)}
        )
    left, names = WIDTH - 1, list[str]()
    for name in found[0] if found else ():
        wide = max(len(name), *(len(row[name]) for row in found)) + BETWEEN
        if any(row[name] for row in found) and wide <= left:
            names.append(name)
            left -= wide
    return [{name: row[name] for name in names} for row in found]


def _label(name: str, time_unit: str) -> str:
    return f"{name} / {time_unit}" if name == "switches" else name


def _texts(row: Mapping[str, Any], time_unit: str, best: int | None) -> dict[str, str]:
    tried = row["tried"]
    texts = {
        "kind": f"best of {tried} {row['kind']}" if tried > 1 else row["kind"],
        "symbols": str(row["alphabet"]),
        "best": "*" if (row["kind"], row["count"]) == (KINDS[0], best) else "",
        "objective": "infinite" if row["objective"] is None else f"{row['objective']:.4g}",
        "95 % interval": _range(row["low"], row["high"]),
        "success": "" if row["success"] is None else f"{row['success']:.1%}",
    }
    for name, value in row["figures"].items():
        texts[_label(name, time_unit)] = f"{value:.4g}"
    sizes = {name: "" if row[name] is None else f"{row[name]:,}" for name in SIZES}
    return texts | sizes | {"lost": f"{row['lost']:,}" if row["lost"] else ""}


def _range(low: float | None, high: float | None) -> str:
    return "" if low is None or high is None else f"{low:.4g} to {high:.4g}"
