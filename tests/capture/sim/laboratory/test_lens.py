import numpy as np
import pytest

from koala3d.capture.sim.laboratory.lens import Lens, Sensor, strips
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging.region import Region

LENS = Camera(60, 48, 62.0, 62.4, 31.7, 22.9, k1=-0.12, k2=0.06, p1=1e-3, p2=-8e-4, k3=-0.01)


def pinhole_directions(lens: Lens) -> np.ndarray:
    return lens.pinhole.directions(lens.pinhole.pixel_centres())


def test_pinhole_of_a_corner_of_the_sensor_is_no_larger_than_needed():
    corner = Region(40, 40, 0, 0, 4).camera(Camera(1920, 1080, 1270.0, 1270.0, 950.0, 548.0, k1=-0.11, k2=0.05))
    assert Lens(corner, 1).pinhole.width < 1.6 * 40  # the lens compresses the corner


@pytest.mark.parametrize("supersampling", [1, 2, 4])
def test_pinhole_sees_all_that_the_lens_sees(supersampling):
    lens = Lens(LENS, supersampling)
    border = np.array([[0, 0], [60, 0], [0, 48], [60, 48], [30, 0], [0, 24]], float)
    pixels = lens.pinhole.project(LENS.directions(border))
    assert (pixels > 1).all() and (pixels < np.array([lens.pinhole.width, lens.pinhole.height]) - 1).all()


def test_pinholes_of_two_finenesses_cover_the_same():
    coarse, fine = Lens(LENS, 2).pinhole, Lens(LENS, 4).pinhole
    assert fine == coarse.scaled(2 * coarse.width, 2 * coarse.height)


def test_even_light_stays_even():
    lens = Lens(LENS)
    picture = np.full((lens.pinhole.height, lens.pinhole.width, 3), 0.37, np.float32)
    np.testing.assert_allclose(lens.image(picture), 0.37, rtol=1e-6)  # float32


def test_each_pixel_shows_what_lies_along_its_own_ray():
    """A picture of the ray's own slopes: linear, so averaging and interpolation are exact up to the lens's curvature."""
    lens = Lens(LENS)
    seen = lens.image(pinhole_directions(lens)[..., :2].astype(np.float32))
    wanted = LENS.directions(LENS.pixel_centres())[..., :2]
    assert np.abs(seen - wanted).max() * LENS.fx < 0.01  # px; the mean over a pixel is not quite the slope at its middle


def test_strips_see_every_row_of_a_pinhole_once_and_the_same():
    pinhole = Lens(LENS).pinhole
    parts = list(strips(pinhole, 7 * pinhole.width + 3))
    assert len(parts) > 2 and max(part.height for _, part in parts) == 7
    rows = np.concatenate([np.arange(pinhole.height)[chosen] for chosen, _ in parts])
    assert np.array_equal(rows, np.arange(pinhole.height))
    seen = np.concatenate([part.directions(part.pixel_centres()) for _, part in parts])
    np.testing.assert_allclose(seen, pinhole.directions(pinhole.pixel_centres()), atol=1e-12)
    assert [part.height for _, part in strips(pinhole, 1)] == [1] * pinhole.height  # a row is the least


def test_middles_are_the_means_of_places():
    lens = Lens(LENS)
    np.testing.assert_allclose(np.mean(list(lens.places()), axis=0), lens.middles(), atol=1e-9)


def photons(radiance: float, rng: np.random.Generator, **settings: float) -> np.ndarray:
    return Sensor().expose(
        np.full((200, 200, 3), radiance, np.float32), rng=rng, **{"exposure_us": 10000, "gain_db": 0, "binning": 1, **settings}
    )


def linear(pixels: np.ndarray) -> np.ndarray:
    from koala3d.datasets.imaging.images import linear_from_srgb

    return linear_from_srgb(pixels / 255.0)


def test_exposure_and_gain_scale_light():
    rng = np.random.default_rng(0)
    once = linear(photons(0.3, rng)).mean()
    assert once == pytest.approx(0.3 / Sensor().saturation, rel=0.01)  # eight bits
    assert linear(photons(0.3, rng, exposure_us=20000)).mean() == pytest.approx(2 * once, rel=0.01)
    assert linear(photons(0.3, rng, gain_db=6.0206)).mean() == pytest.approx(2 * once, rel=0.01)


def test_noise_is_that_of_counting_electrons():
    sensor = Sensor()
    for binning in (1, 4):
        spread = linear(photons(0.6, np.random.default_rng(1), binning=binning)).std()
        electrons = 0.4 * sensor.full_well
        wanted = np.sqrt(electrons + sensor.read_noise**2) / sensor.full_well / binning
        rounding = 1 / 255 / np.sqrt(12) * 1.4  # slope of the sRGB curve at 0.4 is 1 / 0.72
        assert spread == pytest.approx(np.hypot(wanted, rounding), rel=0.1)  # the slope varies over the spread


def test_columns_that_are_added_up_are_brighter_at_the_same_time_and_noisier_at_the_same_brightness():
    rng, whole = np.random.default_rng(1), {"binning": 4, "raw_bits": 12}
    average, longer = photons(0.3, rng, **whole), photons(0.3, rng, **whole, binning_gain=4)
    shorter = photons(0.3, rng, **whole, binning_gain=4, exposure_us=2500)
    assert longer.mean() == pytest.approx(4 * average.mean(), rel=1e-3)
    assert shorter.mean() == pytest.approx(average.mean(), rel=1e-3)
    assert shorter.std() == pytest.approx(2 * average.std(), rel=0.05)  # a quarter of the electrons


@pytest.mark.parametrize("bits", [8, 12])
def test_raw_numbers_are_linear_and_have_their_bits(bits):
    pixels = photons(0.6, np.random.default_rng(1), raw_bits=bits)
    assert pixels.dtype == np.uint16 and not (pixels & (2 ** (16 - bits) - 1)).any()
    assert (pixels >> (16 - bits)).mean() / (2**bits - 1) == pytest.approx(0.4, rel=1e-3)  # 120 000 draws of 1 % noise


def test_white_is_where_the_picture_clips():
    sensor = Sensor()
    assert sensor.white(20000, 6.0206) == pytest.approx(sensor.saturation / 4, rel=1e-4)
    assert photons(1.01 * sensor.white(10000, 0), np.random.default_rng(2)).min() > 245  # shot noise of a full well is 1 %


def test_same_seed_same_picture():
    assert np.array_equal(photons(0.2, np.random.default_rng(5)), photons(0.2, np.random.default_rng(5)))
    assert not np.array_equal(photons(0.2, np.random.default_rng(5)), photons(0.2, np.random.default_rng(6)))
