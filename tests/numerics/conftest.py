"""Tests of numerics compile without optimisation."""

import pytest

from tests.unoptimised import unoptimised as unoptimised


@pytest.fixture(autouse=True, scope="module")
def quickly_compiled(unoptimised: None) -> None:
    """For all of them."""
