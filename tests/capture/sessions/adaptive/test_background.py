"""Synthetic pictures of a body on a table: what is cut out is the body, and never much less."""

import numpy as np
import pytest

from koala3d.capture.sessions.adaptive.background import outlines, table_height
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera

CAMERA = Camera(160, 120, 150.0, 150.0, 80.0, 60.0, k1=-0.1)
LOW, HIGH = np.array([0.32, -0.06, 0.0]), np.array([0.44, 0.06, 0.12])
MIDDLE = np.array([0.38, 0.0])


def texture(x: np.ndarray, y: np.ndarray, waves: np.ndarray) -> np.ndarray:
    """(..., 3) smooth colours of a plane [m]."""
    phase = x[..., None] * waves[:, 0] + y[..., None] * waves[:, 1] + waves[:, 2]
    colours = np.sin(phase).reshape(*x.shape, 3, -1).mean(-1)
    return (0.5 + 0.4 * colours).astype(np.float32)


def render(base_from_camera: np.ndarray, rng: np.random.Generator, mirror: bool) -> tuple[np.ndarray, np.ndarray]:
    """A picture of a block on a table, and (height, width) where it shows the block."""
    ways = CAMERA.directions(CAMERA.pixel_centres()) @ base_from_camera[:3, :3].T
    eye = base_from_camera[:3, 3]
    near, far = np.sort(np.stack([(LOW - eye) / ways, (HIGH - eye) / ways]), axis=0)
    entry, leave = near.max(-1), far.min(-1)
    block = (entry < leave) & (entry > 0)
    waves = np.random.default_rng(3).uniform([-90, -90, 0], [90, 90, 6], (18, 3))
    along = np.where(ways[..., 2] < -1e-3, -eye[2] / np.minimum(ways[..., 2], -1e-3), 0)
    at = eye + along[..., None] * ways
    table = texture(at[..., 0], at[..., 1], waves)
    table = np.where((ways[..., 2] < -1e-3)[..., None], table, np.float32([0.5, 0.2, 0.5]))
    hit = eye + np.where(block, entry, 0)[..., None] * ways
    own = texture(hit[..., 0] + hit[..., 2], hit[..., 1] - hit[..., 2], waves[::-1])
    if mirror:
        own = texture(ways[..., 0], ways[..., 1], waves / 10)
    picture = np.where(block[..., None], own, table)
    return np.clip(picture + rng.normal(0, 0.01, picture.shape), 0, 1).astype(np.float32), block


def around() -> list[np.ndarray]:
    """Twelve base_from_camera around the block, each higher than the last."""
    eyes = [(0.38 + 0.35 * np.cos(2.4 * k), 0.35 * np.sin(2.4 * k), 0.15 + 0.02 * k) for k in range(12)]
    return [pose.look_at(eye, (0.38, 0, 0.04), (0, 0, 1)) for eye in eyes]


@pytest.mark.parametrize(
    ("mirror", "error_m"),
    [
        (False, 0.0),
        pytest.param(False, 0.006, marks=pytest.mark.slow),
        pytest.param(True, 0.0, marks=pytest.mark.slow),
        (True, 0.006),
    ],
)
def test_pictures_from_all_sides_agree_about_the_table_alone(mirror, error_m):
    rng, cameras = np.random.default_rng(0), around()
    rendered = [render(one, rng, mirror) for one in cameras]
    given = [one for one, _ in rendered], [CAMERA] * 12, np.stack(cameras), MIDDLE
    height = table_height(*given, error_m)
    assert abs(height) < 1e-6
    found = outlines(*given, height)
    blocks, cut = np.stack([block for _, block in rendered]), np.stack([one.foreground.inside for one in found])
    assert (blocks & ~cut).sum() / blocks.sum() < 0.03
    near = np.stack([np.linalg.norm(CAMERA.pixel_centres() - 0.5 * np.array([160, 120]), axis=-1) < 50] * 12)
    assert (cut & ~blocks & near).sum() / (~blocks & near).sum() < 0.35  # rims of patches, and what three pictures do not show


def test_the_height_of_a_table_with_little_contrast_is_found():
    """Where nearly all agrees at any height, how much pictures differ still says it."""
    rng, cameras = np.random.default_rng(0), around()
    pictures = [0.1 + 0.1 * render(one, rng, True)[0] for one in cameras]
    assert abs(table_height(pictures, [CAMERA] * 12, np.stack(cameras), MIDDLE, 0.006)) < 1e-6


def test_one_picture_agrees_with_nobody():
    picture, _ = render(pose.look_at((0.7, 0, 0.3), (0.38, 0, 0.04), (0, 0, 1)), np.random.default_rng(0), False)
    only = pose.look_at((0.7, 0, 0.3), (0.38, 0, 0.04), (0, 0, 1))
    (found,) = outlines([picture], [CAMERA], only[None], MIDDLE, 0.0)
    assert found.foreground.inside.all() and found.silent.inside.all()
