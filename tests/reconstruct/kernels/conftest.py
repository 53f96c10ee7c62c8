"""Kernels and their twins in plain JAX, side by side."""

import pytest

from reconstruct.kernels import native


@pytest.fixture(autouse=True)
def kernels_run() -> None:
    """These tests are about compiled kernels; elsewhere, on a GPU or without Numba, there is nothing to test."""
    if (reason := native.why_not()) is not None:
        pytest.skip(reason)
