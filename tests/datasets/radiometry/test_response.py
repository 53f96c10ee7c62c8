"""A sensor with known flaws is measured from its pictures; the measurement undoes them and knows its camera."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.radiometry.measure import Statistics, response
from koala3d.datasets.radiometry.mosaic import colour_indices, tiled
from koala3d.datasets.radiometry.response import Response

HEIGHT, WIDTH = 40, 56
BLACK, SHOT, READ = 0.02, 1 / 20000, 0.001
SENSOR = {"RG": (0.6, 1.0, 0.75), "": (1.0,)}
HOT = ((3, 4), (3, 6), (20, 31), (39, 55))


def seen(light: float, pattern: str) -> np.ndarray:
    """(height, width, 1) signal of an evenly lit card."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    fall = 1 - 0.4 * ((rows - 20) ** 2 + (columns - 28) ** 2) / (20**2 + 28**2)
    filters = np.array(SENSOR[pattern])[colour_indices(pattern)] if pattern else np.ones((1, 1, 1))
    return light * fall[..., None] * tiled(filters, HEIGHT, WIDTH)


def picture(light: float, pattern: str, seed: int) -> np.ndarray:
    rng, signal = np.random.default_rng(seed), seen(light, pattern)
    for row, column in HOT:
        signal[row, column] += 0.3
    noisy = signal + rng.normal(0, 1, signal.shape) * np.sqrt(READ**2 + SHOT * signal)
    return (np.rint(np.clip(BLACK + noisy, 0, 1) * 4095) / 4095).astype(np.float32)


def measured(pattern: str, count: int = 40) -> Response:
    dark = Statistics.of(picture(0.0, pattern, seed) for seed in range(count))
    card = Statistics.of(picture(0.6, pattern, 1000 + seed) for seed in range(count))
    name = f"Bayer{pattern}12" if pattern else "Mono12"
    about = {"serial": "42", "pixel_format": name, "region": Region(WIDTH, HEIGHT, 2, 4), "gain_db": 1.0, "raw": True}
    return response(dark, card, **about)


@pytest.mark.parametrize("pattern", SENSOR)
def test_a_sensor_is_measured_and_undone(pattern):
    found = measured(pattern)
    np.testing.assert_allclose(found.black, BLACK, atol=READ / np.sqrt(40))
    assert {tuple(place) for place in found.hot.tolist()} == set(HOT)
    assert found.shot == pytest.approx(SHOT, rel=0.05) and found.read == pytest.approx(READ, rel=0.05)
    if pattern:
        np.testing.assert_allclose(found.balance.ravel(), [1 / 0.6, 1, 1, 1 / 0.75], rtol=2e-3)
    light = found.light(found.signal(picture(0.4, pattern, 7)))
    blocks = light[:, :, 0].reshape(4, 10, 4, 14).mean(axis=(1, 3))
    np.testing.assert_allclose(blocks, blocks.mean(), rtol=0.005)  # also where there are hot pixels and in the corners
    assert light.mean() == pytest.approx(0.4 / (1 - BLACK), rel=0.01)  # 1 in the middle, of which the median is taken
    assert np.abs(light / light.mean() - 1).max() < 0.1  # a hot pixel would be off by 75 %


def test_a_file_reads_back_bit_for_bit(tmp_path: Path):
    found = measured("RG", 3)
    found.save(tmp_path / "flat.npz")
    again = Response.load(tmp_path / "flat.npz")
    for name, value in vars(found).items():
        assert np.array_equal(getattr(again, name), value), name


def test_a_changed_file_is_refused(tmp_path: Path):
    measured("", 3).save(tmp_path / "flat.npz")
    parts = dict(np.load(tmp_path / "flat.npz"))
    np.savez(tmp_path / "other.npz", **{**parts, "flat": parts["flat"] * np.float16(1.01)})
    with pytest.raises(DatasetError, match="checksum is wrong"):
        Response.load(tmp_path / "other.npz")
    about = json.loads(str(parts["about"]))
    np.savez(tmp_path / "newer.npz", **{**parts, "about": np.array(json.dumps({**about, "version": 2}))})
    with pytest.raises(DatasetError, match="koala-radiometry version 2 cannot be read"):
        Response.load(tmp_path / "newer.npz")
    np.savez(tmp_path / "points.npz", points=np.zeros(3))
    with pytest.raises(DatasetError, match="is not a measured response"):
        Response.load(tmp_path / "points.npz")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"serial": "43"}, "another serial number.*measured with 42, recorded with 43"),
        ({"pixel_format": "BayerRG8"}, "another pixel format"),
        ({"region": Region(WIDTH, HEIGHT, 0, 4).to_json()}, "another sensor region"),
        ({"gain_db": 6.0}, "another gain"),
    ],
)
def test_another_camera_is_refused(changed, words):
    found = measured("RG", 3)
    camera = {"serial": "42", "pixel_format": "BayerRG12", "region": found.region.to_json(), "gain_db": 1.0}
    found.of_camera(camera, where="flat.npz")
    with pytest.raises(UsageError, match=words):
        found.of_camera({**camera, **changed}, where="flat.npz")


def test_it_follows_the_black_level_of_the_camera(tmp_path):
    found = replace(measured("RG", 3), black_level=64 / 4095)
    found.save(tmp_path / "flat.npz")
    camera = {"serial": "42", "pixel_format": "BayerRG12", "region": found.region.to_json(), "gain_db": 1.0}
    there = Response.load(tmp_path / "flat.npz").of_camera({**camera, "black_level": 16 / 4095}, where="flat.npz")
    np.testing.assert_allclose(there.black, found.black - 48 / 4095)
    before = Response.load(tmp_path / "flat.npz").of_camera(camera, where="flat.npz")  # cameras did not say it
    np.testing.assert_allclose(before.black, found.black - 64 / 4095)


def test_bad_pictures_are_refused():
    good = {"serial": "", "pixel_format": "Mono12", "region": Region(WIDTH, HEIGHT), "gain_db": 0.0, "raw": True}
    dark, bright = (Statistics.of(picture(light, "", seed) for seed in range(3)) for light in (0.0, 0.99))
    with pytest.raises(UsageError, match="too dark or too bright"):
        response(dark, bright, **good)
    with pytest.raises(UsageError, match=r"light fell into the dark pictures .*cover the lens"):
        response(bright, bright, **good)
    with pytest.raises(UsageError, match="too few pictures"):
        Statistics.of([picture(0.5, "", 0)])


def test_a_hot_pixel_without_good_neighbours_stays():
    found = replace(measured("", 3), hot=np.argwhere(np.ones((HEIGHT, WIDTH))).astype(np.int32))
    values = picture(0.4, "", 1)
    assert np.array_equal(found.signal(values), ((values - found.black) / (1 - found.black)).astype(np.float32))
