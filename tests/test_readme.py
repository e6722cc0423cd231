"""The README's example does what the README says."""

import re
from pathlib import Path

import pytest

import capsyn

ROOT = Path(__file__).parents[1]


def test_the_example_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    said = re.search(r"print\(.*#\s*(.*):", code).group(1)
    assert capsys.readouterr().out.strip() == said
    assert capsyn.Policy.load(tmp_path / "boat.cap").name == "boat"


def test_links_and_pictures_exist():
    for document in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        for link in re.findall(r"\]\((?!https?:)([^)#]+)\)", document.read_text()):
            assert (document.parent / link).exists(), f"{document.name}: {link}"


def test_the_code_of_the_guide_to_exports_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "exports.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names = {}
    exec(compile(code, "exports.md", "exec"), names)
    assert {path.name for path in names["files"]} >= {"cart_pendulum.c", "golden.csv"}
    assert (tmp_path / "build" / "structured-text" / "cart_pendulum.st").exists()


def test_the_code_of_the_guide_to_evidence_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "evidence.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names = {}
    for code in blocks:
        exec(compile(code, "evidence.md", "exec"), names)
    assert len(blocks) == 3 and (tmp_path / "run.csv").exists()
    assert names["result"].success_rate == 1.0 and names["action"].decrease > 0


def test_the_code_of_the_guide_to_sources_runs(capsys):
    pytest.importorskip("gymnasium")
    pytest.importorskip("control")
    text = (ROOT / "docs" / "sources.md").read_text()
    names = {}
    for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(code, "sources.md", "exec"), names)
    assert "0 False" in capsys.readouterr().out
    assert names["run"].outputs.shape == (2, 101) and len(names["found"].returns) == 5
