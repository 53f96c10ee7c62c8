import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, rotate, uniform_filter1d

from koala3d.capture.recording.focus import luminance, sharpness


def picture(seed: int = 0, noise: float = 0.0) -> np.ndarray:
    """Plates of even brightness with edges half a pixel soft, 8 bits."""
    rng = np.random.default_rng(seed)
    plates = np.kron(rng.uniform(0.2, 0.9, (20, 20)), np.ones((12, 12)))
    soft = gaussian_filter(rotate(plates, 13, reshape=False, mode="reflect"), 0.5)
    return np.clip(255 * soft + rng.normal(0, noise, soft.shape), 0, 255).astype(np.uint8)[..., None].repeat(3, -1)


def moved(pixels: np.ndarray, length: int, axis: int) -> np.ndarray:
    return uniform_filter1d(pixels.astype(float), length, axis=axis).astype(np.uint8)


@pytest.mark.parametrize("axis", [0, 1])
def test_motion_along_either_axis_lowers_it(axis):
    still = picture()
    values = [sharpness(moved(still, length, axis)) for length in (1, 3, 6)]
    assert values[0] > 1.1 * values[1] > 1.2 * values[2]


def test_it_hardly_depends_on_what_is_seen_or_on_noise():
    clean = [sharpness(picture(seed)) for seed in range(5)]
    noisy = [sharpness(picture(seed, noise=2.0)) for seed in range(5)]
    assert np.ptp(clean) < 0.1 * np.mean(clean)
    np.testing.assert_allclose(noisy, clean, rtol=0.12)  # uncorrected, noise of two levels would add a quarter


def test_both_depths_give_the_same():
    pixels = picture()
    assert sharpness(pixels.astype(np.uint16) * 257) == pytest.approx(sharpness(pixels), rel=1e-4)
    assert luminance(np.full((4, 4, 3), 255, np.uint8)).max() == 1.0
