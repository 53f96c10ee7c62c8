from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.training.decisions.evidence.matches import matches_of
from koala3d.reconstruct.training.decisions.evidence.matte import matte_share
from koala3d.reconstruct.training.decisions.reflection import MOSTLY
from tests.reconstruct.training.decisions.textured import textured_wall

WHOLE_WALL = np.array([[-2.0] * 3, [2.0] * 3])


def share(scene: Scene) -> float | None:
    matches = matches_of(scene, scene.views, load_config())
    assert matches is not None and matches.count > 100
    return matte_share(matches, WHOLE_WALL)


@pytest.mark.parametrize("gains", [False, True])
def test_a_printed_texture_is_matte_whatever_the_exposure(gains: bool, tmp_path: Path) -> None:
    found = share(textured_wall(tmp_path, gains=gains, alpha=True))
    assert found is not None and found > MOSTLY + 0.2


def test_a_texture_that_moves_with_the_camera_is_no_matte_surface(tmp_path: Path) -> None:
    """It is matched as well as a printed one, but its rays meet far behind the wall."""
    found = share(textured_wall(tmp_path, mirrored=0.5, alpha=True))
    assert found is not None and found < MOSTLY - 0.2


def test_a_smooth_ball_tells_nothing(ball_scene: tuple[Scene, Path]) -> None:
    scene = ball_scene[0]
    matches = matches_of(scene, scene.split("train"), load_config())
    assert matches is not None
    found = matte_share(matches, scene.box)
    assert found is not None and found < MOSTLY - 0.2


def test_without_an_alpha_nothing_is_known(tmp_path: Path) -> None:
    scene = textured_wall(tmp_path)
    matches = matches_of(scene, scene.views, load_config())
    assert matches is not None and matte_share(matches, scene.box) is None
