from pathlib import Path

import pytest

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments.results import Origin, Result
from tests.bench.curve import table

WORK = {"steps": 512, "training_s": 5.04, "preparation_s": 2.0, "compilation_s": 3.25}


def result(tmp_path: Path, seed: int, budget_s: float, **figures: object) -> None:
    evaluation = {"mean": {"psnr": 27.126}, "size": [200, 200], **figures}
    path = tmp_path / "lego" / "surfnerf" / f"base_{budget_s:g}" / f"seed_{seed}.json"
    files.make_folder(path.parent)
    files.write_json(
        path, Result(path, "lego", Origin("surfnerf", "fast", "base", budget_s), seed, {}, evaluation, WORK).content()
    )


def test_rows_are_in_the_order_of_time(tmp_path: Path) -> None:
    result(tmp_path, 0, 60.0)
    mean = {"psnr": 30.0, "normal_mae_alpha_acc_deg": 4.5}
    result(tmp_path, 1, 5.0, mean=mean, mesh={"chamfer_mm": 0.25})
    lines = table([tmp_path]).splitlines()
    assert lines[0].startswith("scene,width_px,seed,budget_s,")
    assert lines[1:] == ["lego,200,1,5,5.0,5.2,512,30.00,4.50,0.250", "lego,200,0,60,5.0,5.2,512,27.13,,"]


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="hold no results"):
        table([tmp_path])
