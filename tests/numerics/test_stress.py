"""Short trainings on random scenes with random settings: none diverges, none leaves a parameter that is not finite.

A group shares one configuration, so that it is compiled once; its trainings differ in scene, scale, seed and pictures.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct import models
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.faults import FAULTS, cause
from koala3d.reconstruct.training.step import Step, TrainState
from tests.small import SIZES

PIXELS, VIEWS, CHUNKS, STEPS = 1500, 5, 4, 6
SMALL = models.merged(
    SIZES,
    {
        "encoding": {"finest": 32.0},
        "field": {"spatial_width": 8, "view_width": 8, "ide_degree": 3, "view_depth": 2, "view_skip": 0},
        "sampler": {"samples": 768, "grid": 16},
    },
)
PICTURES: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "noise": lambda rng: rng.random((PIXELS, 4)),
    "black": lambda rng: np.tile([0.0, 0, 0, 1], (PIXELS, 1)),
    "white": lambda rng: np.ones((PIXELS, 4)),
    "saturated": lambda rng: np.concatenate([rng.integers(0, 2, (PIXELS, 3)), np.ones((PIXELS, 1))], 1),
    "constant": lambda rng: np.tile(rng.random(4), (PIXELS, 1)),
    "transparent": lambda rng: np.concatenate([rng.random((PIXELS, 3)), np.zeros((PIXELS, 1))], 1),
    "brighter than white": lambda rng: np.concatenate([rng.exponential(3, (PIXELS, 3)), np.ones((PIXELS, 1))], 1),
    "half masked": lambda rng: np.concatenate([rng.random((PIXELS, 3)), rng.integers(0, 2, (PIXELS, 1))], 1),
}


def scene_of(rng: np.random.Generator, pictures: str) -> Pixels:
    """Random cameras around a random point, one of them alone or all in one place now and then."""
    views = int(rng.choice([1, 2, VIEWS]))
    origins = rng.normal(size=(VIEWS, 3))
    origins *= rng.choice([1.2, 2.5, 6.0]) / np.linalg.norm(origins, axis=-1, keepdims=True)
    origins[views:] = origins[0]  # views that repeat the first
    view = rng.integers(0, VIEWS, PIXELS)
    directions = rng.uniform(-1, 1, (PIXELS, 3)) * rng.choice([0.1, 1.0, 3.0]) - origins[view]
    directions /= rng.choice([1.0, 30.0])  # t counts in other units then
    single = lambda values: jnp.asarray(values, jnp.float32)  # noqa: E731
    return Pixels(
        jnp.asarray(PICTURES[pictures](rng), jnp.float16),
        single(directions),
        jnp.asarray(view, jnp.int32),
        single(origins),
        single(10.0 ** rng.uniform(-6, -1, VIEWS)),
    )


def settings_of(rng: np.random.Generator, model: str, preset: str) -> tuple[Config, Normalisation]:
    """A model made small, hyperparameters up to ten times too small or large, planes of depth up to twelve decades apart."""

    def varied(value: float) -> float:
        return float(value * 10 ** rng.uniform(-1, 1))

    config = models.load_config(model, preset)
    changes: dict[str, Any] = {
        "train": {"rate": varied(0.01), "final_rate": varied(0.001), "first_blur": float(rng.choice([0, 0.02, 0.3]))},
        "losses": {
            "width": varied(0.01),
            "orientation": varied(0.1),
            "predicted_normals": varied(0.03),
            "density_normals": varied(0.03),
            "last_density_normals": varied(0.3),
            "fog": varied(0.01),
            "distortion": varied(0.01),
            "hollowness": varied(0.1),
            "decay": varied(0.1),
        },
        "surface": {
            "density": varied(0.1),
            "normal": varied(3.0),
            "bias": varied(0.01),
            "variation": varied(1e-3),
            "density_form": str(rng.choice(["tangent", "published"])),
            "reach": varied(3.0),
        },
        "field": {"density_bias": float(rng.uniform(-4, 6)), "outward": float(rng.choice([0, 1]))},
    }
    config = Config.model_validate(models.merged(models.merged(config.model_dump(), SMALL), changes))
    near, far = ((1e-6, 1e6), (0.05, 20.0), (1e-3, 1e3))[int(rng.integers(3))]
    return config, Normalisation((0.0, 0.0, 0.0), 1.0, bool(rng.integers(2)), near, far)


class Group:
    """Compiled steps of one configuration."""

    def __init__(self, config: Config, normalisation: Normalisation) -> None:
        self.step = Step.of(config, SceneFacts(normalisation))
        pixels = scene_of(np.random.default_rng(0), "noise")
        state = self.step.initial(jax.random.key(0), None, VIEWS)
        self.advance = self.step.compiled(state, pixels, xla_backend_optimization_level=0)
        self.keep_up = self.step.compiled_upkeep(state, xla_backend_optimization_level=0)

    def arguments(self, seed: int, progress: float) -> tuple[jax.Array, ...]:
        counts = (jnp.asarray(seed, jnp.int32), jnp.asarray(progress, jnp.float32), jnp.asarray(STEPS, jnp.int32))
        return *counts, jnp.asarray(True), jnp.asarray(True)

    def train(self, pixels: Pixels, seed: int) -> tuple[TrainState, list[dict[str, float]]]:
        """A short training with a second pass and an upkeep per chunk, and the terms of each chunk."""
        state, found = self.step.initial(jax.random.key(seed), None, VIEWS), []
        for chunk in range(CHUNKS):
            state, terms = self.advance(state, pixels, *self.arguments(seed, (chunk + 0.5) / CHUNKS))
            assert not int(terms[FAULTS]), cause(int(terms[FAULTS]), state.model.split()[0], terms)
            found.append({name: float(value) for name, value in terms.items()})
            state = self.keep_up(state, jnp.asarray(seed, jnp.int32))
        return state, found


def stress(group: Group, rng: np.random.Generator, pictures: str) -> None:
    """One training, judged."""
    pixels, seed = scene_of(rng, pictures), int(rng.integers(1000))
    state, found = group.train(pixels, seed)
    assert int(state.skipped) == 0
    assert all(np.isfinite(value) for terms in found for value in terms.values())
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((state.model.split()[0], state.optimiser)))
    first, last = found[0]["mse"], found[-1]["mse"]
    assert last <= 2 * first + 0.1, "the error grows"  # of at most 1536 random pixel values: its noise is a tenth at most


FAST = [
    pytest.param("surfnerf", "fast", id="surfnerf-fast"),
    pytest.param("surfnerf", "paper", id="surfnerf-paper", marks=pytest.mark.slow),
]
EVERY = [(model, preset) for model in models.names() if model != "finetune" for preset in models.PRESETS]


@pytest.mark.timeout(900)
@pytest.mark.parametrize(("model", "preset"), FAST)
def test_short_trainings_stay_finite(model: str, preset: str) -> None:
    rng = np.random.default_rng(7)
    group = Group(*settings_of(rng, model, preset))
    for pictures in list(PICTURES)[:4]:
        stress(group, rng, pictures)
    pixels = scene_of(rng, "half masked")
    for one, other in zip(*(jax.tree.leaves(group.train(pixels, 3)[0]) for _ in range(2)), strict=True):
        np.testing.assert_array_equal(one, other, err_msg="the same seed gives the same bits")


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("number", range(20))
def test_two_hundred_short_trainings_stay_finite(number: int) -> None:
    """Ten trainings in each of twenty groups."""
    rng = np.random.default_rng(1000 + number)
    group = Group(*settings_of(rng, *EVERY[number % len(EVERY)]))
    for index in range(10):
        stress(group, rng, list(PICTURES)[index % len(PICTURES)])
