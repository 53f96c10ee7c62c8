import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datasets.camera_model import Camera
from datasets.errors import DatasetError
from datasets.region import Region

SENSOR = Camera(1920, 1080, 2000.0, 2010.0, 970.0, 530.0, k1=-0.1, p1=1e-3)
regions = st.builds(Region, st.integers(16, 300), st.integers(16, 200), st.integers(0, 60), st.integers(0, 60), st.integers(1, 4))


def test_by_hand() -> None:
    """216x216 binned by 4 at (132, 27): sensor pixel (970, 530) is binned pixel (242.5, 132.5), less the offset."""
    camera = Region(216, 216, 132, 27, 4).camera(SENSOR)
    assert (camera.width, camera.height, camera.fx, camera.fy) == (216, 216, 500.0, 502.5)
    assert (camera.cx, camera.cy) == (110.5, 105.5) and camera.k1 == -0.1


@given(regions, regions, st.floats(0, 1920), st.floats(0, 1080))
def test_the_same_spot_of_the_sensor_is_the_same_ray(one: Region, other: Region, x: float, y: float) -> None:
    """Converted from one region to another, and seen in either, a sensor pixel looks the same way."""
    first = one.camera(SENSOR)
    second = one.converted(first, other)
    rays = [
        camera.directions((x / r.binning - r.offset_x, y / r.binning - r.offset_y))
        for camera, r in ((first, one), (second, other))
    ]
    assert np.abs(rays[0] - rays[1]).max() < 1e-9
    assert (second.width, second.height) == (other.width, other.height)


@pytest.mark.parametrize(
    "content", [{"width": 0, "height": 10}, {"width": 10}, {"width": 10, "height": 10, "offset_x": -1}, 7, {"zoom": 1}]
)
def test_impossible_regions_are_refused(content: object) -> None:
    with pytest.raises(DatasetError, match="sensor region"):
        Region.from_json(content, where="here")


@given(regions)
def test_json_round_trip(region: Region) -> None:
    assert Region.from_json(region.to_json(), where="here") == region
