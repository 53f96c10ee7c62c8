"""Splats in Spark, a viewer that knows nothing of Koala: places, sizes, turns and colours are those that were meant."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.pose import directions
from koala3d.reconstruct.splats import harmonics
from koala3d.reconstruct.splats.splats import Splats
from koala3d.reconstruct.splats.writing import saving
from tests.browser import Chromium
from tests.browser import chromium as chromium

ROOT = Path(__file__).parents[3]
NODE = ROOT / "build" / "tools" / "node_modules"
CAMERA = Camera(96, 96, 120.0, 120.0, 48.0, 48.0)
FAR = 0.5  # of the camera from the splat [m]
COLOUR = 0.03
"""The viewer keeps colours and harmonics in bytes, of which it has fewer for higher degrees."""
PIXELS = 0.3
"""Moments of a picture that was reduced to half its size."""


def splat(splats: Splats, scales: list[float]) -> Splats:
    """The first of the splats alone, with other sizes."""
    one = {name: value[:1] for name, value in vars(splats).items() if isinstance(value, np.ndarray)}
    return replace(splats, **{**one, "scales": np.array([scales])})


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_a_splat_is_where_and_what_it_was_meant_to_be(
    splats: Splats, tmp_path: Path, chromium: Chromium, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    if not (NODE / "@sparkjsdev" / "spark").is_dir():
        pytest.skip("the viewer of splats is absent: make tools")
    monkeypatch.syspath_prepend(ROOT / "docs")
    import show_asset
    import show_splats

    one, wide = splat(splats, [0.04, 0.012, 0.004]), splat(splats, [0.1, 0.1, 0.1])
    centre, turn = one.points[0], pose.from_quaternion(one.quaternions)[0, :3, :3]
    covariance = turn @ np.diag(one.scales[0] ** 2) @ turn.T
    cameras = [pose.look_at(centre - FAR * towards, centre + np.array([0.02, 0.01, 0.0])) for towards in directions(6)]

    def pictures(shown: Splats) -> list[np.ndarray]:
        path = tmp_path / f"{shown.scales[0, 2]}{suffix}"
        saving.writer(path)(shown, path)
        with chromium.resumed() as browser, show_splats.viewer(browser, path, NODE) as page:
            return [show_asset.by_three(page, CAMERA, camera) for camera in cameras]

    for towards, picture, camera in zip(directions(6), pictures(wide), cameras, strict=True):
        column, row = np.floor(CAMERA.project((pose.inverse(camera) @ [*centre, 1])[:3])).astype(int)
        alpha = one.opacities[0]
        expected = alpha * harmonics.colour(one.coefficients, towards[None])[0] + 1 - alpha
        assert np.abs(picture[row, column] - expected).max() < COLOUR
    for picture, camera in zip(pictures(one), cameras, strict=True):
        weights = np.abs(1 - picture).sum(-1)
        weights = weights / weights.sum()
        centres = CAMERA.pixel_centres()
        mean = np.einsum("rc,rck->k", weights, centres)
        local = (pose.inverse(camera) @ [*centre, 1])[:3]
        assert np.abs(mean - CAMERA.project(local)).max() < PIXELS
        around = centres - mean
        spread = np.einsum("rc,rci,rcj->ij", weights, around, around)
        slope = CAMERA.fx / local[2] * np.array([[1, 0, -local[0] / local[2]], [0, 1, -local[1] / local[2]]])
        seen = slope @ camera[:3, :3].T @ covariance @ camera[:3, :3] @ slope.T
        assert (
            np.abs(np.sqrt(np.linalg.eigvalsh(spread)) / np.sqrt(np.linalg.eigvalsh(seen)) - 1).max() < 0.15
        )  # ends are cut off
        assert abs(np.linalg.eigh(spread)[1][:, 1] @ np.linalg.eigh(seen)[1][:, 1]) > 0.99  # the long axis
