"""Two scenes of the same pictures: what differs by a similarity is the same, and what does not is measured."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.process.world.comparison import compared
from koala3d.datasets.process.world.similarity import Similarity
from koala3d.datasets.scene import Scene
from tests.bench.studio import Studio, write


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return write(Studio(views=8, width=32, height=24), tmp_path)


def moved(scene: Scene) -> Scene:
    similarity = Similarity(2.5, pose.from_rotation_vector([0.3, -1.0, 0.4])[:3, :3], np.array([1.0, -2.0, 3.0]))
    return scene.with_views(tuple(similarity.view(view) for view in scene.views))


def test_a_similarity_makes_no_difference_and_names_may_differ(scene: Scene) -> None:
    renamed = scene.with_views(tuple(replace(view, name=f"other{i}") for i, view in enumerate(moved(scene).views)))
    found = compared(renamed, scene)
    assert found.names == tuple(view.name for view in scene.views)
    assert found.positions.max() < 1e-9 and found.turns_deg.max() < 1e-5 and found.fitted_deg.max() < 1e-5


def test_a_turned_camera_and_a_moved_one_are_measured(scene: Scene) -> None:
    views = list(moved(scene).views)
    views[2] = replace(views[2], world_from_camera=views[2].world_from_camera @ pose.from_rotation_vector([0, np.deg2rad(3), 0]))
    found = compared(scene.with_views(tuple(views)), scene)
    assert found.turns_deg[2] == pytest.approx(3, abs=1e-6) and np.delete(found.turns_deg, 2).max() < 1e-5
    views = list(scene.views)
    views[2] = replace(views[2], world_from_camera=pose.from_rotation_vector([0, 0, 0], [0.1, 0, 0]) @ views[2].world_from_camera)
    assert np.argmax(compared(scene.with_views(tuple(views)), scene).positions) == 2


def test_scenes_of_other_pictures_are_refused(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = write(Studio(views=8, width=32, height=24, seed=1), tmp_path / "other")
    other = other.with_views(tuple(replace(view, name=f"x{view.name}") for view in other.views))
    with pytest.raises(UsageError, match="0 of 8 views"):
        compared(scene, other)
