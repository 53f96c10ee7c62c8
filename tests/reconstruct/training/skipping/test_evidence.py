from collections.abc import Callable

import numpy as np
import pytest

from koala3d.datasets.core.console import progress
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.sampling.hull import cells_in_masks
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.skipping.evidence import evidence_of, footprints


def look(scene: Scene, possible: Callable | None = None):
    views, normalisation = scene.split("train"), Normalisation.of(scene)
    with progress("reading", len(views)) as shown:
        pixels = Pixels.load(views, normalisation, 1.0, shown)
    cells = None if possible is None else possible(pixels, views, normalisation)
    return evidence_of(scene, views, pixels, normalisation, cells, 1.0)


def test_a_masked_scene_is_bounded_and_mostly_empty(make_scene: Callable[..., Scene]) -> None:
    found = look(
        make_scene(mask=True), lambda pixels, views, normalisation: cells_in_masks(pixels, views, normalisation, 32, 1.0)
    )
    assert found.bounded and found.bent == 0 and found.views == 6
    assert found.transparent == pytest.approx(1 - np.pi * 20**2 / (96 * 72), abs=0.01), "the mask is a disc of 20 pixels"
    assert 0.05 < found.possible < 1


def test_surroundings_may_come_as_near_as_the_near_plane(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene()
    found, normalisation = look(scene), Normalisation.of(scene)
    assert not found.bounded and found.smallest <= normalisation.near / 90 * 1.0001
    assert found.possible == 1


def test_footprints_are_depth_over_focal_length(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(mask=True)
    normalisation = Normalisation.of(scene)
    depth = [(-view.world_from_camera[:3, 2] @ view.world_from_camera[:3, 3]) for view in scene.views]  # of the origin
    middle = (np.zeros(3) - normalisation.centre) * normalisation.scale
    smallest, largest = footprints(scene.views, normalisation, middle[None], 1.0)
    np.testing.assert_allclose([smallest, largest], np.array([min(depth), max(depth)]) * normalisation.scale / 90, rtol=1e-6)
    halved = footprints(scene.views, normalisation, middle[None], 0.5)
    np.testing.assert_allclose(halved, [2 * smallest, 2 * largest], rtol=1e-6)
    assert footprints(scene.views, normalisation, np.full((1, 3), 1e9), 1.0) == (0.0, np.inf), "nothing in sight"
