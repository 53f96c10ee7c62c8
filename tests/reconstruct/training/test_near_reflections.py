"""A training that casts its reflected rays and learns how far its lamps are: every part takes part, and nothing is not finite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from datasets.core.console import progress
from datasets.scene import Scene
from reconstruct import models
from reconstruct.config import Config
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.training.step import Step

SMALL = {
    "encoding": {"levels": 2, "log2_size": 8, "coarsest": 2.0, "finest": 16.0},
    "field": {"spatial_width": 8, "view_width": 8, "ide_degree": 2, "density_bias": 3.0, "roughness_bias": -5.0},
    "sampler": {"rays": 64, "samples": 512, "grid": 16, "steps": 32, "max_per_ray": 8},
    "surface": {"rays": 16, "samples": 8},
    "light": {"cast": 4, "cast_from": 0.4, "parallax": 4.0, "parallax_learned": True},
}


@pytest.mark.slow
def test_a_training_that_casts_stays_finite_and_learns_the_radius(ball_scene: tuple[Scene, object]) -> None:
    config = Config.model_validate(models.merged(models.load_config().model_dump(), SMALL))
    scene = ball_scene[0]
    normalisation, views = Normalisation.of(scene), scene.split("train")
    with progress("reading", len(views)) as shown:
        pixels = Pixels.load(views, normalisation, 1.0, shown)
    step = Step.of(config, SceneFacts(normalisation))
    state = start = step.initial(jax.random.key(0), None, len(views))
    arguments = lambda i: (pixels, jnp.asarray(0), jnp.asarray(i / 10, jnp.float32), jnp.asarray(i == 5))  # noqa: E731
    options = {"xla_backend_optimization_level": 0}
    one = jax.jit(step).lower(state, *arguments(0)).compile(compiler_options=options)
    shares, losses = [], []
    for i in range(10):
        state, terms = one(state, *arguments(i))
        assert state.model.casting is not None
        shares.append(float(state.model.casting.cast_share))
        losses.append({name: float(value) for name, value in terms.items()})
    assert int(state.skipped) == 0 and all(np.isfinite(list(line.values())).all() for line in losses)
    np.testing.assert_allclose(shares, np.clip((np.arange(10) / 10 - 0.4) / 0.1, 0, 1), atol=1e-5)
    assert losses[0]["normal_consistency"] == 0 < losses[5]["normal_consistency"]
    before, after = (s.model.field.appearance.parallax for s in (start, state))
    assert before is not None and after is not None and float(before.logit) != float(after.logit)
