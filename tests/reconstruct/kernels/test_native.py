"""When compiled kernels run, and that everything runs without them."""

import os
import shutil
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.field.encodings.grid import HashedGrid
from reconstruct.field.encodings.lattice import PermutohedralLattice
from reconstruct.kernels import native

pytestmark = pytest.mark.usefixtures("kernels_run")

PROGRAM = """
import hashlib, jax, numpy as np, jax.numpy as jnp
from reconstruct.kernels import native
from reconstruct.field.encodings.lattice import PermutohedralLattice
print(native.why_not())
grid = PermutohedralLattice.create(jax.random.key(1), levels=8, features=2, log2_size=12, coarsest=2.0, finest=64.0)
points = jax.random.uniform(jax.random.key(0), (3, 8192))
value, back = jax.vjp(lambda g: g(points), grid)
found = [np.asarray(value), np.asarray(back(value)[0].table)]
print(hashlib.sha256(b"".join(one.tobytes() for one in found)).hexdigest())
"""


def output_of(environment: dict[str, str] | None = None, *prefix: str) -> list[str]:
    command = [*prefix, sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, env={**os.environ, **(environment or {})}, capture_output=True, text=True, check=True)
    return done.stdout.split("\n")


@pytest.mark.skipif(shutil.which("taskset") is None, reason="no taskset")
def test_one_core_and_all_cores_give_the_same_bits() -> None:
    assert output_of({}, "taskset", "-c", "0") == output_of()


@pytest.mark.parametrize(
    ("environment", "reason"),
    [
        ({"KOALA_KERNELS": "off"}, "KOALA_KERNELS=off"),
        ({"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}, "there are 2 devices"),
    ],
)
def test_reasons_not_to(environment: dict[str, str], reason: str) -> None:
    assert output_of(environment)[0] == reason


@pytest.fixture
def forgotten() -> Any:
    """As if the kernels had not been looked for yet, before and after."""
    native._failure.cache_clear()
    yield
    native._failure.cache_clear()


@pytest.mark.parametrize("error", [ImportError("No module named 'numba'"), RuntimeError("no such target\nmore")])
def test_without_a_compiler_jax_does_it(error: Exception, forgotten: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> dict[str, Any]:
        raise error

    monkeypatch.setattr(native, "_compiled", broken)
    reason = native.why_not()
    assert reason is not None
    assert str(error).splitlines()[0] in reason
    assert "\n" not in reason
    grid = PermutohedralLattice.create(jax.random.key(1), levels=2, features=2, log2_size=8, coarsest=2.0, finest=9.0)
    points = jax.random.uniform(jax.random.key(0), (3, 50))
    np.testing.assert_array_equal(grid(points), HashedGrid.__call__(grid, points))


def test_structures_of_other_sizes_are_refused(forgotten: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from reconstruct.kernels.loops import frame

    monkeypatch.setitem(frame.BUFFER, "size", 56)
    reason = native.why_not()
    assert reason is not None
    assert "structures" in reason


def test_double_precision_is_for_jax() -> None:
    with jax.enable_x64(True):
        assert not native.usable(jnp.zeros(3, jnp.float64))
        assert native.usable(jnp.zeros(3, jnp.float32))
