import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging.undistort import NEAREST, SMOOTH, pinhole

LENS = Camera(192, 144, 180.0, 182.0, 100.6, 68.2, k1=-0.12, k2=0.05, p1=1e-3, p2=-8e-4)


@given(st.floats(-0.2, 0.2), st.floats(-2e-3, 2e-3), st.floats(-15, 15), st.floats(-15, 15), st.floats(0.98, 1.02))
def test_every_pixel_was_seen_and_hardly_any_is_lost(k1: float, p1: float, dx: float, dy: float, aspect: float) -> None:
    source = Camera(192, 144, 180.0, 180.0 * aspect, 96 + dx, 72 + dy, k1=k1, p1=p1)
    found = pinhole(source)
    assert found.camera.is_centred
    pixels = found.source_pixels(found.camera.pixel_centres())
    assert pixels.min() >= 0.5 and (pixels <= [191.5, 143.5]).all()
    one_more = Camera(
        found.camera.width + 6,
        found.camera.height + 6,
        found.camera.fx,
        found.camera.fy,
        found.camera.width / 2 + 3,
        found.camera.height / 2 + 3,
    )
    wider = source.project(one_more.directions(one_more.pixel_centres()) @ found.source_from_camera[:3, :3].T)
    assert wider.min() < 0.5 or (wider > [191.5, 143.5]).any()  # it could not have been larger
    assert found.camera.width > 0.8 * 192


def test_a_centred_pinhole_is_itself() -> None:
    camera = Camera(64, 48, 50, 50, 32, 24)
    assert pinhole(camera).camera == camera and np.array_equal(pinhole(camera).source_from_camera, np.eye(4))


def test_resampled_picture_shows_the_same_world(far_wall) -> None:
    """Against the exact picture of the new camera. The wall is smooth over 20 pixels, so that positions are what limits it."""
    found = pinhole(LENS)
    world_from_camera = pose.from_rotation_vector((0.3, -0.2, 0.5))
    picture = far_wall(LENS, world_from_camera).astype(np.float32)
    exact = far_wall(found.camera, world_from_camera @ found.source_from_camera)
    error = np.abs(found.resample(picture) - exact)
    assert (
        error.max() < 1.5e-3
    )  # OpenCV rounds positions to a 64th of a pixel on each axis, and its Lanczos sums to one within a thousandth
    assert found.turned_deg > 1


def test_noise_survives() -> None:
    """The spline keeps what a linear interpolation blurs: noise keeps at least 85% of its standard deviation."""
    noise = np.random.default_rng(0).normal(0.5, 0.05, (144, 192, 1)).astype(np.float32)
    found = pinhole(LENS)
    assert found.resample(noise).std() > 0.85 * 0.05
    assert found.resample(noise, SMOOTH).std() < 0.8 * 0.05  # what the spline is there for


def test_colour_does_not_bleed_out_of_nothing() -> None:
    """Straight alpha: what lies under alpha 0 has no say in the result."""
    picture = np.zeros((144, 192, 4), np.float32)
    picture[:, :96] = [0.2, 0.4, 0.6, 1.0]
    picture[:, 96:] = [1.0, 0.0, 1.0, 0.0]
    result = pinhole(LENS).resample(picture)
    solid = result[..., 3] > 0.2
    assert 0.3 < solid.mean() < 0.7
    assert np.abs(result[solid][:, :3] - [0.2, 0.4, 0.6]).max() < 1e-3


def test_nearest_keeps_values_and_depth_follows_the_rotation() -> None:
    found = pinhole(LENS)
    labels = np.random.default_rng(0).integers(0, 9, (144, 192, 1)).astype(np.float32)
    assert set(np.unique(found.resample(labels, NEAREST))) <= set(range(9))
    plane = found.source_from_camera[:3, :3]
    point = 2.0 * (found.camera.directions([10.5, 20.5]) @ plane.T)  # any point on the ray of pixel (10, 20)
    assert found.depth_factor()[20, 10, 0] * point[2] == pytest.approx(2.0, rel=1e-6)


def test_a_hopeless_lens_is_refused() -> None:
    with pytest.raises(ValueError, match="no image"):
        pinhole(Camera(192, 144, 30.0, 30.0, 96, 900.0, k1=-2.0))
