"""Fixtures of all tests."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

from capsyn.native import build

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # several processes test at once
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in background jobs of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)


settings.register_profile("capsyn", deadline=None)  # the first example may compile a kernel
settings.load_profile("capsyn")


@pytest.fixture(scope="session", autouse=True)
def kernel_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the kernels that tests build out of the user's cache; processes of a run share them.

    What zig builds of C libraries, which takes long, is kept where a user of capsyn has it.
    """
    own = build.trusted_cache()
    directory = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        directory = directory.parent  # that of all workers
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAPSYN_CACHE_DIR", str(directory / "kernels"))
        if own is not None and "ZIG_GLOBAL_CACHE_DIR" not in os.environ:
            patch.setenv("ZIG_GLOBAL_CACHE_DIR", str(own / "zig"))
        yield


@pytest.fixture(scope="module", autouse=True)
def kept(request: pytest.FixtureRequest) -> Iterator[None]:
    """Make exact trees and golden sequences once; no trees where compression itself is tested."""
    from support.exports.kept import kept_induce, kept_run

    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name != "compression":
            patch.setattr("capsyn.compression.trees.induce", kept_induce)
        patch.setattr("capsyn.exports.sequence.run", kept_run)
        yield


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where an export or a page was left out though CAPSYN_ALL_TOOLS is set."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:  # one of several processes; the first one tells
        return
    checked = ("tests/exports", "test_docs")
    left_out = [r.nodeid for r in reporter.stats.get("skipped", [])]
    skipped = [name for name in left_out if any(part in name for part in checked)]
    if skipped and os.environ.get("CAPSYN_ALL_TOOLS"):
        reporter.write_line(f"CAPSYN_ALL_TOOLS is set, but skipped: {', '.join(skipped)}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
