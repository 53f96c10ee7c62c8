import pytest

from koala3d.reconstruct.output import metric_names, metrics
from koala3d.reconstruct.output.mesh import surface_distance


def test_every_metric_has_unique_names_and_a_definition() -> None:
    for names in (metric_names.NAMES, metric_names.SHORT_NAMES):
        assert set(names) == {*metrics.DEFINITIONS, *surface_distance.DEFINITIONS} and len(set(names.values())) == len(names)
    assert all(metric_names.definition(key) for key in metric_names.NAMES)
    assert set(metric_names.NAMES) > metric_names.HIGHER_IS_BETTER


@pytest.mark.parametrize(("name", "heading"), [
    ("psnr", "PSNR [dB]"), ("ssim", "SSIM"), ("chamfer_mm", "mesh, Chamfer distance [mm]"), ("f_score", "mesh, F-score"),
])  # fmt: skip
def test_a_heading_has_the_unit_where_there_is_one(name: str, heading: str) -> None:
    assert metric_names.heading(name) == heading


@pytest.mark.parametrize(("name", "value", "text"), [
    ("psnr", 28.548, "28.55"), ("normal_mae_deg", 14.266, "14.3"), ("chamfer_mm", 1.84, "1.8"), ("chamfer_mm", 0.0348, "0.035"),
    ("ssim", 0.7893, "0.789"), ("disparity_rmse", 0.003536, "0.0035"), ("seconds", 2.3215, "2.32"),
    ("depth_median_mm", 0.0, "0.0"),
])  # fmt: skip
def test_values_have_the_digits_that_are_worth_reading(name: str, value: float, text: str) -> None:
    assert metric_names.rounded(name, value) == text
