"""Pictures through a lens, against what the lens shows of a known scene."""

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.reconstruct.path_tracing import lens


def shown(directions: np.ndarray) -> np.ndarray:
    """A smooth scene far away."""
    x, y = directions[..., 0], directions[..., 1]
    return np.stack([np.sin(5 * x), np.cos(4 * y), x * y], -1).astype(np.float32)


def test_a_centred_pinhole_takes_its_own_picture() -> None:
    camera = Camera(20, 16, 30.0, 30.0, 10.0, 8.0)
    picture = shown(camera.directions(camera.pixel_centres()))
    assert lens.pinhole_for(camera) == camera and lens.through(camera, camera, picture) is picture


@pytest.mark.parametrize(
    "camera",
    [
        Camera(48, 40, 60.0, 66.0, 20.5, 21.0),
        Camera(48, 40, 60.0, 60.0, 24.0, 20.0, k1=-0.25, p1=0.01),
        Camera(48, 40, 40.0, 40.0, 23.0, 20.0, k1=0.02, fisheye=True),
    ],
)
def test_a_lens_shows_what_lies_in_its_directions(camera: Camera) -> None:
    pinhole = lens.pinhole_for(camera)
    assert pinhole.is_centred and pinhole != camera
    found = lens.through(camera, pinhole, shown(pinhole.directions(pinhole.pixel_centres())))
    assert (
        np.abs(found - shown(camera.directions(camera.pixel_centres()))).max() < 3e-3
    )  # curvature within a pixel: (5 / 40)^2 / 8
