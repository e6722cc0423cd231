"""What the choice of an alphabet found: the alphabet, the table, and its file."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capsyn.alphabets.judged import Judged, alphabet_of, columns
from capsyn.errors import ProblemError
from capsyn.execution.files import write_text
from capsyn.modelling.alphabet import Alphabet
from capsyn.modelling.time_unit import check_time_unit
from capsyn.notebook import table
from capsyn.plots.alphabet import alphabet_figure
from capsyn.policies.checks import MOST_ROWS, is_named
from capsyn.validation import whole_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = "capsyn-alphabet"
MOST_BYTES = 1 << 26
"""Most bytes of a file that is read."""


@dataclass(frozen=True, eq=False)
class AlphabetStudy:
    """What `choose_alphabet` returns.

    Parameters
    ----------
    problem : str
        Name of the problem.
    objective : dict of name to float
        Weights of the figures that are summed.
    count : int
        Number of symbols that were asked for: of several numbers that of the least objective.
    alphabet : Alphabet
        The alphabet that was chosen for this number. It may have fewer symbols.
    table : tuple of Judged
        The alphabets that were judged: for each number of symbols the chosen one, and others of the
        same size.
    candidates : Alphabet
        The candidates among which the search chose.
    searched : int
        Number of alphabets whose closed loops the search ran.
    fresh : int
        Number of closed loops that judged each alphabet of the table.
    prices : dict of name to float
        Prices of symbols, which are added to the objective.
    time_unit : str
        Unit of time of the problem.
    """

    problem: str
    objective: Mapping[str, float]
    count: int
    alphabet: Alphabet
    table: tuple[Judged, ...]
    candidates: Alphabet
    searched: int
    fresh: int
    prices: Mapping[str, float] = field(default_factory=dict)
    time_unit: str = "s"

    @property
    def chosen(self) -> tuple[Judged, ...]:
        """The chosen alphabets of the table, one for each number of symbols."""
        return tuple(row for row in self.table if row.kind == "chosen")

    def to_json(self) -> dict[str, Any]:
        """Return the alphabet and everything that was found, as plain data."""
        own = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return {"format": FORMAT} | own | {
            "objective": dict(self.objective),
            "prices": dict(self.prices),
            "alphabet": self.alphabet.to_json(),
            "candidates": self.candidates.to_json(),
            "table": [row.to_json() for row in self.table],
        }  # fmt: skip

    @staticmethod
    def from_json(data: Any) -> AlphabetStudy:
        """Return the study of the `data` of `to_json`; other data raise `ProblemError`."""
        known = {f.name for f in dataclasses.fields(AlphabetStudy)} | {"format"}
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise ProblemError(f"it does not say that it is a {FORMAT}")
        if set(data) != known:
            raise ProblemError("it has other keys")
        fields = {name: value for name, value in data.items() if name != "format"}
        if not isinstance(data["problem"], str) or not data["problem"].isprintable():
            raise ProblemError("its problem has no name")
        for name in ("objective", "prices"):
            if not is_named(data[name]):
                raise ProblemError(f"its `{name}` must be numbers by name")
        for name, least in (("count", 1), ("searched", 0), ("fresh", 0)):
            whole_number(name, data[name], least=least)
        check_time_unit(data["time_unit"])
        rows = data["table"]
        if not isinstance(rows, list) or len(rows) > MOST_ROWS:
            raise ProblemError(f"its table must have at most {MOST_ROWS} rows")
        alphabets = {name: alphabet_of(data[name]) for name in ("alphabet", "candidates")}
        made = tuple(map(Judged.from_json, rows))
        known_inputs = [one.inputs for one in (*alphabets.values(), *(r.alphabet for r in made))]
        if len(set(known_inputs)) > 1:
            raise ProblemError("its alphabets have different inputs")
        return AlphabetStudy(**fields | alphabets | {"table": made})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result of `to_json` to the file `path`, for ``capsyn synth --alphabet``."""
        write_text(path, json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")

    @staticmethod
    def load(path: str | os.PathLike[str]) -> AlphabetStudy:
        """Return the study in the file `path` that `save` wrote.

        Raises
        ------
        ProblemError
            The file cannot be read, or holds something else.
        """
        file = Path(path)
        try:
            if file.exists() and not file.is_file():
                raise ProblemError("it is no file")
            if file.stat().st_size > MOST_BYTES:
                raise ProblemError(f"it has more than {MOST_BYTES:,} bytes")
            data = json.loads(file.read_text(encoding="utf-8"))
            return AlphabetStudy.from_json(data)
        except OSError as error:
            raise ProblemError(f"cannot read the alphabet '{path}': {error.strerror}") from None
        except ProblemError as error:
            reason = str(error)
        except (ValueError, RecursionError):
            reason = "it is no JSON"
        wanted = f"'{path}' must be a study as capsyn alphabet writes it"
        raise ProblemError(f"{wanted}: {reason}") from None

    def summary(self) -> dict[str, Any]:
        """Return what the statistics of a policy say of the study of its alphabet."""
        names = ("problem", "count", "searched", "fresh", "time_unit")
        return {name: getattr(self, name) for name in names} | {
            "objective": dict(self.objective),
            "candidates": len(self.candidates),
            "rows": [row.summary() for row in self.table],
        }

    def plot(self) -> Figure:
        """Return a figure: the objective against the number of symbols, and against bytes."""
        return alphabet_figure(self.table, self.objective, self.problem, self.count)

    def __repr__(self) -> str:
        names = ", ".join(self.alphabet.names)
        return f"AlphabetStudy('{self.problem}': {len(self.alphabet)} symbols, {names})"

    def _repr_html_(self) -> str:
        """Return the table for notebooks."""
        rows = columns(self.summary()["rows"], self.time_unit, self.count)
        names = [", ".join(row.alphabet.names) for row in self.table]
        told = [[*row.values(), text] for row, text in zip(rows, names)]
        return table(repr(self), told, [*rows[0], "names"] if rows else ())
