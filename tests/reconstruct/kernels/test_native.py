"""When compiled kernels run, and that everything runs without them."""

import io
import os
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from typing import Any

import jax
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings.grid import HashedGrid
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.kernels import native
from tests import drawn

pytestmark = pytest.mark.usefixtures("kernels_run")

PROGRAM = """
import hashlib, jax, numpy as np
from koala3d.reconstruct.kernels import native
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
print(native.why_not())
rng = np.random.default_rng(0)
table, points = (np.float32(rng.uniform(size=size)) for size in ((2, 8 * 4096), (3, 8192)))
scales = tuple(np.geomspace(2, 64, 8).tolist())
grid = PermutohedralLattice(jax.device_put(table), jax.device_put(np.float32(0)), scales, 12)
def run(grid, points):
    value, back = jax.vjp(lambda g: g(points), grid)
    return value, back(value)[0].table
found = map(np.asarray, jax.jit(run)(grid, points))
print(hashlib.sha256(b"".join(one.tobytes() for one in found)).hexdigest())
"""


def output_apart(*prefix: str, **environment: str) -> list[str]:
    """What it prints in a process of its own."""
    command = [*prefix, sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=True)
    return done.stdout.split("\n")


def output_here() -> list[str]:
    """What it prints in this process."""
    with redirect_stdout(io.StringIO()) as out:
        exec(PROGRAM, {})
    return out.getvalue().split("\n")


@pytest.mark.skipif(shutil.which("taskset") is None, reason="no taskset")
def test_one_core_and_all_cores_give_the_same_bits() -> None:
    assert output_apart("taskset", "-c", "0") == output_here()


def test_reasons_not_to(monkeypatch: pytest.MonkeyPatch) -> None:
    assert output_apart(XLA_FLAGS="--xla_force_host_platform_device_count=2")[0] == "there are 2 devices"
    monkeypatch.setenv("KOALA_KERNELS", "off")
    assert output_here()[0] == "KOALA_KERNELS=off"


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
    grid = drawn.filled(
        lambda: PermutohedralLattice.create(jax.random.key(0), levels=2, features=2, log2_size=8, coarsest=2.0, finest=9.0)
    )
    found, expected = (jax.jit(call)(grid, drawn.uniform(3, 50)) for call in (type(grid).__call__, HashedGrid.__call__))
    np.testing.assert_array_equal(found, expected)


def test_structures_of_other_sizes_are_refused(forgotten: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from koala3d.reconstruct.kernels.loops import frame

    monkeypatch.setitem(frame.BUFFER, "size", 56)
    reason = native.why_not()
    assert reason is not None
    assert "structures" in reason


def test_double_precision_is_for_jax() -> None:
    with jax.enable_x64(True):
        assert not native.usable(drawn.array([0.0], np.float64))
        assert native.usable(drawn.array([0.0]))


WITH_HELPERS = """
import hashlib, sys
import jax, jax.numpy as jnp, numpy as np
from koala3d.reconstruct.kernels import native
native.HELPERS = int(sys.argv[1])
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
assert native.why_not() is None
grid = PermutohedralLattice.create(jax.random.key(0), levels=8, features=2, log2_size=14, coarsest=6.0, finest=256.0)
points = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (3, 8192)), jnp.float32)
loss = lambda table: jnp.sum(jnp.square(type(grid)(table, grid.blur, grid.resolutions, grid.log2_size)(points)))
gradient = jax.jit(jax.grad(loss))
found = {np.asarray(gradient(grid.table)).tobytes() for _ in range(20)}
print(len(found), hashlib.sha256(next(iter(found))).hexdigest())
"""


@pytest.mark.slow
def test_however_many_threads_help_the_result_is_the_same() -> None:
    """None, and more than there are processors: each compiles all kernels."""
    done = [
        subprocess.run([sys.executable, "-c", WITH_HELPERS, str(helpers)], capture_output=True, text=True) for helpers in (0, 5)
    ]
    assert not any(one.returncode for one in done), done[0].stderr + done[1].stderr
    assert done[0].stdout == done[1].stdout and done[0].stdout.startswith("1 ")
