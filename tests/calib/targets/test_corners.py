import numpy as np
import pytest
from scipy.special import erf

from koala3d.calib.targets import corners

POINTS = np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.03], [0.03, 0.03]])
PLACES = np.array([[30.3, 40.8], [80.1, 42.6], [33.7, 78.2], [84.5, 81.4]])  # a slightly turned and slanted square


def picture(noise, rng, contrast=0.4):
    """(120, 120) picture in which each quarter holds one of the four corners, its edges along the homography's."""
    scale = corners._local_scale(PLACES, POINTS)
    column, row = np.meshgrid(np.arange(120.0), np.arange(120.0))
    grey = np.zeros((120, 120))
    for place, directions in zip(PLACES, scale, strict=True):
        offset = np.stack([column - place[0], row - place[1]], -1)
        values = np.ones((120, 120))
        for axis in range(2):
            edge = directions[:, axis] / np.linalg.norm(directions[:, axis])
            values *= erf((offset @ [-edge[1], edge[0]]) / (0.8 * np.sqrt(2)))
        quarter = (np.abs(offset) < 18).all(-1)
        grey = np.where(quarter, 0.5 + contrast * values + 0.002 * offset[..., 0], grey)
    return (grey + rng.normal(0, noise, grey.shape)).astype(np.float32)


def test_a_perfect_corner_is_found_exactly():
    for contrast in (0.4, -0.4):  # dark squares first, light squares first
        grey = picture(0.0, np.random.default_rng(0), contrast)
        found = corners.fit(grey, PLACES + np.array([0.4, -0.3]), POINTS, 0.005)
        np.testing.assert_allclose(found, PLACES, atol=1e-3)  # steps end below 1e-3 px


def test_noise_moves_corners_by_what_it_must():
    errors = []
    for seed in range(20):
        grey = picture(0.02, np.random.default_rng(seed))
        errors.append(corners.fit(grey, PLACES + 0.3, POINTS, 0.005) - PLACES)
    # 0.02 of noise against 0.8 of contrast on about 30 pixels along edges: near 0.01 px
    assert 0.002 < np.std(errors) < 0.02


def test_where_nothing_fits_the_start_is_kept():
    start = PLACES + 0.25
    flat = np.full((120, 120), 0.5, np.float32)
    np.testing.assert_array_equal(corners.fit(flat, start, POINTS, 0.005), start)
    tiny = picture(0.0, np.random.default_rng(0))
    np.testing.assert_array_equal(corners.fit(tiny, start, POINTS, 0.0005), start)  # discs of 3 pixels


def test_a_corner_at_the_rim_of_the_picture_does_no_harm():
    grey = picture(0.0, np.random.default_rng(0))[:, :83]
    found = corners.fit(grey, PLACES + 0.2, POINTS, 0.005)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[[0, 2]], PLACES[[0, 2]], atol=1e-3)


@pytest.mark.parametrize("offset", [0.0, 1.0], ids=["two dark squares", "one tag"])
def test_model_derivative_agrees_with_central_differences(offset):
    rng = np.random.default_rng(3)
    parameters = rng.normal(0, 0.3, (4, 9)) + np.array([0, 0, 0.2, 1.7, -0.2, 0.4, 0.5, 0, 0])
    offsets = rng.uniform(-4, 4, (4, 50, 2))
    _, jacobian = corners._model(parameters, offsets, offset)
    for index in range(9):
        step = 1e-6 * np.eye(9)[index]
        ahead, behind = (corners._model(parameters + sign * step, offsets, offset)[0] for sign in (1, -1))
        numeric = (ahead - behind) / 2e-6
        np.testing.assert_allclose(jacobian[..., index], numeric, atol=1e-7)
