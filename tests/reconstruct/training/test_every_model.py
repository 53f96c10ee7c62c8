"""Every model trains for a hundred small steps, and loses what it lost when stored_losses.json was written.

After a change that is meant to alter them: python -m tests.reconstruct.training.test_every_model --update [CASE...]
"""

import json
import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.formats import load_scene
from koala3d.reconstruct import models
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.faults import FAULTS
from koala3d.reconstruct.training.step import TrainState
from tests.reconstruct import glossy_ball
from tests.small import Trainable, small

STORED = Path(__file__).parent / "stored_losses.json"
STEPS, BLOCK, SECOND = 100, 10, 5
"""Steps; steps whose mean is stored; every how many steps there is a second pass."""
RTOL = {0: 5e-3, 9: 0.05}
"""Of the first and of the last ten steps. One machine repeats them bit for bit. Another one, and `KOALA_KERNELS=off`, sums in
another order: 1e-7 of a value, of which Adam makes a step wherever a gradient is tiny, and which a hundred steps enlarge. Terms
that choose among neighbours differ most: 0.35 % of the Lambertian bias in the first ten. A wrong loss is further away."""
ATOL = {0: 1e-7, 9: 5e-5}
"""Of terms that are next to nothing, such as the distortion of few weights; and in the end, of orientation, to which
a few samples contribute whose normals look away: 23 % of its 1e-4 between two kinds of processor, all others within 3 %."""
CHANGES = {
    "field": {"view_depth": 3},
    "train": {"rate": 0.003, "final_rate": 0.001, "per_image": "colour"},
    "schedule": {"warmup": 0.02},
}
DEFAULT = "surfnerf, fast"
"""The case of the default model, on the glossy ball."""
CASES = [
    DEFAULT,
    *(f"{name}, {'paper' if name in ('surfnerf', 'mipnerf', 'zip_refnerf', 'refnerf') else 'fast'}" for name in models.names()),
]
"""Models and presets. The paper presets together have every kind of frustum."""
ALWAYS = (DEFAULT, "mipnerf, paper")
"""Between them they use both samplers and the regularisers; the others run with `make test-all`."""
FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 1.5, 4.5), towards=(0.0, 0.0, 0.3))


def shaded_ball() -> Pixels:
    """Four views of a ball of radius 0.6, bright where it faces up, 24 by 24 pixels each."""
    angle = np.pi * np.arange(4) / 2
    origins = 3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle + 0.3], -1) / np.hypot(1, 0.3)
    side = (np.arange(24) + 0.5) / 24 * 2 - 1
    across, up = (grid.reshape(-1, 1) for grid in np.meshgrid(side, side))
    directions, colours = [], []
    for origin in origins:
        forward = -origin / np.linalg.norm(origin)
        right = np.cross(forward, [0, 0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1.0]))
        rays = forward + 0.35 * (across * right + up * np.cross(right, forward))
        a, b, c = (rays**2).sum(-1), rays @ origin, origin @ origin - 0.36
        hit = b * b > a * c
        normal = (origin + ((-b - np.sqrt(np.where(hit, b * b - a * c, 0))) / a)[:, None] * rays) / 0.6
        light = np.stack([0.5 + 0.4 * normal[:, 2], 0.3 + 0.2 * normal[:, 0], 0.4 + 0 * b, np.ones_like(b)], -1)
        directions.append(rays)
        colours.append(np.where(hit[:, None], np.clip(light, 0, 1), 0))
    single = lambda values: jnp.asarray(values, jnp.float32)  # noqa: E731
    view = jnp.repeat(jnp.arange(4, dtype=jnp.int32), 24 * 24)
    colour = jnp.asarray(np.concatenate(colours), jnp.float16)
    return Pixels(colour, single(np.concatenate(directions)), view, single(origins), jnp.full(4, 0.01))


def trained(case: str, root: Path) -> tuple[TrainState, TrainState, dict[str, list[float]]]:
    """State before and after, and the means of each term over ten steps, without a second pass in most of them."""
    if case == DEFAULT:
        folder = glossy_ball.save(root)
        trainable = Trainable.prepared(
            load_scene(folder), folder, models.load_config(overrides=glossy_ball.SETTINGS), root / "run"
        )
    else:
        trainable = Trainable.of(small(*case.split(", "), CHANGES), FACTS, shaded_ball())
    state, lines = trainable.trained(STEPS, second=lambda index: index % SECOND == SECOND - 1, done=lambda index: index / STEPS)
    assert not any(line.pop(FAULTS) for line in lines)
    table = {name: np.array([line[name] for line in lines]).reshape(-1, BLOCK).mean(-1).tolist() for name in lines[0]}
    return trainable.start, state, table


def stored(table: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    return {name: {str(block): values[block] for block in RTOL} for name, values in table.items()}


@pytest.mark.parametrize("case", [case if case in ALWAYS else pytest.param(case, marks=pytest.mark.slow) for case in CASES])
def test_every_model_loses_what_it_lost(case: str, tmp_path: Path) -> None:
    before, after, table = trained(case, tmp_path)
    assert int(after.step) == STEPS and int(after.skipped) == 0
    old, new = before.model.split()[0], after.model.split()[0]
    pairs = zip(jax.tree.leaves_with_path(old), jax.tree.leaves(new), strict=True)
    still = [jax.tree_util.keystr(path) for (path, a), b in pairs if np.array_equal(a, b)]
    assert not still, "every parameter takes part"
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(new))
    assert "normal_consistency" not in table or table["normal_consistency"][-1] > 0, "surfaces are found"
    expected = json.loads(STORED.read_text())[case]
    assert table.keys() == expected.keys()
    for name, values in table.items():
        for block, rtol in RTOL.items():
            known = expected[name][str(block)]
            np.testing.assert_allclose(
                values[block], known, rtol=rtol, atol=ATOL[block], err_msg=f"{name}, steps {BLOCK * block} on"
            )


if __name__ == "__main__" and sys.argv[1:2] == ["--update"]:
    losses = json.loads(STORED.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        losses |= {case: stored(trained(case, Path(folder) / case)[2]) for case in sys.argv[2:] or CASES}
    STORED.write_text(json.dumps(losses, indent=1) + "\n", encoding="utf-8")
