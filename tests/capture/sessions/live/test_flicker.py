import numpy as np
import pytest

from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.flaws import Flaws, lamp_light
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.rig.cameras import camera_for
from koala3d.capture.sessions.live.analysis import Look, Part
from koala3d.capture.sessions.live.balance import white_balance
from koala3d.capture.sessions.live.flicker import FREQUENCIES_HZ, Flicker, burst, flicker
from koala3d.datasets.radiometry.response import Response

SMALL = ("camera.width=64", "camera.height=48")


def observed(hz: float, depth: float, exposure_us: float, *, rolling_s: float = 0.0, noise: float = 1e-4) -> Flicker:
    """The flicker of 60 computed pictures, whose bands are exposed one after the other."""
    rng, flaws = np.random.default_rng(0), Flaws(flicker_hz=hz, flicker=depth)
    times = np.cumsum(0.05 + rng.uniform(0, 0.01, 60))
    bands = rolling_s * np.arange(8) / 8
    levels = np.array([[lamp_light(flaws, t + later, 1e-6 * exposure_us) for later in bands] for t in times])
    return flicker(times, 0.4 * (levels + rng.normal(0, noise, levels.shape)), exposure_us)


@pytest.mark.parametrize("rolling_s", [0.0, 0.03])
@pytest.mark.parametrize("hz", FREQUENCIES_HZ)
def test_frequency_and_depth_are_found(hz, rolling_s):
    """Also with a rolling shutter, whose 30 ms hold three periods, which cancel in the mean of the picture."""
    found = observed(hz, 0.3, 3000.0, rolling_s=rolling_s)
    assert found.is_seen and found.hz == hz
    assert found.amplitude == pytest.approx(0.3 * np.sinc(hz * 0.003), rel=0.01)
    assert found.of_lamps == pytest.approx(0.3, rel=0.01) and found.quiet_us == pytest.approx(1e6 / hz)


@pytest.mark.parametrize("exposure_us", [10_000.0, 20_000.0])
def test_whole_half_waves_see_no_flicker(exposure_us):
    found = observed(100.0, 0.5, exposure_us)
    assert not found.is_seen and "none seen" in found.line
    assert observed(100.0, 0.5, exposure_us * 1.07).is_seen  # the premise


def test_what_the_exposure_averages_away_says_nothing_of_the_lamps():
    assert Flicker(100.0, 0.01, 0.001, 10_100.0).of_lamps is None


def test_steady_light_does_not_flicker():
    assert not observed(100.0, 0.0, 3000.0, noise=0.01).is_seen


def test_a_burst_of_the_emulated_camera_shows_the_lamps(tmp_path):
    (tmp_path / "rig.yaml").write_text("simulation: {flaws: {flicker: 0.25, flicker_hz: 120}}")
    session = load_trajectory("koala_demo", overrides=[*SMALL, "camera.exposure_us=3000"])
    with camera_for(str(tmp_path / "rig.yaml"), session, scene="grey_card") as camera:
        found = flicker(*burst(camera, Part(8, 8, 56, 40), 24))
    assert found.is_seen and found.hz == 120 and found.of_lamps == pytest.approx(0.25, rel=0.1)


def test_a_suggested_exposure_is_right_and_stays_so():
    session = load_trajectory("koala_demo", overrides=[*SMALL, "camera.exposure_us=2000"])
    with camera_for("sim", session, scene="grey_card") as camera:
        part = Part.middle(64, 48)
        dark = Look.at(camera.grab(), part)
        camera.set_exposure(dark.suggested_us)
        right = Look.at(camera.grab(), part)
        camera.set_exposure(40_000)
        bright = Look.at(camera.grab(), part)
    assert right.suggested_us == pytest.approx(right.exposure_us, rel=0.03) and right.clipped == 0
    assert bright.too_bright and bright.clipped == 1 and bright.suggested_us == pytest.approx(40_005 / 8)
    assert "too bright" in bright.lines[2]


def test_focus_falls_with_blur():
    from scipy.ndimage import gaussian_filter

    sharp = np.random.default_rng(0).uniform(0.2, 0.8, (48, 64, 3)) * 255
    looks = [
        Look.at(Image(gaussian_filter(sharp, (blur, blur, 0)).astype(np.uint8), 1e4, 0.0, 0, 0), Part(0, 0, 64, 48))
        for blur in (0.7, 1.5, 3.0)
    ]
    assert looks[0].focus > looks[1].focus > looks[2].focus


def test_a_stored_balance_belongs_to_its_camera(tmp_path):
    session = load_trajectory("koala_demo", overrides=[*SMALL, "camera.pixel_format=bayer12"])
    with camera_for("sim_flawed", session, scene="grey_card") as camera:
        found = white_balance(camera, Part.middle(64, 48))
        found.save(tmp_path / "balance.npz")
        Response.load(tmp_path / "balance.npz").of_camera(camera.description(), where="balance.npz")
        again = white_balance(camera, Part.middle(64, 48), str(tmp_path / "balance.npz"))
    # without a black level, 1.6 % of white are counted as light: (0.6 + 0.016) / (0.62 * 0.6 + 0.016)
    np.testing.assert_allclose(found.balance.ravel(), [1.588, 1, 1, 1.339], rtol=0.01)
    np.testing.assert_allclose(again.balance, found.balance, rtol=1e-3)
