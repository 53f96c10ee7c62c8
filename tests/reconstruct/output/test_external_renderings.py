"""One ruler for our own renderings and for everybody else's."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging import images
from koala3d.reconstruct.output import evaluate, export, external_renderings
from koala3d.reconstruct.output.trained_model import TrainedModel
from tests.foreign import photographs


@pytest.fixture
def folder(ball: TrainedModel, tmp_path: Path) -> Path:
    """Our own renderings of the two test views."""
    export.render(ball, tmp_path / "renders")
    return tmp_path / "renders"


def test_renderings_on_disk_score_as_the_model_itself(
    ball: TrainedModel, folder: Path, tmp_path: Path, without_mesh: None
) -> None:
    """EXR maps are exact; 8 bits of colour cost at most 1/510 per value, far below errors that give some 30 dB."""
    ours = evaluate.evaluate(ball)["mean"]
    theirs = external_renderings.measure(folder, ball.scene, out=tmp_path / "their.json")
    assert theirs["views"] == 2 and theirs["size"] == [48, 40] and (tmp_path / "their.json").is_file()
    for name in ("depth_rmse_mm", "depth_median_mm", "disparity_rmse", "normal_mae_deg"):
        assert theirs["mean"][name] == pytest.approx(ours[name], rel=1e-5), name
    for name in ("psnr", "ssim", "diffuse_psnr", "specular_psnr", "normal_mae_alpha_acc_deg", "normal_pred_mae_deg"):
        assert theirs["mean"][name] == pytest.approx(ours[name], rel=0.02, abs=0.2), name
    assert evaluate.table(theirs).startswith("2 test views at 48x40\n")


def test_pictures_alone_in_one_folder_are_enough(ball: TrainedModel, folder: Path, tmp_path: Path) -> None:
    for path in (folder / "rgb").iterdir():
        small = images.resize(images.read(path), 24, 20)
        photographs.write(tmp_path / "plain" / path.name, images.to_uint8(small))
    found = external_renderings.measure(tmp_path / "plain", ball.scene)
    assert set(found["mean"]) == {"psnr", "ssim", "psnr_inside", "ssim_inside"}
    assert found["size"] == [24, 20] and found["mean"]["psnr"] > 20


def test_what_is_wrong_is_named(ball: TrainedModel, folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is not a folder"):
        external_renderings.measure(tmp_path / "none", ball.scene)
    (folder / "rgb" / "003.png").rename(tmp_path / "003.png")
    with pytest.raises(UsageError, match=r"no rendering of view 003; name it rgb/003\.png"):
        external_renderings.measure(folder, ball.scene)
    images.write(folder / "rgb" / "003.png", np.zeros((40, 40, 3)))
    with pytest.raises(DatasetError, match="view 003 has another aspect ratio than the view"):
        external_renderings.measure(folder, ball.scene)
    shutil.copy(tmp_path / "003.png", folder / "rgb" / "003.png")
    images.write(folder / "depth" / "003.exr", np.zeros((20, 24, 1), np.float32))
    with pytest.raises(DatasetError, match="depth of view 003 has another size"):
        external_renderings.measure(folder, ball.scene)
