import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging.region import Region

SENSOR = Camera(1920, 1080, 1270.0, 1271.0, 955.0, 548.0, k1=-0.1, k2=0.05, p1=1e-3, p2=-1e-3)
SMALL, WIDE = Region(216, 216, 132, 27, 4), Region(960, 540, 0, 0, 2)


def test_a_point_moves_with_the_readout():
    point = np.array([0.03, -0.02, 0.4])
    on_sensor = SENSOR.project(point)
    np.testing.assert_allclose(SMALL.camera(SENSOR).project(point), on_sensor / 4 - [132, 27], atol=1e-10)
    np.testing.assert_allclose(WIDE.camera(SENSOR).project(point), on_sensor / 2, atol=1e-10)


def test_regions_convert_into_each_other():
    direct, via = SMALL.camera(SENSOR), WIDE.converted(WIDE.camera(SENSOR), SMALL)
    assert (direct.width, direct.height) == (via.width, via.height) == (216, 216)
    np.testing.assert_allclose([*direct.to_json().values()], [*via.to_json().values()], rtol=1e-12)
    assert WIDE.sensor_camera(WIDE.camera(SENSOR), 1920, 1080) == SENSOR


def test_reads_what_it_wrote_and_refuses_the_rest():
    assert Region.from_json(SMALL.to_json(), where="x") == SMALL
    for wrong in ({}, None, {"width": 5, "height": 0}, {"width": "a", "height": 1}, {"width": 1, "height": 1, "zoom": 2}):
        with pytest.raises(DatasetError, match="sensor region"):
            Region.from_json(wrong, where="x")
