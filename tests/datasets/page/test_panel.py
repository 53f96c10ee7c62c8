"""Pictures as they are sent to the browser."""

import numpy as np
import pytest

from koala3d.datasets.page.panel import bytes_of


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_every_kind_of_picture_becomes_three_channels(channels: int) -> None:
    sent = bytes_of(np.full((10, 20, channels), 0.5, np.float32), 8)
    assert sent.shape == (4, 8, 3) and sent.dtype == np.uint8
    expected = 0.5 if channels in (1, 3) else 0.75  # half of it white, where the alpha is a half
    assert np.abs(sent - 255 * expected).max() <= 1  # rounding, and the way to linear light and back


def test_small_pictures_keep_their_size_and_are_clipped() -> None:
    picture = np.array([[[-0.5, 0.25, 1.5]]], np.float32)
    assert bytes_of(picture, 640).tolist() == [[[0, 64, 255]]]
    assert bytes_of(np.array([[[1, 2, 255]]], np.uint8), 640).tolist() == [[[1, 2, 255]]]
    assert bytes_of(np.full((1, 1, 3), np.nan, np.float32), 640).tolist() == [[[0, 0, 0]]]
