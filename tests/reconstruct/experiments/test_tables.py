import csv
import io
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments import tables
from koala3d.reconstruct.experiments.results import Row

ROWS = [
    Row("car", "zip_refnerf", {"psnr": 30.371, "ssim": 0.955, "normal_mae_alpha_acc_deg": 16.37, "disparity_rmse": 0.205}),
    Row("car", "surfnerf", {"psnr": 29.854, "ssim": 0.9552, "normal_mae_alpha_acc_deg": 11.08, "disparity_rmse": None}),
    Row("toaster", "surfnerf", {"psnr": 20.76, "ssim": 0.869, "normal_mae_alpha_acc_deg": 20.55}),
]
COLUMNS = ["psnr", "ssim", "normal_mae_alpha_acc_deg", "disparity_rmse"]


def test_markdown_has_a_block_per_scene_and_the_best_bold() -> None:
    lines = tables.markdown(ROWS, COLUMNS).splitlines()
    assert lines[0] == "| scene | model | PSNR [dB] | SSIM | MAE (alpha × opacity) [deg] | RMSE |"
    assert lines[2] == "| car | zip_refnerf | **30.37** | 0.955 | 16.37 | 0.205 |"
    assert lines[3] == "|  | surfnerf | 29.85 | **0.955** | **11.08** | – |"
    assert lines[4] == "| toaster | surfnerf | 20.76 | 0.869 | 20.55 | – |"
    assert any("weighted by true alpha times rendered opacity" in line for line in lines[5:])


def test_meshes_that_were_measured_in_part_are_named_where_they_are_shown() -> None:
    rows = [
        Row("car", "surfnerf", {"chamfer_mm": 1.0, "psnr": 30.0}, "-z"),
        Row("car", "zipnerf", {"chamfer_mm": 2.0, "psnr": 29.0}),
    ]
    named = "car, surfnerf: the mesh of the object that stands on -z, without whatever else enters the box"
    assert tables.notes(rows, ["psnr", "chamfer_mm"])[2:] == [named]
    assert f"* {named}" in tables.markdown(rows, ["chamfer_mm"]) and f"% {named}" in tables.latex(rows, ["chamfer_mm"])
    assert named not in tables.markdown(rows, ["psnr"]), "no figure of a mesh is shown"


def test_latex_has_the_paper_s_layout() -> None:
    text = tables.latex(ROWS, COLUMNS)
    assert r"\multirow{2}{*}{car} & zip\_refnerf & \textbf{30.37} & 0.955 & 16.37 & 0.205 \\" in text
    assert text.count(r"\midrule") == 2 and text.count(r"\begin{tabular}{llrrrr}") == 1 == text.count(r"\bottomrule")
    assert r"MAE (alpha $\times$ opacity) [deg]" in text


def test_csv_keeps_all_digits() -> None:
    read = list(csv.DictReader(io.StringIO(tables.csv_text(ROWS, COLUMNS))))
    assert [float(row["psnr"]) for row in read] == [30.371, 29.854, 20.76]
    assert read[2]["disparity_rmse"] == "" and read[0]["model"] == "zip_refnerf"


def test_columns_without_values_are_left_out_and_wrong_ones_refused() -> None:
    assert tables.chosen_columns(ROWS) == COLUMNS
    assert tables.chosen_columns(ROWS, ["ssim", "chamfer_mm"]) == ["ssim"]
    with pytest.raises(UsageError, match="did you mean 'psnr'"):
        tables.chosen_columns(ROWS, ["psrn"])


def test_deviations_over_seeds_stand_beside_their_means() -> None:
    rows = [ROWS[0], Row("car", "surfnerf", {"psnr": 31.0, "ssim": None}, deviations={"psnr": 0.25}, seeds=3)]
    columns = ["psnr", "ssim"]
    lines = tables.markdown(rows, columns).splitlines()
    assert lines[3] == "|  | surfnerf | **31.00 ± 0.25** | – |"
    assert lines[-1] == "* mean ± standard deviation over 1 to 3 seeds"
    assert r"\textbf{31.00 $\pm$ 0.25}" in tables.latex(rows, columns)
    read = list(csv.DictReader(io.StringIO(tables.csv_text(rows, columns))))
    assert [row["psnr_std"] for row in read] == ["", "0.25"] and [row["seeds"] for row in read] == ["", "3"]


def test_files_are_written_once_and_in_a_form_that_is_known(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        tables.refuse_other(tmp_path / "t.csv", tuple(tables.FORMATS))
    with pytest.raises(UsageError, match=r"end --out in \.md, \.csv, \.tex"):
        tables.refuse_other(tmp_path / "t.html", tuple(tables.FORMATS))
