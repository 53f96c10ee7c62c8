from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.page.look import AROUND, LookPage, framed
from koala3d.capture.page.overlay import FRAME, PEAK, peaks, shown
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.sessions.live.analysis import Part
from koala3d.capture.sessions.live.jog import Jog
from koala3d.capture.sim.kinematic_arm import KinematicArm
from koala3d.datasets.page import open_page
from tests.browser import Browse

PART = Part(8, 8, 56, 40)


def test_marks_lie_where_they_belong():
    picture = np.full((48, 64, 3), 120, np.uint8)
    picture[:, 32:] = 20  # one sharp edge
    picture[20:28, 12:24] = 255
    drawn = shown(picture, PART, width=64)
    plain = shown(picture, PART, peaking=False, zebra=False, width=64)
    pink, striped = (drawn == PEAK).all(-1), (drawn == 0).all(-1)
    assert pink[19:29, 11:25].any() and not pink[:, 26:30].any() and not pink[:8].any()  # the steepest edges are the square's
    assert 0.3 < striped[21:27, 13:23].mean() < 0.7 and not striped[30:].any()
    assert (drawn[8, 10:30] == FRAME).all() and (plain[24, 18] == 255).all()
    assert not peaks(picture[30:, 40:]).any() and peaks(picture[30:, 26:40])[:, 5:7].any()


def test_soft_edges_are_not_marked():
    ramp = np.broadcast_to(np.linspace(60, 90, 64)[None, :, None], (48, 64, 3)).astype(np.uint8)
    assert not peaks(ramp).any()


@pytest.mark.parametrize("aspect", [0.5, 1.0, 3.0])
def test_a_window_shows_the_picture_undistorted(aspect):
    whole = framed(np.full((40, 60, 3), 200, np.uint8), aspect)
    assert whole.shape[1] / whole.shape[0] == pytest.approx(aspect, rel=0.02)
    assert (whole == 200).all(-1).sum() == 40 * 60 and set(np.unique(whole)) == {AROUND, 200}


@pytest.mark.timeout(600)
def test_the_page_shows_the_emulated_camera_and_moves_the_arm(browse: Browse, tmp_path: Path):
    session = load_trajectory("koala_demo", overrides=["camera.width=96", "camera.height=64", "camera.exposure_us=30000"])
    mount = RigDescription().carrier()
    with camera_for("sim", session, scene="grey_card") as camera, open_page("live", 0) as page:
        with KinematicArm(load_arm("ur5e"), time_scale=100.0) as arm:
            jog = Jog(arm, session, mount)
            live = LookPage(page, camera, PART, burst=8, balance=tmp_path / "balance.npz", stored="", jog=jog)
            with browse(page) as window:
                seen = lambda words: window.page.get_by_text(words).wait_for()  # noqa: E731
                press = lambda words: window.page.get_by_text(words).click()  # noqa: E731
                seen("clipped 100.00 % of the pixels")
                press("use the suggested exposure")
                seen("clipped 0.00 % of the pixels")
                press("measure flicker")
                seen("flicker none seen")
                press("store the region's white balance")
                seen("stored in")
                press("go there")
                seen("at 000")
                green = lambda picture: picture[..., 1].astype(int) - picture[..., 0] > 40  # noqa: E731
                window.until(lambda picture: green(picture).sum() > 100, "the frame of the region")
            live.end()
            reached = mount.base_from_camera(arm.state().joints)[:3, 3]
    assert (tmp_path / "balance.npz").is_file()
    assert np.allclose(reached, jog.views["000"].camera_pose(mount)[:3, 3], atol=2e-4)  # the arm repeats to a tenth of that
