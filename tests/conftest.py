"""Fixtures of all tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("capsyn", deadline=None)  # the first example may compile a kernel
settings.load_profile("capsyn")


@pytest.fixture(scope="session", autouse=True)
def kernel_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the kernels that tests build out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAPSYN_CACHE_DIR", str(tmp_path_factory.mktemp("kernels")))
        yield
