from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.page.look import AROUND, LookPage, framed
from koala3d.capture.page.overlay import FRAME, PEAK, peaks, shown
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.sessions.live.analysis import Part
from koala3d.capture.sessions.live.jog import Jog
from koala3d.capture.sessions.live.teach import Teaching
from koala3d.capture.sim.kinematic_arm import KinematicArm
from koala3d.datasets import pose
from koala3d.datasets.page import open_page
from koala3d.datasets.recording import Recording
from tests.browser import Browse
from tests.moments import until

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


@pytest.mark.timeout(600)
def test_poses_that_are_shown_on_the_page_become_a_trajectory_that_runs(browse: Browse, tmp_path: Path, run_inside):
    session = load_trajectory("koala_demo", overrides=["camera.width=96", "camera.height=64", "split=null"])
    mount, taught = RigDescription().carrier(), tmp_path / "taught.yaml"
    with camera_for("sim", session, scene="grey_card") as camera, open_page("live", 0) as page:
        with KinematicArm(load_arm("ur5e"), time_scale=100.0) as arm:
            jog = Jog(arm, session, mount)
            teaching = Teaching(taught, session, jog.obstacles)
            live = LookPage(page, camera, PART, burst=8, balance=None, stored="", jog=jog, teaching=teaching)
            with browse(page) as window:
                seen = lambda words: window.page.get_by_text(words).first.wait_for()  # noqa: E731
                press = lambda name: window.page.get_by_role("button", name=name, exact=True).click()  # noqa: E731
                press("go there")
                seen("at 000")
                press("take this pose as a view")
                seen("view 000 taken")
                before = mount.base_from_camera(arm.state().joints)
                press("back")
                seen("between views")
                moved = pose.inverse(before) @ mount.base_from_camera(arm.state().joints)
                press("take this pose as a view")
                seen("view 001 taken")
                press("take this pose as a view")
                seen("view 001 sees the same")
                window.page.get_by_label("freedrive").click()
                seen("free: move it by hand")
                assert jog.is_free
                press("stop the arm")
                press("allow motions again")
                level = mount.base_from_camera(arm.state().joints)
                press("look up")
                turned = lambda: pose.inverse(level) @ mount.base_from_camera(arm.state().joints)  # noqa: E731
                until(lambda: pose.rotation_vector(turned())[0] > np.radians(1.9), "a turn of two degrees upwards")
            live.end()
    np.testing.assert_allclose(moved[:3, 3], [0, 0, -0.01], atol=1e-4)
    planned = run_inside(main, "capture", "plan", str(taught))
    assert planned.returncode == 0, planned.stderr
    done = run_inside(main, "capture", "run", str(taught), "--scene", "grey_card", "--out", str(tmp_path / "rec"))
    assert done.returncode == 0, done.stderr
    frames = Recording.open(tmp_path / "rec").frames
    assert [frame.name for frame in frames] == ["000", "001"]
    apart = pose.inverse(mount.base_from_camera(frames[0].joints)) @ mount.base_from_camera(frames[1].joints)
    np.testing.assert_allclose(apart[:3, 3], [0, 0, -0.01], atol=2e-4)
