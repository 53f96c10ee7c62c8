from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.formats import load_scene
from koala3d.datasets.structure import bounds
from tests.bench import large
from tests.bench.studio import Studio, write


def test_both_scenes_show_the_ellipsoid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large, "AXES", np.array([0.3, 0.2, 0.4]))
    small = write(Studio(views=16, width=120, height=90), tmp_path / "studio")
    large.write(small, tmp_path / "large", count=18, width=240, height=160)
    masks, alpha = (load_scene(tmp_path / "large" / kind) for kind in large.KINDS)
    centre = bounds.focus(np.stack([view.world_from_camera for view in small.views]))[0]
    for scene in (masks, alpha):
        assert len(scene.views) == 18 and (scene.views[0].camera.width, scene.views[0].camera.height) == (240, 160)
        assert scene.bounds_from.startswith("masks or alpha") and (np.abs(scene.box - centre) < 0.6).all()
    one, other = (scene.views[4].read_cover(60, 40) for scene in (masks, alpha))
    assert np.array_equal(one, other) and 0 < one.mean() < 1
    found = large.measured(["info", str(tmp_path / "large" / "masks")], tmp_path / "cache")
    assert found["status"] == 0 and found["seconds"] > 0 and found["gb"] > 0
