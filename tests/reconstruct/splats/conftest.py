"""Splats of made-up shapes and colours, whose every number is different."""

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.reconstruct.splats.splats import Splats


@pytest.fixture
def splats() -> Splats:
    """Forty splats, thin and wide, turned all ways, with colours that no sign or order leaves as they are."""
    random = np.random.default_rng(0)
    quaternions = pose.quaternion(pose.from_quaternion(random.normal(size=(40, 4))))
    coefficients = random.uniform(-0.4, 0.4, (40, 16, 3)).astype(np.float32)
    scales = np.exp(random.uniform(-8, -5, (40, 3)))
    points = np.array([0.4, -0.2, 0.1]) + random.uniform(-0.1, 0.1, (40, 3))
    about = {"run": "run", "scene": "ball", "steps": 3, "seen": 1.0, "surroundings": "none"}
    return Splats("ball", points, quaternions, scales, random.uniform(0.9, 0.99, 40), coefficients, True, about)
