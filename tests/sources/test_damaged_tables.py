"""Damaged files of tables: refused in one line, or read as another table; never anything else.

``CAPSYN_DAMAGED=100000 pytest tests/sources/test_damaged_tables.py`` tries so many of each format.
"""

import io
import json
import os
import warnings
import zipfile

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.sources.grid_files import read_table
from support.tables import (
    csv_text,
    damaged,
    damaged_text,
    dtcontrol_text,
    long_csv,
    npz_bytes,
    prism_texts,
    random_table,
    scots_text,
    storm_text,
    stratego,
    whole_table,
)

COUNT = int(os.environ.get("CAPSYN_DAMAGED", "150"))
WHOLE = whole_table((5, 4), seed=4)
TABLE = random_table((5, 4), seed=4)
ARRAYS = {
    "first": TABLE.first, "step": TABLE.step, "symbols": TABLE.symbols, "alphabet": [0.0, 1.0, 2.0]
}  # fmt: skip

STRATEGO = json.dumps(stratego(depth=2), indent=1).encode()
_DISCRETE = stratego(depth=0) | {"pointvars": []}
STRATEGO_TABLE = json.dumps(_DISCRETE).encode()


def damaged_inside(data, count):
    """Yield archives that are whole, with one array in each that is damaged."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    for k, name in enumerate(parts):
        for bad in damaged(parts[name], -(-count // len(parts)), seed=k):
            made = io.BytesIO()
            with zipfile.ZipFile(made, "w") as archive:
                for other, part in parts.items():
                    archive.writestr(other, bad if other == name else part)
            yield made.getvalue()


@pytest.mark.parametrize(
    "name, data, damage",
    [
        ("t.npz", npz_bytes(**ARRAYS), damaged),
        ("t.npz", npz_bytes(np.savez_compressed, **ARRAYS), damaged),
        ("t.npz", npz_bytes(**ARRAYS), damaged_inside),
        ("t.csv", csv_text(TABLE, ["a [m]", "b"]).encode(), damaged_text),
        ("t.scs", scots_text(TABLE, [-0.3, 2.0], [0.1, 0.25]).encode(), damaged_text),
        ("t.txt", long_csv(TABLE, ["a (m)", "b"], ";", True).encode("utf-16"), damaged_text),
        ("t.csv", dtcontrol_text(TABLE).encode(), damaged_text),
        ("t.json", storm_text(WHOLE).encode(), damaged_text),
        ("t.json", storm_text(WHOLE, "origin").encode(), damaged_text),
        ("t.txt", prism_texts(WHOLE, numbered=False)[0].encode(), damaged_text),
        ("t.tra", prism_texts(WHOLE, induced=True)[0].encode(), damaged_text),
        ("t.sta", prism_texts(WHOLE)[1].encode(), damaged_text),
        ("t.json", STRATEGO, damaged_text),
        ("t.json", STRATEGO_TABLE, damaged_text),
    ],
    ids=(
        "stored deflated arrays csv scots utf16 dtcontrol storm origins prism induced states "
        "stratego discrete"
    ).split(),
)
def test_only_the_readers_error_comes_out(name, data, damage, tmp_path):
    path = file = tmp_path / name
    if name in ("t.tra", "t.sta"):
        (tmp_path / "t.sta").write_text(prism_texts(WHOLE)[1])
    if name == "t.sta":
        path = tmp_path / "t.prism"
        path.write_text(prism_texts(WHOLE)[0])
    file.write_bytes(data)
    read_table(path).policy()
    refused = 0
    for k, bad in enumerate(damage(data, COUNT)):
        file.write_bytes(bad)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                table = read_table(path)
            if k % 30 == 0:
                table.policy()
        except ProblemError as error:
            told = str(error)
            assert told.startswith(f"'{tmp_path}") and "\n" not in told
            assert len(told) < 2 * len(str(path)) + 400
            refused += 1
    print(f"{name}: {COUNT:,} damaged files, {refused:,} refused")
    assert refused > COUNT // 10
