import json
import re

import numpy as np
import pytest

from koala3d.capture.model.kinematics import forward
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import Obstacles, draw, plan
from koala3d.datasets.imaging import images

MOUNT = RigDescription().carrier()


@pytest.fixture(scope="module")
def drawn(pytestconfig):
    trajectory = load_trajectory("koala_demo")
    return plan(trajectory, MOUNT)[:8], Obstacles.of(trajectory, MOUNT)


def test_the_page_is_whole_and_loads_nothing(drawn, tmp_path):
    planned, obstacles = drawn
    draw.page(planned, obstacles, tmp_path / "plan.html", title="</script><b>8 views")
    text = (tmp_path / "plan.html").read_text()
    assert not re.search(r"https?://|src=|<link|@import|fetch\(", text) and "/*SCENE*/" not in text
    assert text.count("</script>") == 1  # a title cannot end the script
    found = re.search(r"const scene = (.*);\n", text)
    assert found is not None
    scene = json.loads(found[1].replace("<\\/", "</"))
    assert [view["name"] for view in scene["views"]] == [view.viewpoint.name for view in drawn[0]]
    assert scene["title"] == "</script><b>8 views" and len(scene["box"]) == 12


def test_what_the_page_shows_is_the_plan(drawn):
    planned, obstacles = drawn
    scene = draw._scene(planned, obstacles, "")
    for view, shown in zip(planned, scene["views"], strict=True):
        camera = (forward(view.joints) @ MOUNT.flange_from_camera)[:3, 3]
        np.testing.assert_allclose(shown["track"][-1], camera, atol=1e-4)
        np.testing.assert_allclose(shown["edges"][0][0], camera, atol=1e-4)  # tip of the pyramid
        assert shown["room_mm"] >= 0
    for before, after in zip(scene["views"], scene["views"][1:], strict=False):
        np.testing.assert_allclose(after["track"][0], before["track"][-1], atol=1e-4)


def test_a_plan_of_an_arm_that_hangs_is_drawn_upright(drawn):
    planned, standing = drawn
    hanging = Obstacles(MOUNT, 0.02, table_z=1.2, ceiling_z=0.0, up=-1)
    side, above = draw.figure_of(planned, hanging, title="").axes[:2]
    assert side.yaxis.get_inverted() and not above.yaxis.get_inverted()
    assert {"table", "ceiling"} < set(side.get_legend_handles_labels()[1])
    scene = draw._scene(planned, hanging, "")
    assert (scene["table_z"], scene["ceiling_z"], scene["up"]) == (1.2, 0.0, -1)
    assert draw._scene(planned, standing, "")["up"] == 1


def test_the_picture_shows_both_splits(drawn, tmp_path):
    planned, obstacles = drawn
    draw.plot(planned, obstacles, tmp_path / "plan.png", title="8 views")
    pixels = images.read(tmp_path / "plan.png")[..., :3]
    assert pixels.shape[1] > 1000
    for colour in ((0x1F, 0x77, 0xB4), (0xD6, 0x27, 0x28)):  # train, test
        assert (np.abs(pixels - np.array(colour) / 255).max(-1) < 0.02).sum() > 50


def test_the_legend_says_what_each_colour_stands_for(drawn):
    planned, obstacles = drawn
    figure = draw.figure_of(planned, obstacles, title="")
    (legend,) = figure.legends
    words = [text.get_text() for text in legend.get_texts()]
    tests = sum(view.viewpoint.split == "test" for view in planned)
    assert (
        f"{tests} cameras (test) and their view directions" in words
        and f"{8 - tests} cameras (train) and their view directions" in words
    )
    assert {"path of the camera", "arm at the first view", "box of the object", "table"} < set(words)
    assert len(words) == len(set(words)) == 6
