"""Damaged files of tables: refused in one line, or read as another table; never anything else."""

import io
import warnings
import zipfile

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.sources.grid_files import read_table
from support.tables import csv_text, damaged, npz_bytes, random_table, scots_text

TABLE = random_table((5, 4), seed=4)
ARRAYS = {
    "first": TABLE.first, "step": TABLE.step, "symbols": TABLE.symbols, "alphabet": [0.0, 1.0, 2.0]
}  # fmt: skip


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
        ("t.csv", csv_text(TABLE, ["a [m]", "b"]).encode(), damaged),
        ("t.scs", scots_text(TABLE, [-0.3, 2.0], [0.1, 0.25]).encode(), damaged),
    ],
    ids=["stored", "deflated", "arrays", "csv", "scots"],
)
def test_only_the_readers_error_comes_out(name, data, damage, tmp_path):
    path = tmp_path / name
    path.write_bytes(data)
    read_table(path).policy()
    refused = 0
    for bad in damage(data, 300):
        path.write_bytes(bad)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                read_table(path)
        except ProblemError as error:
            assert str(error).startswith(f"'{path}'") and "\n" not in str(error)
            assert len(str(error)) < len(str(path)) + 400
            refused += 1
    assert refused > 150
