"""The light as a picture: directions, what is known, the file, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.asset import sphere
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.light import Light
from koala3d.reconstruct.asset.writing import environment
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.scene.light import LightFrame
from tests.foreign import exr

LAMP = np.array([0.6, -0.64, 0.48])
"""Unit direction in the world."""


def lamp() -> Light:
    """Dark but for a lamp, and known only in the upper half."""
    near = np.exp(200 * (sphere.nodes() @ LAMP - 1))
    return Light(0.1 + near[:, None] * np.array([3.0, 2.0, 1.0]), (sphere.nodes()[:, 2] > 0).astype(float))


def towards(row: int, column: int, height: int) -> np.ndarray:
    """Direction of a pixel in the asset's frame as three.js has it: u = atan2(z, x) / 2 pi + 1/2, v = asin(y) / pi + 1/2."""
    around, up = (2 * (column + 0.5) / (2 * height) - 1) * np.pi, (0.5 - (row + 0.5) / height) * np.pi
    return np.array([np.cos(up) * np.cos(around), np.sin(up), np.cos(up) * np.sin(around)])


@pytest.mark.parametrize("stands_on", [None, "-z", "+z", "-x", "+y"])
def test_the_brightest_pixel_looks_at_the_lamp(stands_on: str | None) -> None:
    frame = assets.base_from_asset(np.array([[-1.0, -1, -1], [1, 1, 1]]), stands_on)
    picture = environment.picture(lamp(), frame, 90)
    row, column = np.unravel_index(picture[..., 0].argmax(), picture.shape[:2])
    world = frame[:3, :3] @ towards(int(row), int(column), 90)
    assert world @ LAMP > np.cos(np.deg2rad(4))  # nodes are 4 degrees apart
    assert picture.shape == (90, 180, 4) and picture[..., :3].min() > 0


def test_by_default_the_picture_has_the_worlds_zenith_at_its_top() -> None:
    picture = environment.picture(lamp(), assets.base_from_asset(np.array([[-1.0, -1, -1], [1, 1, 1]])), 64)
    assert (picture[:28, :, 3] > 0.95).all() and (picture[36:, :, 3] < 0.05).all()  # 12 degrees from the horizon: three nodes


def test_even_light_is_an_even_picture() -> None:
    nodes = len(sphere.nodes())
    picture = environment.picture(Light(np.full((nodes, 3), 0.7), np.full(nodes, 0.25)), np.eye(4), 16)
    assert np.allclose(picture, [0.7, 0.7, 0.7, 0.25], atol=1e-6)  # shares of the nodes add up to one


def test_the_file_holds_linear_values_above_one(tmp_path: Path) -> None:
    environment.save(lamp(), np.eye(4), tmp_path / "light.exr", height=32)
    shown = environment.picture(lamp(), np.eye(4), 32)
    stored = exr.read(tmp_path / "light.exr")
    assert list(stored) == ["R", "G", "B", "A"] and np.array_equal(np.stack([*stored.values()], -1), shown)
    assert images.read(tmp_path / "light.exr").max() > 1.5
    with pytest.raises(UsageError, match=r"not written as '\.png'.*\.exr"):
        environment.save(lamp(), np.eye(4), tmp_path / "light.png")


def test_light_of_lamps_that_move_is_refused(painted: TrainedModel) -> None:
    environment.refuse_moving(painted)
    moving = replace(painted, run=replace(painted.run, facts=replace(painted.run.facts, light=LightFrame("turntable"))))
    with pytest.raises(UsageError, match="lamps move about the object"):
        environment.refuse_moving(moving)


def test_the_light_is_the_same_whatever_the_textures(baked: tuple[Asset, Light], painted: TrainedModel) -> None:
    """`reconstruct light` writes the light that `reconstruct asset` divides by."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.08)
    ball.apply_translation([0.4, 0, 0.15])
    again = assets.light_around(painted, ball)
    assert np.array_equal(again.radiance, baked[1].radiance) and np.array_equal(again.known, baked[1].known)
    result, text = environment.summary(again)
    assert 0 <= result["known"] <= 1 and "of all directions are known" in text
