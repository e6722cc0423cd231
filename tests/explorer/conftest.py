"""A browser for tests of pages."""

import contextlib
import functools

import pytest

from support.explorer.page import Shown, chromium

_opened = contextlib.ExitStack()


@functools.cache
def _browser():
    return _opened.enter_context(chromium())


@pytest.fixture
def browser():
    """One for all modules of this folder: starting it takes longer than most tests."""
    return _browser()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item, nextitem):
    """Close the browser after the last test of this folder, for its event loop is in the way."""
    if nextitem is None or nextitem.path.parent != item.path.parent:
        _opened.close()
        _browser.cache_clear()


@pytest.fixture
def show(browser, tmp_path):
    """Return a function that opens the page of a policy; nothing may go wrong on it."""
    shown = []

    def open_page(policy, **options):
        shown.append(Shown(browser, policy, tmp_path, **options))
        return shown[-1]

    yield open_page
    for one in shown:
        assert one.messages == []
        assert one.requests == [one.file.as_uri()]  # itself, and nothing else
        one.close()
