import numpy as np
import pytest

from calib.handeye import closed_forms
from calib.handeye.model import Accuracy
from calib.study import compare
from calib.study.simulate import KOALA, Pattern, simulate, viewpoints
from datasets import pose

ARM = Accuracy(2e-4, float(np.deg2rad(0.03)))


@pytest.fixture(scope="module")
def rows():
    rng = np.random.default_rng(0)
    simulated = simulate(rng, KOALA, viewpoints(rng, KOALA, 15, Pattern()), sigma_px=0.2, arm=ARM)
    reported = simulated.session.base_from_flange.copy()
    reported[6] = reported[6] @ pose.from_rotation_vector([0, 0, 0], [0.004, 0, 0])
    session = variants.target_session(simulated)
    session = variants.TargetSession(session.board, 1920, 1080, session.observations, reported)
    return simulated, compare.compare(session, accuracy=ARM)


def test_every_method_is_judged(rows):
    _, found = rows
    assert [row.name for row in found[:7]] == list(closed_forms.METHODS)
    assert [row.name for row in found[7:]] == ["refinement, all views", "refinement, outliers left out"]
    assert found[-1].views == 14 and found[0].views == 15


def test_leaving_the_wrong_view_out_pays_on_unseen_views(rows):
    simulated, found = rows
    distance, _ = pose.difference(found[-1].camera_pose, simulated.truth.mount_from_camera)
    assert distance < 2e-3  # corners of 0.2 px, an arm of 0.2 mm, intrinsics estimated along
    last = {r.name: r.held_out_mm for r in found}
    assert last["refinement, outliers left out"] < last["refinement, all views"]


def test_residual_is_that_of_the_arm(rows):
    _, found = rows
    park = next(r for r in found if r.name == "park")
    # one view in fifteen is 4 mm off: 4 / sqrt(15) = 1 mm
    assert 0.7 < park.residual_mm < 1.6 and park.held_out_mm > 0.5


def test_table_has_a_row_per_method(rows):
    _, found = rows
    text = compare.markdown([*found, compare.Judged("none", None, np.nan, np.nan, np.nan, np.nan, 3)])
    assert text.count("\n") == len(found) + 2 and "| none | 3 | no answer" in text
