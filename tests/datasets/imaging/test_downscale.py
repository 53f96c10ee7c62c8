import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import downscale, images
from tests.bench import reading

RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("suffix", "kind", "tolerance"),
    [(".png", np.uint8, 0.51 / 255), (".png", np.uint16, 0.51 / 65535), (".tif", np.uint16, 0.51 / 65535)],
)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_integers_keep_their_depth_and_average_light(
    tmp_path: Path, suffix: str, kind: type, tolerance: float, channels: int
) -> None:
    stored = RANDOM.integers(0, np.iinfo(kind).max, (24, 32, channels), kind, endpoint=True)
    images.write(tmp_path / f"a{suffix}", stored)
    small = downscale.shrunk(tmp_path / f"a{suffix}", 8, 6)
    assert small.dtype == kind and small.shape == (6, 8, channels)
    expected = images.resize(images.read(tmp_path / f"a{suffix}"), 8, 6)
    assert np.abs(small / np.iinfo(kind).max - expected).max() < tolerance  # rounding alone


def test_floats_are_linear_light_weighted_by_alpha(tmp_path: Path) -> None:
    images.write(tmp_path / "a.exr", np.array([[[4.0, 0, 0, 1.0], [0, 9.0, 0, 0.0]]], np.float32))
    assert np.allclose(downscale.shrunk(tmp_path / "a.exr", 1, 1), [[[4, 0, 0, 0.5]]], atol=1e-6)


def test_masks_are_averaged_without_conversion(tmp_path: Path) -> None:
    images.write(tmp_path / "m.png", np.array([[0, 255], [0, 255]], np.uint8))
    assert downscale.shrunk(tmp_path / "m.png", 1, 1, colours=False).ravel() == [128]


def test_two_views_do_not_share_a_file(tmp_path: Path) -> None:
    images.write(tmp_path / "a.jpg", RANDOM.random((16, 16, 3)))
    downscale.Job(tmp_path / "a.jpg", tmp_path / "small" / "a.jpg", 4, 4).run()
    with pytest.raises(DatasetError, match="would share a file"):
        downscale.Job(tmp_path / "a.jpg", tmp_path / "small" / "a.jpg", 4, 4).run()


def test_camera_of_a_size_that_does_not_divide() -> None:
    small = downscale.camera(Camera(101, 75, 90.0, 90.0, 50.5, 37.5), 4)
    assert (small.width, small.height, small.cx, small.cy) == (25, 18, 12.5, 9.0)


def test_streamed_keeps_the_order_and_few_results() -> None:
    """Ten results of a megabyte each pass through; two are under way and one is being looked at."""
    tracemalloc.start()
    order = [int(result[0]) for result in downscale.streamed(lambda i: np.full(131072, float(i)), range(10))]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert order == list(range(10)) and peak < 6 * 2**20


def test_an_error_in_a_worker_ends_the_work(tmp_path: Path) -> None:
    jobs = [downscale.Job(tmp_path / "none.png", tmp_path / f"{i}.png", 2, 2) for i in range(5)]
    with pytest.raises(Exception, match="no such image"):
        downscale.run(jobs)


def test_memory_does_not_grow_with_the_number_of_pictures() -> None:
    found = reading.read_and_shrink(30, width=640, height=360)
    assert found["peak_growth_mb"] < 5  # the other twenty pictures would be 55 MB
    assert (found["small_width"], found["small_height"]) == (160, 90)
