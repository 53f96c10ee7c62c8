"""Surfaces of displacements: against SciPy's B-splines, their derivatives and inverse, as a part of cameras and in files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.spline import Grid, Spline

GRID = Grid(-0.7, -0.45, 0.13, 0.12, 11, 8)
KNOTS = np.random.default_rng(0).normal(0, 1e-3, (GRID.count, 2))
PLACES = np.random.default_rng(1).uniform([-1.1, -0.8], [1.1, 0.8], (200, 2))  # beyond the outermost knots too
SPLINE = Spline(GRID, tuple(KNOTS.ravel().tolist()))
PLAIN = Camera(960, 600, 850.0, 848.0, 484.0, 296.0, -0.08, 0.05, 0.0006, -0.0004)
CAMERA = replace(PLAIN, spline=SPLINE)
BENT_FISHEYE = replace(Camera(640, 480, 300.0, 301.0, 322.0, 236.0, 0.02, -0.01, k3=0.004, fisheye=True), spline=SPLINE)


def scipys(places: np.ndarray) -> np.ndarray:
    """(n, 2) displacements, knot by knot."""
    element = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)
    found = np.zeros((len(places), 2))
    for place, knot in zip(GRID.places, KNOTS, strict=True):
        across, down = ((places - place) / [GRID.step_x, GRID.step_y]).T
        found += (np.nan_to_num(element(across)) * np.nan_to_num(element(down)))[:, None] * knot
    return found


def test_a_surface_is_the_sum_of_scipys_b_splines() -> None:
    value, _ = GRID.surface(PLACES, KNOTS)
    np.testing.assert_allclose(value, scipys(PLACES), rtol=0, atol=1e-16)  # rounding of values of 1e-3
    np.testing.assert_allclose(GRID.weights(PLACES) @ KNOTS, value, rtol=0, atol=1e-16)


def test_the_derivative_agrees_with_central_differences() -> None:
    _, slope = GRID.surface(PLACES, KNOTS)
    step = 1e-5  # truncation: step^2 times third derivatives of about 1; rounding: 1e-19 / step
    for axis in range(2):
        move = step * np.eye(2)[axis]
        numeric = (GRID.surface(PLACES + move, KNOTS)[0] - GRID.surface(PLACES - move, KNOTS)[0]) / (2 * step)
        np.testing.assert_allclose(slope[..., axis], numeric, rtol=0, atol=1e-9)


@pytest.mark.parametrize("camera", [CAMERA, BENT_FISHEYE], ids=["ordinary", "fisheye"])
def test_projection_and_directions_are_inverse(camera: Camera) -> None:
    pixels = camera.pixel_centres()[::7, ::7]
    there_and_back = camera.project(camera.directions(pixels))
    assert np.abs(there_and_back - pixels).max() < 1e-9
    assert np.abs(replace(camera, spline=None).project(camera.directions(pixels)) - pixels).max() > 0.3  # the knots matter


def test_the_steepest_surface_that_is_allowed_can_be_inverted() -> None:
    steep = Spline(GRID, tuple(np.tile([1.0, -1.0], GRID.count).tolist()))
    steep = Spline(GRID, tuple((0.499 / steep.steepest * np.array(steep.knots)).tolist())).checked(where="here")
    assert np.abs(steep.bend(steep.straighten(PLACES)) - PLACES).max() < 1e-12


def test_another_size_and_a_part_of_the_image_keep_the_rays() -> None:
    pixels = PLACES[:50] * [400, 300] + [480, 300]
    small = CAMERA.scaled(480, 200)
    np.testing.assert_allclose(small.directions(pixels * [0.5, 1 / 3]), CAMERA.directions(pixels), atol=1e-12)
    part = Region(640, 480, 100, 60).camera(CAMERA)
    np.testing.assert_allclose(part.directions(pixels - [100, 60]), CAMERA.directions(pixels), atol=1e-12)


def test_it_is_stored_exactly_and_only_where_there_is_one() -> None:
    stored = json.loads(json.dumps(CAMERA.to_json()))
    again = Camera.from_json(stored, where="here")
    assert again == CAMERA and hash(again) == hash(CAMERA)
    assert "spline" not in PLAIN.to_json() and not replace(Camera(2, 2, 1, 1, 1, 1), spline=SPLINE).is_pinhole


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"knots": [[0.0, 1.0]]}, "shape"),
        ({"knots": [[[0.0, 0.0]] * 9] * 3}, "3 rows of 9 knots"),
        ({"knots": [[[0.0, float("nan")]] * 9] * 5}, "not finite"),
        ({"knots": [[[0.0, 0.3]] * 9] * 5}, "slope reaches"),
        ({"knots": [[[0.0, 0.0]] * 9] * 4 + [[[0.0, 0.0]] * 8]}, "not complete"),
        ({"knots": "none"}, "not complete"),
        ({"step": [0.1, 0.0]}, "steps are 0.1 and 0"),
        ({"step": [0.1]}, "not complete"),
        ({"first": None}, "not complete"),
        ({"order": 3}, "order"),
    ],
)
def test_an_impossible_grid_is_refused_in_one_line(change: dict, why: str) -> None:
    stored = PLAIN.to_json() | {"spline": SPLINE.to_json() | change}
    with pytest.raises(DatasetError, match="here, spline") as refused:
        Camera.from_json(stored, where="here")
    assert why in str(refused.value) and "\n" not in str(refused.value)


def test_something_else_than_a_grid_is_refused() -> None:
    with pytest.raises(DatasetError, match="here, spline"):
        Camera.from_json(PLAIN.to_json() | {"spline": 3}, where="here")
