"""Every notebook runs from top to bottom, shows what its text promises, and is kept stripped."""

import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
PROMISES = {
    "tour": [
        "at most 41,842 solves, taken 4,314",
        "equal to the law at 99.59%",
        "<= 0 proved on 99.498% of the volume",
        "1000 of 1000 trials succeed",
        "exact     799 nodes: equal to the policy in every cell (proved)",
    ],
    "own-system": ["no hints\n170 switches", "\n15 switches", " of 1000 trials succeed, 99."],
    "scots-to-c": [
        "1415 of 1681 cells",
        "127 nodes",
        "all in the safe set",
        "2500 states, 0 wrong",
    ],
}
PICTURES = {"tour": 4, "own-system": 2, "scots-to-c": 2}


def outputs(path, folder):
    """Run a notebook in a folder; return what it prints, and the kinds of data that it shows."""
    nbclient = pytest.importorskip("nbclient")
    import nbformat

    book = nbformat.read(path, as_version=4)
    nbformat.validate(book)
    place = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(book, timeout=120, kernel_name="python3", resources=place).execute()
    found = [output for cell in book.cells for output in cell.get("outputs", [])]
    streams = [output for output in found if output.output_type == "stream"]
    assert not [stream.text for stream in streams if stream.name == "stderr"]
    shown = [output.data for output in found if output.output_type != "stream"]
    return "".join(stream.text for stream in streams), shown


def test_every_notebook_promises_something():
    assert {path.stem for path in NOTEBOOKS} == set(PROMISES) == set(PICTURES)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path, tmp_path):
    printed, shown = outputs(path, tmp_path)
    for words in PROMISES[path.stem]:
        assert words in printed, printed
    assert sum("image/png" in data for data in shown) == PICTURES[path.stem]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_kept_stripped(path):
    stripped = runpy.run_path(str(FOLDER / "strip.py"))["stripped"]
    text = path.read_text()
    assert stripped(text) == text
    assert stripped(text.replace('"outputs": []', '"outputs": [{}]')) == text
