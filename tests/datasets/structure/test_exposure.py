"""Gains of views whose pictures were multiplied by known factors."""

from collections.abc import Callable

import numpy as np
import pytest

from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure import bounds, matching
from koala3d.datasets.structure.exposure import ExposureGains, exposure_gains


def measured_gains(scene: Scene) -> ExposureGains:
    matrices = np.stack([view.world_from_camera for view in scene.views])
    pairs = matching.pairs_of(matrices, bounds.middle(matrices, scene.box), count=5)
    return exposure_gains(matching.matched(scene.views, pairs), matrices)


def dimmed(scene: Scene, gains: dict[int, tuple[float, float, float]]) -> Scene:
    """Multiply the linear light of some views, in their files."""
    for index, gain in gains.items():
        light = np.asarray(gain) * images.linear_from_srgb(images.read(scene.views[index].image))
        images.write(scene.views[index].image, images.srgb_from_linear(light).clip(0, 1))
    return scene


def test_equal_views_have_equal_gains(two_walls: Callable[..., Scene]) -> None:
    found = measured_gains(two_walls())
    assert found.names == tuple(f"{index:02d}" for index in range(12))
    assert np.abs(found.log_gains).max() < 0.03 and found.std.max() < 0.03 and found.points.min() > 50


def test_gains_and_white_balance_are_measured(two_walls: Callable[..., Scene]) -> None:
    scene = dimmed(two_walls(), {2: (0.6, 0.6, 0.6), 7: (0.9, 0.75, 0.5)})
    found = measured_gains(scene)
    assert np.exp(found.log_gains[2]) == pytest.approx([0.6, 0.6, 0.6], rel=0.05)  # features move a little with contrast
    assert np.exp(found.log_gains[7]) == pytest.approx([0.9, 0.75, 0.5], rel=0.05)
    assert found.gains[7] == pytest.approx((0.9 * 0.75 * 0.5) ** (1 / 3), rel=0.05)
    assert found.white_balance[7, 0] / found.white_balance[7, 2] == pytest.approx(1.8, rel=0.05)
    assert found.std[[2, 7]].max() < 0.05


def test_gains_that_cannot_be_measured_are_not_known(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    images.write(scene.views[5].image, np.full((150, 200, 3), 0.5))
    found = measured_gains(scene)
    assert np.isnan(found.log_gains[5]).all() and np.isfinite(np.delete(found.log_gains, 5, 0)).all() and found.points[5] == 0
