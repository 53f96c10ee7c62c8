"""The studio's geometry and light; and what is named in it: masks, light, and nothing in the untouched."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.checks import light, masks
from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.scene import Scene
from tests.bench import injure
from tests.bench.studio import SOLIDS, Studio, hits, lamps, places, write

SMALL = Studio(views=18, width=160, height=120, table=False)


@pytest.fixture(scope="module")
def floating(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return write(SMALL, tmp_path_factory.mktemp("floating"))


def test_rays_hit_the_solids_where_they_are() -> None:
    origin = np.array([2.0, 0.3, 0.8])
    rays = np.random.default_rng(0).normal(size=(2000, 3)) * [0.3, 0.3, 0.3] - [1, 0.1, 0.25]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, normal = hits(origin, rays, table=True)
    hit = np.isfinite(distance)
    points = origin + distance[hit, None] * rays[hit]
    level = np.min([(((points - c) / h) ** 2).sum(1) for c, h in SOLIDS], axis=0)
    assert hit.sum() > 1000 and (np.abs(level - 1) < 1e-9).sum() > 200
    assert ((np.abs(level - 1) < 1e-9) | (np.abs(points[:, 2]) < 1e-9)).all()  # on a solid or on the table
    assert np.abs(np.linalg.norm(normal[hit], axis=1) - 1).max() < 1e-12 and ((normal[hit] * rays[hit]).sum(1) < 0).all()


def test_lamps_stand_still_in_their_frame() -> None:
    one, other = places(8)[0], places(8)[2]  # a quarter turn on the same ring
    assert np.array_equal(lamps("world", one), lamps("world", other))
    for frame in ("camera", "turntable"):
        assert np.abs(np.linalg.norm(lamps(frame, one), axis=1) - 1).max() < 1e-12
        assert lamps(frame, one) @ one[:3, :3] == pytest.approx(lamps(frame, other) @ other[:3, :3], abs=1e-9)
    up = places(8)[1]
    assert lamps("turntable", up)[:, 2] == pytest.approx(lamps("turntable", one)[:, 2])  # lamps do not tilt with the camera
    assert lamps("camera", up)[:, 2] != pytest.approx(lamps("camera", one)[:, 2], abs=1e-3)


def test_masks_of_the_studio_fit_and_wrong_ones_do_not(floating: Scene, tmp_path: Path) -> None:
    assert masks.find(Evidence.gather(floating)) == []
    for change, key in ((injure.eroded_masks, "smaller_px"), (injure.shifted_masks, "shift_px")):
        injured, hurt = change(floating, 6.0, tmp_path / key)
        found = masks.find(Evidence.gather(injured))
        assert {name for one in found for name in one.evidence["views"]} == hurt
        for one in found:
            figures = next(iter(one.evidence["views"].values()))
            assert 3.5 < np.linalg.norm(figures[key]) < 8.5  # 6 px, on a grid with cells of two


@pytest.mark.slow
def test_light_that_moves_with_the_camera_is_named(tmp_path: Path) -> None:
    still, moving = (write(Studio(views=30, lamps=frame, directed=0.3), tmp_path / frame) for frame in ("world", "camera"))
    assert light.find(Evidence.gather(still)) == []
    (found,) = light.find(Evidence.gather(moving))
    assert found.cause == "light" and found.evidence["frame"] in ("camera", "turntable") and found.evidence["margin"] > 0.12
