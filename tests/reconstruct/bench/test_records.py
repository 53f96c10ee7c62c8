"""Records survive a kill, come back as they were, and say which trials are done."""

from collections.abc import Callable
from pathlib import Path

import pytest

from koala3d.datasets.core.errors import DatasetError
from koala3d.reconstruct.bench.records import COLUMNS, Records, latest
from koala3d.reconstruct.bench.suite import Trial

TRIAL = Trial("quality", "chrome_ball", 1.0, 0, "surfnerf", "fast", 15.0, 0)


def test_rows_come_back(tmp_path: Path, make_row: Callable) -> None:
    records = Records(tmp_path / "deep" / "records.csv")
    records.append(make_row(psnr=25.125, machine="a, b"))
    records.append(make_row(seed=1, psnr=None))
    first, second = records.rows()
    assert first["psnr"] == 25.125 and first["machine"] == "a, b" and first["ssim"] is None
    assert second["psnr"] is None and second["seed"] == 1
    assert records.done() == {TRIAL.key, (*TRIAL.key[:-1], "1")}


def test_a_line_cut_off_by_a_kill_is_written_over(tmp_path: Path, make_row: Callable) -> None:
    records = Records(tmp_path / "records.csv")
    records.append(make_row())
    whole = records.path.read_bytes()
    records.path.write_bytes(whole + b"quality,chrome_ball,1,0,surfn")
    assert len(records.rows()) == 1
    records.append(make_row(seed=1))
    assert [row["seed"] for row in records.rows()] == [0, 1]
    assert records.path.read_bytes().startswith(whole)


def test_a_header_cut_off_is_written_again(tmp_path: Path, make_row: Callable) -> None:
    records = Records(tmp_path / "records.csv")
    records.path.write_text(",".join(COLUMNS)[:50])
    assert records.rows() == []
    records.append(make_row())
    assert len(records.rows()) == 1


def test_failed_trials_are_not_done_and_later_rows_count(tmp_path: Path, make_row: Callable) -> None:
    records = Records(tmp_path / "records.csv")
    records.append(make_row(status="failed: no memory", psnr=None))
    assert records.done() == set()
    records.append(make_row(psnr=20.0))
    records.append(make_row(psnr=21.0))
    assert [row["psnr"] for row in latest(records.rows())] == [21.0]


def test_other_columns_are_refused(tmp_path: Path) -> None:
    (tmp_path / "records.csv").write_text("scene,psnr\nball,20\n")
    with pytest.raises(DatasetError, match="columns differ"):
        Records(tmp_path / "records.csv").rows()


def test_records_from_before_a_metric_are_read_but_not_continued(tmp_path: Path, make_row: Callable) -> None:
    records = Records(tmp_path / "records.csv")
    records.append(make_row(psnr=20.0))
    lines = [line.split(",") for line in records.path.read_text().splitlines()]
    place = lines[0].index("psnr_inside")
    records.path.write_text("".join(",".join(line[:place] + line[place + 1 :]) + "\n" for line in lines))
    (row,) = records.rows()
    assert row["psnr"] == 20.0 and row["psnr_inside"] is None and row["ssim_inside"] is None
    with pytest.raises(DatasetError, match="psnr_inside"):
        records.append(make_row())
