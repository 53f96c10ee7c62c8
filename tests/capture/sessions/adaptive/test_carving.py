"""Bodies carved from outlines that are drawn by hand: a ball on a table, seen from around."""

import numpy as np

from koala3d.capture.sessions.adaptive.background import Outline
from koala3d.capture.sessions.adaptive.carving import carved
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.structure.masks.silhouette import Silhouette

CAMERA = Camera(160, 120, 150.0, 150.0, 80.0, 60.0)
CORNERS = np.array([[0.27, -0.13, 0.0], [0.53, 0.13, 0.3]])
MIDDLE, RADIUS = np.array([0.4, 0.0, 0.06]), 0.05
EYES = [(0.4 + 0.4 * np.cos(0.5 * k), 0.4 * np.sin(0.5 * k), 0.15 + 0.02 * k) for k in range(12)]


def shows(eye: tuple[float, float, float], middle: np.ndarray, radius: float) -> np.ndarray:
    """(height, width) pixels that show a ball."""
    ways = CAMERA.directions(CAMERA.pixel_centres()) @ camera_pose(eye)[:3, :3].T
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    towards = middle - np.array(eye)
    return np.asarray(np.linalg.norm(towards - (ways @ towards)[..., None] * ways, axis=-1) < radius)


def camera_pose(eye: tuple[float, float, float]) -> np.ndarray:
    return pose.look_at(eye, (0.4, 0.0, 0.06), (0, 0, 1))


def outline(eye: tuple[float, float, float], silent: np.ndarray | None = None, wrong: np.ndarray | None = None) -> Outline:
    """What a view says that shows the ball; `silent` pixels tell nothing, `wrong` ones are taken for table."""
    ball, silent = shows(eye, MIDDLE, RADIUS), np.zeros((120, 160), bool) if silent is None else silent
    inside = (ball & ~(np.zeros_like(ball) if wrong is None else wrong)) | silent
    return Outline(*(Silhouette(CAMERA, camera_pose(eye), found) for found in (inside, silent)))


def distance(places: np.ndarray) -> np.ndarray:
    """(n,) signed distance of points from the ball [m]."""
    return np.asarray(np.linalg.norm(places - MIDDLE, axis=1) - RADIUS)


def test_a_ball_is_carved_out_of_its_box():
    found = carved([outline(eye) for eye in EYES], CORNERS, 0.0)
    assert found is not None
    assert np.median(np.abs(distance(found.points))) < 0.006  # a cell is 6 mm wide


def test_one_view_that_takes_the_ball_for_table_does_not_carve_it():
    """Of 24 views, one sees the table where the ball is, as through something clear."""
    views = [outline(eye) for eye in EYES + [(x, y, z + 0.01) for x, y, z in EYES]]
    wrong = outline(EYES[3], wrong=np.ones((120, 160), bool))
    found = carved([*views[:3], wrong, *views[4:]], CORNERS, 0.0)
    assert found is not None
    assert np.median(np.abs(distance(found.points))) < 0.006


def test_space_that_no_view_can_judge_is_not_the_object():
    """Pixels that show the space on top of the ball tell nothing."""
    above = np.array([0.4, 0.0, 0.19])
    found = carved([outline(eye, silent=shows(eye, above, 0.09)) for eye in EYES], CORNERS, 0.0)
    assert found is not None
    assert distance(found.points).max() < 0.07


def test_what_hangs_in_the_air_is_not_the_object():
    """A part in the air that is larger than the ball is left by the views; the ball stands on the table."""
    views = [outline(eye) for eye in EYES]
    above = np.array([0.4, 0.0, 0.22])
    for view, eye in zip(views, EYES, strict=True):
        view.foreground.inside[shows(eye, above, 0.07)] = True
    found = carved(views, CORNERS, 0.0)
    assert found is not None
    assert np.median(np.abs(distance(found.points))) < 0.01


def test_nothing_is_left_where_all_is_table():
    empty = np.zeros((120, 160), bool)
    silhouettes = [Silhouette(CAMERA, camera_pose(eye), empty) for eye in EYES]
    assert carved([Outline(one, one) for one in silhouettes], CORNERS, 0.0) is None
