"""The page before a session that chooses its views: the region holds every straight move between them."""

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.planning import Obstacles, preview

MOUNT = RigDescription().carrier()
OBSTACLES = Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=np.array([[0.3, -0.1, 0.0], [0.5, 0.1, 0.3]]))
START = MOUNT.arm.home
VIEWS = np.radians([[0, -90, 90, -90, -90, 0], [40, -80, 90, -100, -90, 30], [-30, -100, 80, -70, -90, 0]])


def test_straight_moves_stay_inside_the_region() -> None:
    cells = preview.swept_cells(START, VIEWS, OBSTACLES)
    low, high = cells.min(axis=0) - preview.CELL_M / 2, cells.max(axis=0) + preview.CELL_M / 2
    for one, other in pairwise([START, *VIEWS, VIEWS[0]]):
        ends = MOUNT.segments(np.linspace(one, other, 60))
        radii = MOUNT.shape.radii[:, None, None] / np.sqrt(3)
        assert (ends - radii > low - 0.01).all() and (ends + radii < high + 0.01).all()
    assert (high - low < 2.0).all(), "and it is no larger than the arm reaches"


def test_the_page_has_the_views_and_the_surroundings(tmp_path: Path) -> None:
    preview.write(START, VIEWS, OBSTACLES, tmp_path / "page.html", title="three views")
    text = (tmp_path / "page.html").read_text()
    found = re.search(r"const scene = (.*);\n", text)
    assert found is not None and not re.search(r"https?://|src=|<link|@import|fetch\(", text)
    scene = json.loads(found[1])
    assert [view["name"] for view in scene["views"]] == ["where the arm stands", "0", "1", "2"]
    assert scene["title"].startswith("three views\n") and len(scene["box"]) == 12 and scene["table_z"] == 0.0
    np.testing.assert_allclose(scene["views"][2]["arm"][0], MOUNT.segments(VIEWS[1]), atol=1e-4)
    rooms = [view["room_mm"] for view in scene["views"]]
    np.testing.assert_allclose(rooms, 1e3 * OBSTACLES.margin(np.stack([START, *VIEWS])), atol=0.06)
