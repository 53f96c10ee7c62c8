"""Instructions find the code that they come from, whatever the compiler made of it."""

from importlib.util import find_spec
from pathlib import Path

import jax
import jax.numpy as jnp

from koala3d.reconstruct.bench.cost.instructions import KERNELS, SAMPLES, STAGES, Part, module_of, part_of, parts_of
from koala3d.reconstruct.bench.cost.profile import durations_us
from koala3d.reconstruct.field.mlp import Mlp


def test_parts_by_calls() -> None:
    inside = [("/a/reconstruct/field/mlp.py", "__call__"), ("/a/reconstruct/field/field.py", "__call__")]
    assert part_of(inside, "jit(f)/jvp()/dot") == Part(SAMPLES, "networks", False)
    second = [*inside, ("/a/reconstruct/training/step.py", "_with_second_pass")]
    assert part_of(second, "jit(f)/transpose(jvp())/dot") == Part("second pass", "networks", True)
    assert part_of([("/a/reconstruct/field/encodings/directional.py", "x")], "") == Part(SAMPLES, "shading", False)
    assert part_of([("/a/reconstruct/field/encodings/tables.py", "combine")], "") == Part(SAMPLES, "encoding", False)
    assert (
        part_of([("/a/optax/transform.py", "update"), ("/a/reconstruct/training/optimiser.py", "descended")], "").kernel
        == "optimiser"
    )
    assert part_of([], "") == Part("copies", "other", False)


def test_stages_and_kernels_name_existing_code() -> None:
    root = Path(str(find_spec("koala3d.reconstruct.config").origin)).parent
    paths = [path for path in root.rglob("*.py") if "bench" not in path.parts]
    code = "\n".join(path.read_text() for path in paths)
    assert not [function for function in STAGES if f"def {function}(" not in code]
    assert not [place for place in KERNELS if place != "optax/" and not any(place in str(path) for path in paths)]


def test_containers_are_left_out() -> None:
    lines = ["  %while.1 = (s32[], /*index=1*/f32[8,8]{1,0}) while(%tuple.1), condition=%c, body=%b",
             "  ROOT %add.2 = f32[8]{0} add(%x, %y)", "  call.3 = f32[8]{0} call(%x), to_apply=%f"]  # fmt: skip
    assert list(parts_of("\n".join(lines))) == ["add.2"]


def test_a_compiled_program_is_told_by_its_code(tmp_path) -> None:
    network = Mlp.create(jax.random.key(0), channels=8, width=32, depth=1, outputs=2)

    def loss(network, x):
        return jax.lax.fori_loop(0, 3, lambda i, total: total + jnp.sum(jnp.square(network(x + i))), 0.0)

    program = jax.jit(jax.grad(lambda n, x: jnp.sum(jnp.square(n(x))))).lower(network, jnp.ones((8, 4096))).compile()
    parts = parts_of(program.as_text())
    assert {part.backward for part in parts.values() if part.kernel == "networks"} == {True, False}
    looped = jax.jit(loss).lower(network, jnp.ones((8, 4096))).compile()
    parts = parts_of(looped.as_text())
    with jax.profiler.trace(str(tmp_path)):
        looped(network, jnp.ones((8, 4096))).block_until_ready()
    spent = {name: value for (program, name), value in durations_us(tmp_path).items() if program == module_of(looped.as_text())}
    own = sum(microseconds for name, microseconds in spent.items() if name in parts)
    assert own > 0
    assert any(parts[name].kernel == "networks" for name in spent if name in parts)
