import numpy as np
import pytest

from koala3d.datasets.radiometry.mosaic import FIRST, colour_indices, demosaiced, pattern_of, tiled


@pytest.mark.parametrize("pattern", FIRST)
def test_even_light_comes_back_also_above_white(pattern):
    colour = np.array([0.3, 5.0, 0.02], np.float32)
    mosaic = tiled(colour[colour_indices(pattern)], 24, 30)[..., 0]
    picture = demosaiced(mosaic, pattern)
    np.testing.assert_allclose(picture[4:-4, 4:-4], np.broadcast_to(colour, (16, 22, 3)), atol=5 / 65535)


def test_light_below_white_keeps_fine_steps_beside_a_highlight():
    mosaic = np.full((40, 40), 0.0101, np.float32)
    mosaic[:8, :8] = 500.0  # alone it would make steps of 500 / 65535 = 0.0076
    picture = demosaiced(mosaic, "RG")
    np.testing.assert_allclose(picture[16:, 16:], 0.0101, atol=1 / 65535)
    assert picture[2:5, 2:5].min() == pytest.approx(500, rel=1e-3)


def test_only_raw_formats_have_a_pattern():
    assert [pattern_of(name) for name in ("BayerGB12", "Mono12", "RGB8Packed")] == ["GB", "", ""]
