"""Blurred light against sums over directions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.reconstruct.rendered.light import MATTE, Light


def _directions(count: int = 40_000) -> np.ndarray:
    """(n, 3) directions that cover the sphere evenly."""
    index = np.arange(count) + 0.5
    z, angle = 1 - 2 * index / count, index * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], -1)


@pytest.mark.parametrize("blur", [MATTE, 25.0, 400.0])
def test_light_through_a_lobe_is_its_mean_under_the_lobe(blur: float) -> None:
    light = Light.studio(7)
    around, towards = _directions(), Rotation.random(12, random_state=0).apply([0, 0, 1.0])
    sharp = np.asarray(light.convolved(around.T.astype(np.float32), 1e9)).T
    for direction in towards:
        weight = np.exp(blur * (around @ direction - 1))
        mean = (weight[:, None] * sharp).sum(0) / weight.sum()
        found = np.asarray(light.convolved(direction[:, None].astype(np.float32), blur))[:, 0]
        # lobes multiply to lobes only nearly: what the closed form misses is a few percent of the light
        np.testing.assert_allclose(found, mean, atol=0.05, rtol=0.05)


def test_the_same_seed_is_the_same_light() -> None:
    assert (Light.studio(3).colour == Light.studio(3).colour).all()
    assert not (Light.studio(3).colour == Light.studio(4).colour).all()
