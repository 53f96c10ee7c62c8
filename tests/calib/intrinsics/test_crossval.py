from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import ARM, KOALA, simulate
from koala3d.calib.intrinsics import crossval, estimate, lenses

CAMERA = KOALA.camera


def test_one_camera_does_not_differ_from_itself():
    assert crossval.difference(CAMERA, CAMERA).values_px.max() < 1e-6


def test_a_turned_camera_is_the_same_camera():
    """Half a pixel of the centre is a turn by 0.3 mrad, but for perspective: a hundredth of it over this field of view."""
    moved = crossval.difference(CAMERA, replace(CAMERA, cx=CAMERA.cx + 0.5))
    assert moved.rms_px < 0.2


def test_a_focal_length_shows_at_the_rim():
    wide = crossval.difference(CAMERA, replace(CAMERA, fx=1.01 * CAMERA.fx, fy=1.01 * CAMERA.fy))
    assert wide.values_px.shape == (24, 24)
    middle, rim = wide.values_px[11, 11], wide.values_px[0, 0]
    assert middle < 1 and rim == pytest.approx(0.01 * np.hypot(wide.columns[0] - CAMERA.cx, wide.rows[0] - CAMERA.cy), rel=0.1)


def test_halves_of_a_session_agree_where_corners_were_seen():
    rng = np.random.default_rng(0)
    drawn = simulate(rng, KOALA, viewpoints(rng, KOALA, 24, ViewRange()), sigma_px=0.1, arm=ARM)
    found = estimate.calibrate(drawn.observations(), CAMERA.width, CAMERA.height, lenses=[lenses.USUAL])
    halves = crossval.cross_validate(found.camera, found.lens, found.observations, found.camera_from_board)
    middle = halves.values_px[8:16, 8:16]
    # the centre trades against rotation and is taken out; what is left is a tenth of a pixel and less
    assert np.sqrt(np.mean(middle**2)) < 0.15 < 5
    assert halves.values_px[0, 0] > middle.mean()
