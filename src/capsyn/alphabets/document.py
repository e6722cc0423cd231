"""A study of alphabets as a document of its own: what was chosen, the table, the picture."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable
from html import escape
from typing import Any

from capsyn.alphabets.judged import chosen_among, columns
from capsyn.alphabets.study import AlphabetStudy
from capsyn.execution.files import write_text
from capsyn.plots.figure import reproducible

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em;
  background: #fff; color: #1c2128; }
table { border-collapse: collapse; margin: 1em 0; font-variant-numeric: tabular-nums; }
th, td { padding: 3px 12px 3px 0; text-align: left; border-bottom: 1px solid #dde2e8; }
th { font-weight: 400; color: #5b6470; }
svg { max-width: 100%; height: auto; }
"""


def save_document(study: AlphabetStudy, path: str | os.PathLike[str]) -> None:
    """Write a study as one HTML file that needs no other; the same study gives the same bytes.

    Parameters
    ----------
    study : AlphabetStudy
        The study.
    path : path
        The file.

    Raises
    ------
    ProblemError
        No file can be written there.
    """
    write_text(path, document(study))


def document(study: AlphabetStudy) -> str:
    """Return a study as HTML; all texts are escaped."""
    title, chosen = escape(f"Alphabet of {study.problem}"), study.alphabet
    units = [
        f"{name} [{unit}]" if unit else name for name, unit in zip(chosen.inputs, chosen.units)
    ]
    symbols = [
        [name, *(f"{v:g}" for v in values), *_price(study, name)]
        for name, values in zip(chosen.names, chosen.values.tolist())
    ]
    head = ["symbol", *units, *(["price"] if study.prices else [])]
    summary = study.summary()
    rows = columns(summary["rows"], study.time_unit, study.count)
    parts = [f"<p>{escape(chosen_among(summary))}</p>", _table(head, symbols)]
    if rows:
        head = [*rows[0], "names"]
        told = (
            [*row.values(), ", ".join(judged.alphabet.names)]
            for row, judged in zip(rows, study.table)
        )
        parts += [_table(head, told), _picture(study)]
    return (
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{title}</title>'
        f"<style>{STYLE}</style>\n<h1>{title}</h1>\n" + "\n".join(parts) + "\n</html>\n"
    )


def _price(study: AlphabetStudy, name: str) -> list[str]:
    return [f"{study.prices.get(name, 0.0):g}"] if study.prices else []


def _table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    def line(tag: str, texts: Iterable[Any]) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(str(text))}</{tag}>' for text in texts)}</tr>"

    return f"<table>{line('th', head)}{''.join(line('td', row) for row in rows)}</table>"


def _picture(study: AlphabetStudy) -> str:
    """Return the picture as SVG without the lines before its root."""
    file = io.StringIO()
    with reproducible():
        study.plot().savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    return text[text.index("<svg") :]
