import numpy as np
import pytest

from koala3d.reconstruct.output import metrics


def constant(value: float, channels: int = 3) -> np.ndarray:
    return np.full((16, 20, channels), value, np.float32)


def test_psnr_of_a_tenth_is_twenty_decibels() -> None:
    assert metrics.psnr(constant(0.5), constant(0.4)) == pytest.approx(20, abs=1e-5)  # mse 0.01; float32 inputs


def test_psnr_clips_both_pictures_and_is_bounded() -> None:
    assert metrics.psnr(constant(1.7), constant(1.2)) == 100
    assert metrics.psnr(constant(-3.0), constant(0.1)) == pytest.approx(20, abs=1e-5)


def test_ssim_of_constant_pictures_is_the_luminance_term() -> None:
    """Without variation SSIM is (2ab + c) / (a^2 + b^2 + c), c = 0.01^2."""
    expected = (2 * 0.5 * 0.3 + 1e-4) / (0.25 + 0.09 + 1e-4)
    assert metrics.ssim(constant(0.5), constant(0.3)) == pytest.approx(expected, abs=1e-5)
    assert metrics.ssim(constant(0.5), constant(0.5)) == pytest.approx(1)
    assert metrics.ssim(np.zeros((9, 30, 3)), np.zeros((9, 30, 3))) is None


def test_ssim_is_that_of_an_explicit_gaussian_window() -> None:
    """One pixel, far from the rim, by Wang's definition with an 11x11 window of sigma 1.5."""
    from skimage.metrics import structural_similarity

    rng = np.random.default_rng(0)
    first, second = rng.random((2, 31, 31, 1))
    offset = np.arange(-5, 6)
    window = np.exp(-(offset[:, None] ** 2 + offset**2) / (2 * 1.5**2))
    window /= window.sum()
    a, b = (picture[10:21, 10:21, 0] for picture in (first, second))
    mean = lambda values: (window * values).sum()  # noqa: E731
    covariance = lambda x, y: mean(x * y) - mean(x) * mean(y)  # noqa: E731
    expected = (2 * mean(a) * mean(b) + 1e-4) * (2 * covariance(a, b) + 9e-4)
    expected /= (mean(a) ** 2 + mean(b) ** 2 + 1e-4) * (covariance(a, a) + covariance(b, b) + 9e-4)
    _, everywhere = structural_similarity(first, second, data_range=1.0, channel_axis=-1, gaussian_weights=True, sigma=1.5,
                                          use_sample_covariance=False, full=True)  # fmt: skip
    assert everywhere[15, 15, 0] == pytest.approx(expected, abs=1e-10)
    assert metrics.ssim(first, second) == pytest.approx(everywhere[5:-5, 5:-5].mean(), abs=1e-10)


def test_inside_is_where_a_window_fits_into_the_mask() -> None:
    alpha = np.zeros((30, 40, 1), np.float32)
    alpha[4:25, 20:] = 0.6
    found = metrics.inside(alpha)
    assert found[9:20, 25:].all() and found.sum() == 11 * 15, "5 px from the edge; what is beyond the picture may be the object"
    assert not metrics.inside(np.full((30, 40, 1), 0.4)).any()


def test_chosen_pixels_alone_count() -> None:
    """An error of 0.1 on the left half only."""
    shown = np.zeros((16, 40), bool)
    shown[:, :14] = True
    wrong = np.where(np.arange(40)[:, None] < 20, 0.4, 0.5) * np.ones((16, 1, 3))
    assert metrics.psnr(wrong, np.full((16, 40, 3), 0.5), shown) == pytest.approx(20, abs=1e-5)
    assert metrics.psnr(wrong, np.full((16, 40, 3), 0.5), np.roll(shown, 26, 1)) == 100
    left, right = (metrics.ssim(wrong, np.full((16, 40, 3), 0.5), np.roll(shown, by, 1)) for by in (0, 26))
    assert left == pytest.approx((2 * 0.4 * 0.5 + 1e-4) / (0.16 + 0.25 + 1e-4), abs=1e-5) and right == pytest.approx(1)
    nothing = np.zeros((16, 40), bool)
    assert metrics.ssim(wrong, wrong, nothing) is None and metrics.psnr(wrong, wrong, nothing) is None


@pytest.mark.parametrize("angle", [0.0, 1e-4, 30.0, 90.0, 179.999, 180.0])
def test_angles_are_accurate_at_both_ends(angle: float) -> None:
    turned = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle)), 0])
    assert metrics.angles_deg(np.array([1.0, 0, 0]), turned) == pytest.approx(angle, abs=1e-9)


def test_a_normal_that_was_not_rendered_is_a_right_angle_off() -> None:
    assert metrics.angles_deg(np.zeros(3), np.array([0, 0, 1.0])) == pytest.approx(90)


def test_normal_error_weighs_and_leaves_out() -> None:
    """Three pixels: 0 deg with weight 1, 90 deg with weight 0.5, and one without a true normal."""
    truth = np.array([[[0, 0, 1.0], [0, 0, 1.0], [0, 0, 0]]])
    rendered = np.array([[[0, 0, 1.0], [1.0, 0, 0], [1.0, 0, 0]]])
    weight = np.array([[[1.0], [0.5], [1.0]]])
    assert metrics.normal_mae_deg(rendered, truth, weight) == pytest.approx(45 / 1.5)
    assert metrics.normal_mae_deg(rendered, truth, 0 * weight) is None


def test_disparity_and_depth_errors_by_hand() -> None:
    """Depths 1 and 3 m against 1 and 1 m: disparities 0.5 and 0.25 against 0.5 and 0.5."""
    rendered, truth = np.array([[[1.0], [3.0], [9.0]]]), np.array([[[1.0], [1.0], [1.0]]])
    shown = np.array([[True, True, False]])
    assert metrics.disparity_rmse(rendered, truth, shown) == pytest.approx(0.25 / np.sqrt(2))
    assert metrics.depth_errors_mm(rendered, truth, shown) == pytest.approx((2000 / np.sqrt(2), 1000))
    assert metrics.disparity_rmse(rendered, truth, ~shown & False) is None
    assert metrics.depth_errors_mm(rendered, truth, ~shown & False) is None


def test_every_figure_says_its_unit() -> None:
    for name, (unit, meaning) in metrics.DEFINITIONS.items():
        assert meaning and name.endswith("_mm") == (unit == "mm") and name.endswith("_deg") == (unit == "deg")
