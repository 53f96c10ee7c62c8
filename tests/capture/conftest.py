"""Shared by the tests of capture."""

from pathlib import Path

import pytest


@pytest.fixture
def configs() -> Path:
    """Folder of the shipped configuration files."""
    return Path(__file__).parents[2] / "configs"
