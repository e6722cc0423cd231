"""A browser for tests of pages."""

import pytest

from support.explorer.page import Shown, chromium


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


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
