import numpy as np
import pytest

from koala3d.capture.drivers.errors import SimulationError
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.sim.laboratory import views
from koala3d.capture.sim.laboratory.lens import Lens
from koala3d.capture.sim.laboratory.views import BoardView, ObjectView, make_view
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera

CAMERA = Camera(48, 40, 50.0, 50.0, 24.3, 19.2, k1=-0.1)
ABOVE = pose.look_at((0.1, -0.1, 0.4), (0.4, 0.0, 0.1))


def make_ball() -> ObjectView:
    found = make_view("shiny_ball", load_trajectory("koala_demo"), 0).view
    assert isinstance(found, ObjectView)
    return found


@pytest.fixture(scope="module")
def ball() -> ObjectView:
    return make_ball()


def test_the_whole_sensor_gets_fewer_paths_per_pixel():
    """Its pixels have more noise of their own, and there are four times as many of them as with a binning of 2."""
    path = "koala"
    whole, binned = (make_view("shiny_ball", load_trajectory(path, overrides=[f"camera.binning={n}"]), 0).view for n in (1, 2))
    assert isinstance(whole, ObjectView) and isinstance(binned, ObjectView) and whole.samples < binned.samples < 4 * whole.samples


def test_truth_in_strips_is_the_truth(ball, monkeypatch):
    lens = Lens(CAMERA)
    ball.radiance(lens, ABOVE[None], 0)
    whole = ball.truth(lens, ABOVE, 0)
    monkeypatch.setattr(views, "RAYS_AT_ONCE", 7 * lens.pinhole.width * views.FINE**2)
    parts = ball.truth(lens, ABOVE, 0)
    for name, values in whole.items():
        assert parts[name].shape == values.shape and values.shape[:2] == (40, 48)
    inside = whole["alpha"][..., 0] == 1
    assert 0.1 < inside.mean() < 0.9  # the premise
    assert (parts["alpha"][inside] > 0.9).all()
    assert (
        np.abs(parts["depth"] - whole["depth"])[inside].max() < 2e-3
    )  # one ray in each quarter of a fine pixel, elsewhere in it
    together = whole["diffuse"] + whole["specular"]
    np.testing.assert_allclose(parts["diffuse"] + parts["specular"], together, atol=1e-5)  # the same picture, however shared


@pytest.mark.parametrize("changes", [["up=-z", "safety.table_z=1.2"], ["safety.table_z=-0.4"]])
def test_the_room_is_the_same_from_wherever_the_base_is(ball, changes):
    """An arm that hangs, or stands on a pedestal, sees the same picture from the same place of the room."""
    path = "koala_demo"
    base_from_table = load_trajectory(path, overrides=changes).base_from_table
    volume = load_trajectory(path).object
    assert volume is not None
    centre = base_from_table @ [*volume.centre, 1.0]
    elsewhere = make_view("shiny_ball", load_trajectory(path, overrides=[*changes, f"object.centre={centre[:3].tolist()}"]), 0)
    lens, there = Lens(CAMERA), base_from_table @ ABOVE
    np.testing.assert_allclose(elsewhere.radiance(lens, there[None], 0), ball.radiance(lens, ABOVE[None], 0), atol=0.02)
    here, seen = ball.truth(lens, ABOVE, 0), elsewhere.truth(lens, there, 0)
    whole = here["alpha"][..., 0] == 1
    np.testing.assert_allclose(seen["depth"][whole], here["depth"][whole], atol=1e-4)
    np.testing.assert_allclose(seen["normals"][whole], here["normals"][whole] @ base_from_table[:3, :3].T, atol=1e-3)
    np.testing.assert_allclose(
        elsewhere.mesh().vertices, ball.mesh().vertices @ base_from_table[:3, :3].T + base_from_table[:3, 3]
    )
    np.testing.assert_allclose(elsewhere.mesh().centroid, centre[:3], atol=0.06)  # and it stands in its box


def test_there_is_no_truth_before_a_picture():
    with pytest.raises(SimulationError, match="no picture has been taken"):
        make_ball().truth(Lens(CAMERA), ABOVE, 0)


def test_the_board_is_no_object():
    found = make_view("board", load_trajectory("calibration_demo"), 0)
    assert isinstance(found.view, BoardView) and found.mesh() is None and found.truth(Lens(CAMERA), ABOVE, 0) == {}
