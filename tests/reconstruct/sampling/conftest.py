"""Rays that the tests of sampling share."""

import functools
from collections.abc import Callable

import jax
import numpy as np
import pytest

from koala3d.reconstruct.sampling.steps import Steps
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BALL, BOX
from tests import drawn


def _some_rays(count: int, seed: int = 0, distance: float = 3.0) -> Rays:
    """From all around towards points near the origin; every eighth looks away, and one lies along an axis."""
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins *= distance / np.linalg.norm(origins, axis=-1, keepdims=True)
    directions = (rng.uniform(-0.8, 0.8, (count, 3)) - origins) * rng.uniform(0.3, 0.6, (count, 1))
    directions[::8] *= -1
    origins[1], directions[1] = [0.1, -distance, 0.2], [0, 1.0, 0]
    return Rays(*map(drawn.array, (origins, directions, np.full(count, 1e-3))))


@functools.partial(jax.jit, static_argnums=(1, 2))
def _steps_of(rays: Rays, bounded: bool, steps: int = 64) -> Steps:
    return Steps.of(rays, steps=steps, space=BOX if bounded else BALL, near=0.05, far=100.0)


@pytest.fixture
def some_rays() -> Callable[..., Rays]:
    return _some_rays


@pytest.fixture
def steps_of() -> Callable[..., Steps]:
    return _steps_of


def _some_depths(count: int, steps: int) -> np.ndarray:
    """(count, steps) Optical depths with everything: fog, a thin film before a wall, one step alone, nothing."""
    rng = np.random.default_rng(3)
    depth = rng.choice([0, 0.01, 0.3, 1.0], (count, steps), p=[0.7, 0.2, 0.07, 0.03])
    depth[0], depth[1], depth[2] = 0, 0.02, 0
    depth[2, steps // 2] = 0.5
    depth[3], depth[3, steps // 8], depth[3, steps // 3 :] = 0, 0.1, 1
    return depth.astype(np.float32)


@pytest.fixture
def some_depths() -> Callable[[int, int], np.ndarray]:
    return _some_depths
