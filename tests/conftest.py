"""Fixtures that tests of all parts share."""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "real: reads the real recordings (../shared/data)")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The directory of real recordings beside the repository; tests that need it are skipped without it."""
    path = Path(__file__).parents[2] / "shared" / "data"
    if not path.is_dir():
        pytest.skip("the real recordings (../shared/data) are not here")
    return path
