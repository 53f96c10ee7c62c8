"""Grey cards in front of the rig with flaws, through pylon's emulation and real files."""

import pytest

from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.datasets.core.errors import UsageError
from tests.bench.colour import errors, lines

SMALL = ("camera.binning=4", "camera.width=96", "camera.height=64", "motion.settle_time_s=0.02", "split=null")


def session(pixel_format: str, *more: str) -> Trajectory:
    return load_trajectory("koala_demo", overrides=[*SMALL, f"camera.pixel_format={pixel_format}", *more])


@pytest.mark.parametrize("pixel_format", ["bayer12", "rgb8", "mono12"])
def test_a_grey_card_is_grey_and_even(pixel_format):
    corner = ("camera.offset_x=0", "camera.offset_y=0")  # where the lens darkens most
    found = errors(session(pixel_format, *corner), "sim_flawed", 8)
    coloured = pixel_format != "mono12"
    assert max(one.uneven_before for one in found) > 0.1  # the premise
    least = 0.09 if pixel_format == "bayer12" else 0.1  # its black level pales the darkest card
    assert not coloured or min(one.colour_before for one in found) > least
    assert max(one.colour for one in found) < 0.01 and max(one.uneven for one in found) < 0.01
    levels = [one.level for one in found]
    assert 0.5 < min(levels) and max(levels) / min(levels) < 1.02  # dark by the vignetting of the region's middle, and linear
    assert len(lines(found)) == 1 + len(found)


def test_only_a_simulation_knows_the_truth(tmp_path):
    with pytest.raises(UsageError, match="there is no rig 'flawed'"):
        errors(session("rgb8"), "flawed", 2)
