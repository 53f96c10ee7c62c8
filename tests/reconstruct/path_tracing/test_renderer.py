"""Mitsuba against what is known: colours in even light, the place of textures, mirrored charts, and the light's directions."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.mitsuba_variant import SURE
from koala3d.reconstruct.asset import sphere
from koala3d.reconstruct.asset.light import Light
from koala3d.reconstruct.asset.writing import environment
from koala3d.reconstruct.path_tracing import trial
from koala3d.reconstruct.path_tracing.reading import StoredAsset

pytest.importorskip("mitsuba", reason="Mitsuba is absent: pip install 'koala-capture[sim]'")
CAMERA = Camera(24, 24, 48.0, 48.0, 12.0, 12.0)
EVEN = np.ones((8, 16, 3))


def tile(**changes: Any) -> StoredAsset:
    """A square in the plane z = 0 that faces +z, white metal, u to the right and v downwards."""
    corners = np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    even = np.ones((8, 8, 1), np.float32)
    facing = np.repeat(np.array([0.5, 0.5, 1.0], np.float32) * even, 1, -1)
    return StoredAsset(
        vertices=corners,
        normals=np.broadcast_to([0.0, 0, 1], (4, 3)),
        uv=np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]),
        faces=np.array([[0, 2, 1], [0, 3, 2]]),
        base_colour=np.repeat(even, 3, -1),
        metallic=even,
        roughness=0.2 * even,
        normal=facing,
        specular=None,
        base_from_asset=np.eye(4),
        **changes,
    )


def picture(
    asset: StoredAsset, light: Any, *, from_: tuple[float, ...] = (0.0, 0.0, 3.0), paths: int = 16, turn: float = 0.0
) -> np.ndarray:
    from koala3d.reconstruct.path_tracing.renderer import Renderer

    place = pose.look_at(np.array(from_), np.zeros(3), up=np.array([0.0, 1, 0]))
    renderer = Renderer(asset, light, using=SURE)
    renderer.turn_light(turn)
    return renderer.picture(CAMERA, place, paths=paths, seed=0)


def test_a_metal_in_even_light_has_its_base_colour_where_the_texture_says() -> None:
    colours = np.full((8, 8, 3), 0.2, np.float32)
    colours[:4, :4] = [0.8, 0.5, 0.1]  # upper left
    found = picture(replace(tile(), base_colour=colours), EVEN)
    assert np.allclose(found[..., 3], 1)
    mean = lambda rows, columns: found[rows, columns, :3].mean((0, 1))  # noqa: E731
    first, last = slice(4, 8), slice(16, 20)
    assert np.allclose(mean(first, first), [0.8, 0.5, 0.1], rtol=0.05)  # rough metal loses a little light between facets
    assert np.allclose([mean(first, last), mean(last, first), mean(last, last)], 0.2, rtol=0.05)


def test_what_is_matte_scatters_its_base_colour_and_mirrors_as_glass_unless_a_factor_forbids_it() -> None:
    matte = replace(tile(), metallic=np.zeros((8, 8, 1), np.float32), base_colour=np.zeros((8, 8, 3), np.float32))
    assert np.allclose(picture(matte, EVEN, paths=256)[8:16, 8:16, :3].mean(), 0.04, rtol=0.1)
    dull = replace(matte, specular=np.zeros((8, 8, 1), np.float32))
    assert picture(dull, EVEN, paths=64)[8:16, 8:16, :3].max() < 0.01


def test_normals_of_a_mirrored_chart_mean_the_same() -> None:
    """The same tile, its texture laid out upside down and the green of its normals with it."""
    lamps = np.full((32, 64, 3), 0.1)
    lamps[8:12] = 5.0  # a ring above
    tilted = tile().normal * 1
    tilted[..., 1], tilted[..., 2] = 0.5 + 0.5 * np.sin(0.35), 0.5 + 0.5 * np.cos(0.35)  # towards the texture's top, y
    flipped = np.stack([tilted[..., 0], 1 - tilted[..., 1], tilted[..., 2]], -1)
    down = tile().uv * [1, -1] + [0, 1]
    # glTF's bitangent is w * normal x tangent with w = -1 there, so that green again means towards the texture's top, now -y.
    upright = picture(replace(tile(), normal=tilted), lamps, paths=64)
    mirrored = picture(replace(tile(), normal=flipped, uv=down), lamps, paths=64)
    plain = picture(tile(), lamps, paths=64)
    assert np.abs(upright - plain)[8:16, 8:16].max() > 0.1  # the tilt matters
    assert np.abs(upright - mirrored)[8:16, 8:16].mean() < 0.03  # noise of 64 paths


@pytest.mark.parametrize("turn", [0.0, -1.2])
def test_a_metal_ball_shows_a_lamp_where_it_mirrors_it(tmp_path: Path, turn: float) -> None:
    lamp = np.array([0.48, 0.6, 0.64])  # in the asset's frame: right of, above and behind the camera
    world = np.array([lamp[0], -lamp[2], lamp[1]])  # z up
    nodes = sphere.nodes()
    light = Light(0.02 + np.exp(400 * (nodes @ world - 1))[:, None] * np.ones(3), np.ones(len(nodes)))
    frame = pose.rigid(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))
    environment.save(light, frame, tmp_path / "light.exr", height=64)
    ball = replace(trial.ball(), roughness=np.full((4, 4, 1), 0.2, np.float32))
    found = picture(ball, tmp_path / "light.exr", from_=(0, 0, 5), turn=turn)
    lamp = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]) @ lamp
    bright = np.clip(found[..., 0] - 0.3 * found[..., 0].max(), 0, None)
    rows, columns = np.indices(bright.shape) + 0.5
    x, y = (float((values * bright).sum() / bright.sum()) - 12 for values in (columns, rows))
    half = lamp + np.array([0.0, 0, 1])
    half /= np.linalg.norm(half)  # the normal that mirrors the lamp to a camera far away
    expected = 48 * half[:2] / (5 - half[2])  # on a ball of radius 1, five away
    assert np.allclose([x, -y], expected, atol=1.2)  # a pixel and what perspective adds


def test_the_trial_passes() -> None:
    assert trial.main(SURE) == 0
