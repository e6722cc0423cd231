"""Binaries of FMUs for other platforms: their kind, what they export, and what they need."""

import functools
import importlib.util
import struct
import zipfile

import pytest

from capsyn.errors import KernelBuildError, ProblemError
from capsyn.exports.export import export
from capsyn.exports.fmu import build
from support.exports.policies import small

fmpy = pytest.importorskip("fmpy")
lief = pytest.importorskip("lief")
pytest.importorskip("ziglang")

LINKERS = {"__mh_dylib_header", "___dso_handle"}
"""Names that the linker of Macs defines itself."""


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """Return an FMU for all platforms."""
    return export(small(), "fmu", tmp_path_factory.mktemp("all"), platforms="all")[0]


def library(path, platform):
    """Return the library of a platform."""
    with zipfile.ZipFile(path) as archive:
        (name,) = (n for n in archive.namelist() if n.startswith(f"binaries/{platform}/"))
        return archive.read(name)


@functools.cache
def expected(path):
    """Return what the library of this platform exports, which FMPy runs."""
    binary = lief.ELF.parse(list(library(path, "linux64")))
    assert binary.header.machine_type == lief.ELF.ARCH.X86_64
    names = {symbol.name for symbol in binary.exported_symbols}
    assert {"fmi2Instantiate", "fmi2DoStep", "fmi2GetReal", "fmi2GetInteger"} <= names
    assert all(name.startswith("fmi2") for name in names) and len(names) >= 30
    return names


def test_one_archive_for_all_platforms(unit):
    assert fmpy.supported_platforms(str(unit)) == ["c-code", "darwin64", "linux64", "win64"]
    with zipfile.ZipFile(unit) as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        names = archive.namelist()
    stem = unit.stem
    assert names[2:] == [
        f"binaries/linux64/{stem}.so",
        f"binaries/win64/{stem}.dll",
        f"binaries/darwin64/{stem}.dylib",
    ]


def test_windows(unit):
    binary = lief.PE.parse(list(library(unit, "win64")))
    assert binary.header.machine == lief.PE.Header.MACHINE_TYPES.AMD64
    assert binary.optional_header.magic == lief.PE.PE_TYPE.PE32_PLUS
    assert binary.header.has_characteristic(lief.PE.Header.CHARACTERISTICS.DLL)
    assert {entry.name for entry in binary.get_export().entries} == expected(unit)
    assert [needed.name for needed in binary.imports] == ["msvcrt.dll"]


def test_macs(unit):
    data = library(unit, "darwin64")
    both = lief.MachO.parse(list(data))  # owns what it gives
    binaries = [both.at(k) for k in range(both.size)]
    kinds = [binary.header.cpu_type for binary in binaries]
    assert kinds == [lief.MachO.Header.CPU_TYPE.X86_64, lief.MachO.Header.CPU_TYPE.ARM64]
    for binary in binaries:
        assert binary.header.file_type == lief.MachO.Header.FILE_TYPE.DYLIB
        names = {symbol.name for symbol in binary.exported_symbols} - LINKERS
        assert names == {f"_{name}" for name in expected(unit)}
        assert [needed.name for needed in binary.libraries if "System" not in needed.name] == [
            f"{unit.stem}.dylib"
        ]
    assert binaries[1].has_code_signature  # or the processor refuses it
    assert data[:8] == struct.pack(">II", 0xCAFEBABE, 2)


def test_the_same_bytes_and_some_platforms(unit, tmp_path):
    again = export(small(), "fmu", tmp_path, platforms=["win64", "linux64"])[0]
    assert fmpy.supported_platforms(str(again)) == ["c-code", "linux64", "win64"]
    for platform in ("win64", "linux64"):
        data = library(again, platform)
        assert data == library(unit, platform)
        assert str(tmp_path).encode() not in data and b"capsyn-" not in data
    host = export(small(), "fmu", tmp_path / "host")[0]
    assert library(host, "linux64") == library(unit, "linux64")


@pytest.mark.parametrize("wanted", ["win32", "", [], ["linux64", 3], 7, None])
def test_wrong_platforms_are_refused(wanted, tmp_path):
    with pytest.raises(ProblemError, match="`platforms` must be host, all, or one or more of"):
        export(small(), "fmu", tmp_path, platforms=wanted)


def test_platforms_without_binaries_are_refused(tmp_path):
    with pytest.raises(ProblemError, match="`platforms` and `sources_only` exclude each other"):
        export(small(), "fmu", tmp_path, platforms="all", sources_only=True)


def test_without_zig_a_platform_names_the_package(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "ziglang" else find(name)
    )
    with pytest.raises(
        ProblemError, match="`platforms` win64 needs .*pip install .capsyn.compiler"
    ):
        export(small(), "fmu", tmp_path / "a", platforms="all")
    assert not (tmp_path / "a").exists()
    path = export(small(), "fmu", tmp_path, platforms="linux64")[0]  # its own compiler does it
    assert fmpy.supported_platforms(str(path)) == ["c-code", "linux64"]


def test_what_zig_says_of_a_failure_is_passed_on(tmp_path, monkeypatch):
    monkeypatch.setattr(build, "LIBRARY", "LIBRARY msvcrt.dll\nEXPORTS\nfree\n")
    with pytest.raises(KernelBuildError, match="failed on the source of the FMU: .*malloc|calloc"):
        export(small(), "fmu", tmp_path / "out", platforms="win64")
    assert not (tmp_path / "out").exists()
