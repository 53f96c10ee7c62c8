"""Whether first surfaces are where the surface is."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.formats import load_scene
from koala3d.reconstruct.bench.first_surfaces import SHARES, Seen, _off_by, table, watch
from koala3d.reconstruct.bench.scenes import make
from koala3d.reconstruct.bench.scenes.shiny import RADIUS_M, SCENES
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.scene.rays import Normalisation


def test_distance_from_the_truth_is_in_pixels_there() -> None:
    """A ball of 0.8 radii seen from 0.6 m: its front is at 0.6 m less 0.096 m."""
    normalisation = Normalisation((0.0, 0.0, 0.0), 10.0, True, 1.0, 10.0)
    true = 0.6 - 0.8 * RADIUS_M
    origins = np.array([[0.0, 0.0, 6.0]] * 3)
    directions = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    t = 10 * np.array([true, true + 0.003, true])
    off = _off_by(t, origins, directions, SCENES["chrome_ball"](), normalisation, width_m=0.002)
    np.testing.assert_allclose(off[:2], [0, 0.003 / (0.002 * true)], atol=0.02)  # float32 in metres: 1e-5 m, 0.01 pixels
    assert np.isinf(off[2])  # looks past it


def test_the_table_has_a_line_per_step() -> None:
    found = [Seen(step, rule, 100, 0.5, 1.5) for step in (16, 32) for rule in ("median", "share", "half")]
    lines = table(found).splitlines()
    assert len(lines) == 3 and lines[1].split()[:4] == ["16", "50.0%", "1.5", "px"]


@pytest.mark.slow
def test_a_training_is_watched_to_its_end(tmp_path: Path) -> None:
    scene = tmp_path / "chrome_ball"
    make.provide("chrome_ball", scene, size=40, train=8, test=1)
    config = load_config(overrides=["train.steps=400", "train.checkpoint_s=1000"])
    found = watch(load_scene(scene), scene, SCENES["chrome_ball"](), config)
    assert {seen.rule for seen in found} == {"median", "share", "half"} and max(seen.step for seen in found) == 400
    assert len(found) <= 3 * len(SHARES)
    assert all(0 <= seen.right <= 1 and seen.rays > 0 for seen in found)
