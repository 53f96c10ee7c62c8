"""Training with networks in mixed precision: the same pictures, finite gradients, the same error after a short training."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.field.cloud import points_on_rays
from koala3d.reconstruct.field.mlp import computed_in
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.rendering.model import render
from koala3d.reconstruct.sampling.samples import RaySamples
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BOX
from koala3d.reconstruct.training.step import TrainState
from tests.small import Trainable, small

STEPS = 80
CHANGES = {"encoding": {"finest": 32.0}, "sampler": {"rays": 256, "samples": 4096}, "train": {"rate": 0.03}}


def trained(precision: str, scene: Scene) -> tuple[TrainState, np.ndarray]:
    """State after a short training, every eighth step with the second pass, and the mean squared error of each quarter [dB]."""
    config = merged_config(small(changes=CHANGES), {"train": {"precision": precision}})
    trainable = Trainable.on(config, scene)
    state, lines = trainable.trained(STEPS, second=lambda i: i % 8 == 7, done=lambda i: 0.1 + i / STEPS)
    return state, -10 * np.log10(np.reshape([line["mse"] for line in lines], (4, -1)).mean(-1))


@pytest.fixture(scope="module")
def both(ball_scene: tuple[Scene, Path]) -> dict[str, tuple[TrainState, np.ndarray]]:
    """The same training in both precisions."""
    return {name: trained(name, ball_scene[0]) for name in ("float32", "bfloat16")}


@pytest.mark.slow
def test_a_short_training_comes_to_the_same_error(both: dict[str, tuple[TrainState, np.ndarray]]) -> None:
    """Same seed, same rays: 0.003 dB apart when this was written; 0.1 dB is what rounding may cost. No step was not finite."""
    (full, expected), (mixed, found) = both["float32"], both["bfloat16"]
    assert expected[-1] > expected[0] + 0.3, "it learns"
    np.testing.assert_allclose(found, expected, atol=0.1)
    assert int(full.skipped) == int(mixed.skipped) == 0
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves((mixed.model.split()[0], mixed.optimiser))]
    assert all(np.isfinite(leaf).all() for leaf in leaves) and all(leaf.dtype in (np.float32, np.int32) for leaf in leaves)
    assert any(not np.array_equal(a, b) for a, b in zip(jax.tree.leaves(full.model), jax.tree.leaves(mixed.model), strict=True))


@pytest.mark.slow
def test_colours_are_those_of_single_precision(both: dict[str, tuple[TrainState, np.ndarray]]) -> None:
    """The same parameters and rays in both.

    Two networks of two products in sequence each round their factors to 2^-8 of values of order one: 4 x 2 x 2^-8 = 0.03
    before the sigmoid (slope 1/4) and sRGB (slope up to 3 for colours that are not dark), hence 0.025. The relative error of
    densities is as large, that of weights smaller. On average roundings have both signs.
    """
    field, rng = both["float32"][0].model.field, np.random.default_rng(0)
    origins = rng.normal(size=(200, 3))
    origins *= 2.5 / np.linalg.norm(origins, axis=-1, keepdims=True)
    aims = rng.uniform(-0.4, 0.4, (200, 3))
    rays = Rays(*(jnp.asarray(values, jnp.float32) for values in (origins, aims - origins, np.full(200, 0.01))))
    samples = RaySamples.from_edges(jnp.broadcast_to(jnp.linspace(0.5, 1.5, 65), (200, 65)))
    cloud = points_on_rays(rays, samples.ray, samples.t, space=BOX)
    shown = {name: render(computed_in(name, field), rays, samples, cloud)[0] for name in both}
    assert np.asarray(shown["float32"].opacity).max() > 0.4, "something is seen"
    apart = np.abs(np.asarray(shown["bfloat16"].over(jnp.ones(3)) - shown["float32"].over(jnp.ones(3))))
    assert 0 < apart.mean() < 0.0025 and apart.max() < 0.025
