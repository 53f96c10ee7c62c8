import pytest

from reconstruct.output import metrics, surface_distance, words


def test_every_figure_has_a_name_of_its_own() -> None:
    assert set(words.NAMES) == {*metrics.DEFINITIONS, *surface_distance.DEFINITIONS}
    assert len(set(words.NAMES.values())) == len(words.NAMES)


@pytest.mark.parametrize(("name", "heading"), [
    ("psnr", "PSNR [dB]"), ("ssim", "SSIM"), ("chamfer_mm", "mesh, Chamfer distance [mm]"), ("f_score", "mesh, F-score"),
])  # fmt: skip
def test_a_heading_has_the_unit_where_there_is_one(name: str, heading: str) -> None:
    assert words.heading(name) == heading


@pytest.mark.parametrize(("name", "value", "text"), [
    ("psnr", 28.548, "28.55"), ("normal_mae_deg", 14.266, "14.3"), ("chamfer_mm", 1.84, "1.8"), ("chamfer_mm", 0.0348, "0.035"),
    ("ssim", 0.7893, "0.789"), ("disparity_rmse", 0.003536, "0.0035"), ("seconds", 2.3215, "2.32"), ("depth_median_mm", 0.0, "0.0"),
])  # fmt: skip
def test_values_have_the_digits_that_are_worth_reading(name: str, value: float, text: str) -> None:
    assert words.rounded(name, value) == text
