import numpy as np
import pytest

from koala3d.capture.drivers.cameras.pixels import CANDIDATES, choose_format, colours
from koala3d.capture.drivers.errors import CaptureError
from koala3d.datasets.imaging.images import srgb_from_linear

PLACES = {"RG": ((0, 0), (1, 1)), "GB": ((1, 0), (0, 1)), "BG": ((1, 1), (0, 0)), "GR": ((0, 1), (1, 0))}
"""Row and column of the red and of the blue photosite of each pattern."""


def mosaic(linear: np.ndarray, pattern: str) -> np.ndarray:
    """(height, width) what each photosite of a Bayer pattern sees of a (height, width, 3) picture."""
    raw = linear[..., 1].copy()
    for (row, column), channel in zip(PLACES[pattern], (0, 2), strict=True):
        raw[row::2, column::2] = linear[row::2, column::2, channel]
    return raw


@pytest.mark.parametrize(("depth", "white", "full"), [("8", 255, 255), ("12", 4095, 65535)])
@pytest.mark.parametrize("pattern", PLACES)
def test_even_colours_come_back_in_srgb(pattern, depth, white, full):
    colour = np.array([0.2, 0.5, 0.8])
    kind = np.uint8 if depth == "8" else np.uint16
    linear = np.rint(np.broadcast_to(colour * white, (24, 32, 3))).astype(kind)
    picture = colours(mosaic(linear, pattern), f"Bayer{pattern}{depth}")
    assert picture.dtype == kind and picture.shape == (24, 32, 3)
    np.testing.assert_allclose(picture[4:-4, 4:-4] / full, np.broadcast_to(srgb_from_linear(colour), (16, 24, 3)), atol=1.5 / 255)


def test_a_smooth_picture_keeps_its_form():
    rows, columns = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 80), indexing="ij")
    light = np.stack([0.2 + 0.6 * columns, 0.3 + 0.5 * rows, 0.5 + 0.3 * np.sin(3 * columns)], -1)
    picture = colours(mosaic(np.rint(light * 4095).astype(np.uint16), "RG"), "BayerRG12") / 65535
    np.testing.assert_allclose(picture[2:-2, 2:-2], srgb_from_linear(light)[2:-2, 2:-2], atol=0.01)


def test_colour_formats_are_passed_on():
    raw = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    assert colours(raw, "RGB8") is raw
    padded = np.arange(48, dtype=np.uint8).reshape(2, 8, 3)[:, :4]  # rows as some cameras send them
    assert np.array_equal(colours(padded, "RGB8"), padded) and colours(padded, "RGB8").flags.c_contiguous
    assert colours(raw, "BGR8")[0, 0].tolist() == [2, 1, 0]
    with_alpha = np.arange(32, dtype=np.uint8).reshape(2, 4, 4)
    assert np.array_equal(colours(with_alpha, "RGBa8"), with_alpha[..., :3])


def test_format_is_the_one_that_the_sensor_has():
    assert choose_format("bayer12", ["Mono8", "BayerGB8", "BayerGB12"], where="camera") == "BayerGB12"
    with pytest.raises(
        CaptureError, match=r"camera does not send rgb8 .*offers Mono8, BayerGB8.*set camera.pixel_format to bayer8"
    ):
        choose_format("rgb8", ["Mono8", "BayerGB8"], where="camera")
    assert set(CANDIDATES) == {"rgb8", "bayer8", "bayer12", "mono8", "mono12"}
