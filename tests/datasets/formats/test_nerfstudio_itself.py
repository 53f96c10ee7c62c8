"""Exports as nerfstudio's own data parser reads them. KOALA_NERFSTUDIO names a Python that has it, see docs/datasets.md."""

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.formats import save_scene
from koala3d.datasets.scene import Scene
from tests.conftest import LENS, PINHOLE

READS = Path(__file__).parent / "nerfstudio_reads.py"
PIXELS = np.array([[5, 3], [20, 12], [17, 11]])  # column, row
FISHEYE = Camera(96, 72, 60.0, 61.0, 50.3, 34.1, k1=0.02, k2=-0.01, fisheye=True)


@pytest.fixture
def parsed() -> Callable[[Path, int], dict[str, Any]]:
    """What nerfstudio makes of a folder at a downscale factor, by split."""
    python = os.environ.get("KOALA_NERFSTUDIO")
    if not python:
        pytest.skip("KOALA_NERFSTUDIO is not set: name the Python of an environment with nerfstudio")

    def read(folder: Path, factor: int) -> dict[str, Any]:
        done = subprocess.run([python, READS, folder, str(factor)], capture_output=True, text=True, timeout=280, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(done.stdout.splitlines()[-1])

    return read


def expected_rays(scene: Scene, name: str, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Origin, and unit directions through `PIXELS`, of a view at 1/`factor` of its size."""
    view = next(view for view in scene.views if view.name == name)
    camera = view.camera.scaled(view.camera.width // factor, view.camera.height // factor)
    rays = camera.directions(PIXELS + 0.5) @ view.world_from_camera[:3, :3].T
    return view.world_from_camera[:3, 3], rays / np.linalg.norm(rays, axis=1, keepdims=True)


@pytest.mark.parametrize("camera", [PINHOLE, LENS, FISHEYE], ids=["pinhole", "lens", "fisheye"])
def test_nerfstudio_reads_an_export(
    camera: Camera, make_scene: Callable[..., Scene], parsed: Callable[[Path, int], dict[str, Any]], tmp_path: Path
) -> None:
    """Splits, sizes, masks, rays and points, at full size and at a quarter of it."""
    scene, random = make_scene(camera, mask=True), np.random.default_rng(0)
    colours = random.integers(0, 256, (7, 3), np.uint8)
    scene = replace(scene, points=random.normal(size=(7, 3)), colours=colours)
    if camera.fisheye:  # as many cameras as views: intrinsics stand in the frames, the lens model must not
        views = (replace(view, camera=replace(camera, fx=camera.fx + 0.1 * k)) for k, view in enumerate(scene.views))
        scene = scene.with_views(tuple(views))
    save_scene(scene, tmp_path / "out", "nerfstudio", sizes=(4,))
    for factor in (1, 4):
        found = parsed(tmp_path / "out", factor)
        size = [72 // factor, 96 // factor]
        for split, names in (("train", ["001", "002", "003", "005", "006", "007"]), ("val", ["000", "004", "008"])):
            part = found[split]
            assert part["names"] == [f"{name}.png" for name in names]
            assert all(shape == size for shape in part["sizes"] + part["cameras"])
            assert len(part["masks"]) == len(names) and all(mask[0] == size for mask in part["masks"])
            share = np.pi * 20**2 / (72 * 96)  # a disc of 20 pixels' radius; at a quarter its edge is uncertain by half a pixel
            np.testing.assert_allclose([mask[1] for mask in part["masks"]], share, rtol=0.01 * factor**2)
            origin, directions = expected_rays(scene, names[0], factor)
            np.testing.assert_allclose(part["origins"], np.tile(origin, (3, 1)), atol=1e-5)  # single precision
            np.testing.assert_allclose(part["directions"], directions, atol=1e-4)
            np.testing.assert_allclose(part["points"], scene.points, atol=1e-5)
            assert np.array_equal(part["colours"], scene.colours)
        assert found["test"]["names"] == found["val"]["names"]


def test_sizes_that_a_factor_does_not_divide(
    make_scene: Callable[..., Scene], parsed: Callable[[Path, int], dict[str, Any]], tmp_path: Path
) -> None:
    scene = make_scene(Camera(99, 75, 90.0, 90.0, 49.0, 37.0), mask=True)
    save_scene(scene, tmp_path / "out", "nerfstudio", sizes=(4,))
    part = parsed(tmp_path / "out", 4)["val"]
    assert all(shape == [18, 24] for shape in part["sizes"] + part["cameras"] + [mask[0] for mask in part["masks"]])
