"""Programs of most tests run for milliseconds and take seconds to compile: they are not optimised."""

from collections.abc import Iterator

import jax
import pytest

OPTION = "jax_disable_most_optimizations"


@pytest.fixture(scope="module")
def unoptimised() -> Iterator[None]:
    """What is compiled meanwhile is not optimised."""
    jax.config.update(OPTION, True)
    yield
    jax.config.update(OPTION, False)
