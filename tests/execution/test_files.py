"""Files are written whole or not at all, and refused before the work where they cannot be."""

import os
import stat
import threading

import pytest

from capsyn import Policy
from capsyn.errors import ProblemError
from capsyn.execution.files import atomic_write, check_writable, write_text
from capsyn.policies.file import content_hash
from support.policy_files import (
    assert_equal,
    full,
)


def entries_of(directory):
    return sorted(p.name for p in directory.iterdir())


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt])
@pytest.mark.parametrize("old", [None, b"old"])
def test_a_writer_that_fails_leaves_what_was_there(tmp_path, error, old):
    path = tmp_path / "p.cap"
    if old is not None:
        path.write_bytes(old)

    def write(temporary):
        temporary.write_bytes(b"half")
        assert temporary.parent == path.parent and temporary.suffix == ".cap"
        raise error("stop")

    with pytest.raises(error, match="stop"):
        atomic_write(path, write)
    assert entries_of(tmp_path) == ([] if old is None else ["p.cap"])
    assert old is None or path.read_bytes() == old


@pytest.mark.parametrize(
    "save", [lambda path: full().save(path), lambda path: write_text(path, "x" * 2000)]
)
def test_a_full_disk_is_one_line_and_leaves_what_was_there(tmp_path, monkeypatch, save):
    resource = pytest.importorskip("resource", reason="limits of file sizes are POSIX's")
    (tmp_path / "p.cap").write_bytes(b"old")
    monkeypatch.chdir(tmp_path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(ProblemError, match="^cannot write the output 'p.cap': File too large$"):
            save("p.cap")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert entries_of(tmp_path) == ["p.cap"] and (tmp_path / "p.cap").read_bytes() == b"old"


def test_a_writer_that_removes_its_file_leaves_what_was_there(tmp_path):
    path = tmp_path / "p.cap"
    path.write_bytes(b"old")
    with pytest.raises(FileNotFoundError):
        atomic_write(path, lambda temporary: temporary.unlink())
    assert entries_of(tmp_path) == ["p.cap"] and path.read_bytes() == b"old"


def test_saving_what_is_no_json_leaves_the_old_file(tmp_path):
    file = tmp_path / "p.cap"
    full().save(file)
    before = file.read_bytes()
    with pytest.raises(ValueError, match="not JSON compliant"):
        full(statistics={"share": float("nan")}).save(file)
    assert file.read_bytes() == before and entries_of(tmp_path) == ["p.cap"]


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_new_file_has_the_permissions_of_any_other(tmp_path, mask):
    before = os.umask(mask)
    try:
        full().save(tmp_path / "p.cap")
        (tmp_path / "other").touch()
    finally:
        os.umask(before)
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("p.cap", "other")]
    assert modes[0] == modes[1]


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666, 0o755])
def test_an_old_file_keeps_its_permissions(tmp_path, mode):
    path = tmp_path / "p.cap"
    path.touch()
    path.chmod(mode)

    def write(temporary):
        assert stat.S_IMODE(temporary.stat().st_mode) & ~mode == 0, "open to more than the file"
        temporary.write_bytes(b"new")

    atomic_write(path, write)
    assert stat.S_IMODE(path.stat().st_mode) == mode and path.read_bytes() == b"new"


def test_writing_leaves_the_umask_alone(tmp_path, monkeypatch):
    # it belongs to all threads: between reading it and putting it back others would run without
    monkeypatch.setattr(os, "umask", None)
    full().save(tmp_path / "p.cap")


def test_relative_paths_and_long_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("p.cap", "p" * 251 + ".cap", "no suffix"):
        full().save(name)
        assert_equal(Policy.load(name), full())
    assert len(entries_of(tmp_path)) == 3


def test_a_reader_meets_a_whole_file_while_others_write(tmp_path):
    path = tmp_path / "p.cap"
    hashes = {content_hash(full(name=name)) for name in ("one", "two")}
    full(name="one").save(path)

    def work(name):
        for _ in range(10):
            full(name=name).save(path)

    threads = [threading.Thread(target=work, args=(name,)) for name in ("one", "two")]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        assert content_hash(Policy.load(path)) in hashes
    assert entries_of(tmp_path) == ["p.cap"]


def test_check_writable_touches_nothing(tmp_path):
    path = tmp_path / "p.cap"
    check_writable(path)
    assert entries_of(tmp_path) == []
    path.write_bytes(b"old")
    before = path.stat()
    check_writable(str(path))
    assert path.stat() == before and entries_of(tmp_path) == ["p.cap"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("missing/p.cap", "No such file or directory"),
        ("", "is a directory"),
        ("file/p.cap", "Not a directory"),
    ],
)
def test_check_writable_refuses(tmp_path, name, reason):
    (tmp_path / "file").touch()
    path = tmp_path / name
    with pytest.raises(ProblemError, match=reason) as caught:
        check_writable(path)
    assert str(caught.value).startswith(f"cannot write the output '{path}': ")
    with pytest.raises(ProblemError, match=reason):
        full().save(path)
    assert entries_of(tmp_path) == ["file"]


def test_saving_to_no_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in ("", ".", "..", "/"):
        with pytest.raises(ProblemError, match="is a directory"):
            full().save(path)
        with pytest.raises(ProblemError, match="is a directory"):
            check_writable(path)
    assert entries_of(tmp_path) == []


def test_check_writable_refuses_a_read_only_directory(tmp_path):
    tmp_path.chmod(0o500)
    try:
        if os.access(tmp_path, os.W_OK):
            pytest.skip("this user, as root, may write anywhere")
        with pytest.raises(ProblemError, match="Permission denied"):
            check_writable(tmp_path / "p.cap")
    finally:
        tmp_path.chmod(0o700)
