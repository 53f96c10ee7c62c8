import json
from pathlib import Path

from koala3d.reconstruct.diagnosis.diagnose import Diagnosis, diagnose, small_camera, write
from koala3d.reconstruct.output.trained_model import TrainedModel


def test_every_view_is_rendered_and_shown(ball: TrainedModel, tmp_path: Path) -> None:
    found = diagnose(ball, pictures=False)
    assert [one.name for one in found.residuals] == [view.name for view in ball.scene.views]
    camera = small_camera(ball.scene.views[0])
    assert all(one.error_map.shape == (camera.height, camera.width) for one in found.residuals)
    page = write(found, ball, tmp_path / "page", made_by="reconstruct diagnose run").read_text()
    assert "Residual maps" in page and page.count("<img") >= 2 * len(found.residuals)
    assert all(finding.remedy in page or "&#" in page for finding in found.findings)


def test_a_diagnosis_can_be_written_as_json(ball: TrainedModel) -> None:
    from koala3d.datasets.core.files import plain

    content = json.loads(json.dumps(Diagnosis(**vars(diagnose(ball, pictures=False))).to_json(), default=plain))
    assert len(content["views"]) == len(ball.scene.views) and {"name", "psnr", "gains", "shift_px"} <= content["views"][0].keys()
