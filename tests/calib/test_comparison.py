from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import comparison
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate, target_session
from koala3d.calib.handeye import closed_forms, verify
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose

ARM = Accuracy(2e-4, float(np.deg2rad(0.03)))


@pytest.fixture(scope="module")
def rows():
    rng = np.random.default_rng(0)
    simulated = simulate(rng, KOALA, viewpoints(rng, KOALA, 15, ViewRange()), sigma_px=0.2, arm=ARM)
    reported = simulated.session.base_from_flange.copy()
    reported[6] = reported[6] @ pose.from_rotation_vector([0, 0, 0], [0.004, 0, 0])
    session = target_session(simulated)
    session = TargetSession(session.board, 1920, 1080, session.observations, reported)
    return simulated, comparison.compare(session, accuracy=ARM)


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
    text = comparison.markdown([*found, comparison.Judged("none", None, *[np.nan] * 6, 3)])
    assert text.count("\n") == len(found) + 2 and "| none | 3 | no answer" in text


def test_every_method_is_judged_by_the_same_corners(rows):
    """The spoilt view counts for all methods or for none: without it, all come near each other; with it, none does well."""
    _, found = rows
    for row in found:
        assert row.kept_mm < row.held_out_mm  # the view that is 4 mm off is among all corners, and not among the kept ones
    best = next(row for row in found if row.name == "refinement, outliers left out")
    assert best.kept_mm == min(row.kept_mm for row in found)
    # 1/15 of the corners are 4 mm off
    assert all(row.held_out_mm**2 - row.kept_mm**2 > 0.4 * 16 / 15 for row in found)


def test_held_out_errors_over_all_corners_are_those_of_a_plain_loop():
    """`verify.predicted` against predictions of each fold by itself."""
    rng = np.random.default_rng(1)
    simulated = simulate(rng, KOALA, viewpoints(rng, KOALA, 7, ViewRange()), sigma_px=0.2, arm=ARM)
    kept = np.arange(len(simulated.session.view)) % 3 > 0
    truth = simulated.truth
    found = verify.predicted(simulated.session, kept, lambda seen: truth)
    still = replace(truth, corrections=np.zeros((7, 6)))
    pixels, millimetres = verify.errors(simulated.session, still)
    assert found is not None
    np.testing.assert_allclose(found[0], [verify.rms(pixels[kept]), verify.rms(millimetres[kept])])
    np.testing.assert_allclose(found[1], [verify.rms(pixels), verify.rms(millimetres)])
