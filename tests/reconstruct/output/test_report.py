import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.residuals import Residuals
from koala3d.reconstruct.output import evaluate, report
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.training.decisions import record
from koala3d.reconstruct.training.decisions.skip import Skip


def test_the_page_stands_alone_and_shows_figures_and_pictures(ball: TrainedModel, tmp_path: Path) -> None:
    result = report.write(ball, tmp_path / "report")
    page = (tmp_path / "report" / "index.html").read_text()
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page), "nothing is loaded from elsewhere"
    assert page.count("<img") == 2 * 5 * 2, "two views, five channels, truth and rendering"
    assert page.count('<div class="wipe">') == 10
    assert f"{result['mean']['psnr']:.2f} dB" in page and "<svg" in page and "Chamfer" in page
    headline = re.search(r'<div class="headline">(.*?)</div></div>', page)[1]
    assert "depth, median error" in headline and "RMS" not in headline and "Chamfer" in headline, (
        "one outlier spoils a root mean square"
    )
    assert "depth, RMS error" in page
    assert f"reconstruct eval {ball.run.path}" in page and "made for a test" in page and "$" not in page
    assert (ball.run.path / "metrics.json").is_file(), "the run was measured"
    strip = images.read(tmp_path / "report" / "strip.png")
    assert strip.shape[0] == 40 and strip.shape[1] > 5 * 48


@pytest.fixture
def no_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes, which take longer than all the rest, are not measured."""
    monkeypatch.setattr(evaluate, "TRUE_SURFACE", "no mesh")


@pytest.mark.usefixtures("no_mesh")
def test_figures_are_taken_over_while_they_are_of_this_state(ball: TrainedModel, tmp_path: Path) -> None:
    written = evaluate.evaluate(ball)
    written["mean"]["psnr"] = 12.345
    files.write_json(ball.run.path / "metrics.json", written | {"mesh_stands_on": "-z", "mesh": {"chamfer_mm": 0.5}})
    assert report.write(ball, tmp_path / "first")["mean"]["psnr"] == 12.345
    page = (tmp_path / "first" / "index.html").read_text()
    assert "Of the mesh of the object that stands on -z, without whatever else enters the box." in page
    assert f"reconstruct eval {ball.run.path} --stands-on -z" in page
    later = replace(ball, step=ball.step + 1)
    assert report.write(later, tmp_path / "second")["mean"]["psnr"] != 12.345
    assert "any side but" not in (tmp_path / "second" / "index.html").read_text()


def test_it_never_overwrites(ball: TrainedModel, tmp_path: Path) -> None:
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "mine").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        report.write(ball, tmp_path / "report")


@pytest.mark.usefixtures("no_mesh")
def test_calibration_is_shown_with_its_error(ball: TrainedModel, tmp_path: Path, simulated_session: Callable[..., Path]) -> None:
    camera = Camera(48, 40, 70.0, 70.0, 24.0, 20.0)
    recording = simulated_session(tmp_path / "board", hand_eye_shift_mm=0.25)
    found = Calibration(camera, {}, UncertainPose(np.eye(4), np.eye(6)), residuals=Residuals(held_out_px=0.125),
                        provenance={"recording": str(recording)})  # fmt: skip
    found.save(tmp_path / "calibration.json")
    report.write(ball, tmp_path / "report", calibration=tmp_path / "calibration.json")
    page = (tmp_path / "report" / "index.html").read_text()
    assert ">0.2500<" in page and "hand-eye pose, position" in page and ">0.1250<" in page


def test_channels_stand_beside_their_truth(ball: TrainedModel) -> None:
    view = ball.scene.split("test")[0]
    pairs = report.side_by_side(evaluate.read_truth(view, view.camera), ball.picture(view))
    assert list(pairs) == ["colour", "normals", "depth", "diffuse", "specular"]
    for truth, rendered in pairs.values():
        assert truth is not None and truth.shape[:2] == rendered.shape[:2] and np.abs(truth - rendered).mean() < 0.05
    unknown = report.side_by_side({"rgb": pairs["colour"][0]}, ball.picture(view))
    assert [name for name, (truth, _) in unknown.items() if truth is None] == ["normals", "depth", "diffuse", "specular"]


@pytest.mark.usefixtures("no_mesh")
def test_what_was_skipped_is_listed(ball: TrainedModel, tmp_path: Path) -> None:
    path = ball.run.path / record.SKIPS
    assert not path.exists()
    record.write(ball.run.path, [Skip("contraction", "space where no camera looks", True, "one frustum", "steps")])
    try:
        report.write(ball, tmp_path / "report")
    finally:
        path.unlink()
    page = (tmp_path / "report" / "index.html").read_text()
    assert "<td>contraction</td><td>skipped</td><td>one frustum</td>" in page and "density follows normals" in page
