"""Which camera the pictures of a trajectory will have."""

from dataclasses import replace

import pytest

from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.sessions.adaptive.shape import lens_of
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging.region import Region

CALIBRATED = Region(960, 540, 0, 0, 2)
CALIBRATION = Calibration(Camera(960, 540, 900.0, 910.0, 470.0, 280.0, k1=-0.1), {}, region=CALIBRATED)


def test_a_calibration_serves_other_regions_of_its_sensor():
    """Pictures of the middle, with binning 4: as for a recording that states the same region."""
    camera = lens_of(load_trajectory("koala_demo"), CALIBRATION)
    assert camera == CALIBRATED.converted(CALIBRATION.camera, Region(216, 216, 132, 27, 4))


def test_stated_offsets_are_used():
    trajectory = load_trajectory("koala_demo", overrides=["camera.offset_x=10", "camera.offset_y=20"])
    assert lens_of(trajectory, CALIBRATION) == CALIBRATED.converted(CALIBRATION.camera, Region(216, 216, 10, 20, 4))


def test_a_calibration_that_does_not_know_its_region_serves_its_size_alone():
    unknown = replace(CALIBRATION, region=None)
    fitting = load_trajectory("koala_demo", overrides=["camera.width=960", "camera.height=540"])
    assert lens_of(fitting, unknown) == unknown.camera
    with pytest.raises(UsageError, match="pictures are 216x216, the calibrated camera is 960x540"):
        lens_of(load_trajectory("koala_demo"), unknown)


def test_without_a_calibration_there_is_no_lens():
    assert lens_of(load_trajectory("koala_demo"), None) is None
