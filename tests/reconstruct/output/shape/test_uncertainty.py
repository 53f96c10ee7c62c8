"""What is known of the ball's surface, and what is said of it."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.calibration import UncertainPose
from koala3d.datasets.scene import MASKS_FROM, PICTURES, Scene
from koala3d.reconstruct.output.mesh import extraction
from koala3d.reconstruct.output.mesh import files as mesh_files
from koala3d.reconstruct.output.shape import comparison, evidence, stated, uncertainty
from koala3d.reconstruct.output.shape.evidence import Evidence
from koala3d.reconstruct.output.trained_model import TrainedModel
from tests.bench import shape_coverage
from tests.reconstruct.conftest import CAMERA, CENTRE, DIFFUSE, RADIUS, SPECULAR


def ball_mesh() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    return mesh.apply_translation(CENTRE)


def test_evidence_of_the_ball_is_what_its_geometry_says(ball: TrainedModel) -> None:
    mesh = ball_mesh()
    found, points = evidence.of(ball, mesh), np.asarray(mesh.vertices)
    above = (points[:, 2] - CENTRE[2]) / RADIUS
    assert (found.views[above < -0.9] == 0).all(), "all views are from above"
    assert found.views.max() <= 4 and found.views[above > 0.95].min() >= 2, (
        "of the four of the training, one sees the top edge-on"
    )
    distances = [np.linalg.norm(view.world_from_camera[:3, 3] - CENTRE) for view in ball.scene.split("train")]
    assert np.median(found.pixel) == pytest.approx(np.median(distances) / CAMERA.fx, rel=0.1)
    share = SPECULAR.sum() / (SPECULAR.sum() + DIFFUSE.sum())
    np.testing.assert_allclose(found.mirror, share / (1 + 0.25 / evidence.ROUGH), rtol=1e-3)
    assert found.slope.max() < 0.2 and (found.depth < RADIUS).all()
    assert np.isfinite([found.spread, found.pixel, found.depth, found.mirror, found.slope]).all()


def test_a_point_inside_is_as_deep_as_the_outlines_leave_open(ball: TrainedModel) -> None:
    small = trimesh.creation.icosphere(subdivisions=2, radius=0.01).apply_translation(CENTRE)
    found = evidence.of(ball, small)
    pixel = 0.3 / CAMERA.fx
    assert np.abs(found.depth - RADIUS).max() < 0.012 + 2 * pixel


def evidence_of(**values: float) -> Evidence:
    plain = {"views": 20, "spread": 0.5, "pixel": 1e-4, "depth": 0.0, "mirror": 0.0, "slope": 0.0}
    return Evidence(**{name: np.array([value]) for name, value in (plain | values).items()})


def test_what_cannot_be_known_is_not_known() -> None:
    known = [
        bool(uncertainty.is_known(evidence_of(**values))[0])
        for values in (
            {},
            {"views": 0, "spread": 0.0},
            {"views": 2},
            {"spread": 0.01},
            {"mirror": 0.9, "views": 5},
            {"mirror": 0.9, "views": 20},
        )
    ]
    assert known == [True, False, False, False, False, True]


def test_deviations_grow_with_what_is_against_a_surface() -> None:
    base = uncertainty.deviations(evidence_of(), uncertainty.NUMBERS)[0]
    for worse in ({"pixel": 1e-3}, {"slope": 1.0}, {"depth": 0.05}, {"depth": np.inf}, {"views": 4}):
        found = uncertainty.deviations(evidence_of(**worse), uncertainty.NUMBERS)[0]
        assert np.isfinite(found) and found > 1.05 * base, worse


def test_a_mesh_states_its_errors_and_is_read_with_them(ball: TrainedModel, tmp_path: Path) -> None:
    surface = extraction.extract(ball, resolution=48)
    certain = uncertainty.of(ball, surface)
    below = np.asarray(surface.vertices)[:, 2] < CENTRE[2] - 0.95 * RADIUS
    assert below.any() and not certain.known[below].any() and certain.known.any()
    size = np.linalg.norm(surface.extents)
    np.testing.assert_allclose(certain.deviation[~certain.known], uncertainty.WIDEST * size)
    assert (certain.deviation[certain.known] < uncertainty.WIDEST * size).all() and (certain.common == 0).all()
    found = certain.summary()
    low, high = found["expected_error"]["interval"]
    assert 0 < low < found["expected_error"]["value"] < high and 0 < found["known_share"] < 1 and found["scale_std"] is None
    json.dumps(found, allow_nan=False)
    stated.attach(surface, certain)
    mesh_files.save(surface, tmp_path / "ball.ply")
    again = stated.read(tmp_path / "ball.ply")
    assert again.deviation == pytest.approx(certain.deviation, rel=1e-6)
    np.testing.assert_array_equal(again.known, certain.known)
    assert again.outline == pytest.approx(certain.outline)


def test_the_run_keeps_the_summary_for_its_report(ball: TrainedModel, tmp_path: Path) -> None:
    certain = uncertainty.of(ball, ball_mesh())
    uncertainty.store(tmp_path, 5, certain)
    found = uncertainty.stored(tmp_path, 5)
    assert found is not None and found["known_share"] == certain.summary()["known_share"]
    assert uncertainty.stored(tmp_path, 6) is None and uncertainty.stored(tmp_path / "other", 5) is None


def test_a_calibration_that_is_stated_is_common_to_all(ball: TrainedModel) -> None:
    mount = UncertainPose(np.eye(4), np.diag([1e-6] * 3 + [1e-8] * 3))
    scene = replace(ball.scene, provenance=ball.scene.provenance | {"flange_from_camera": mount.to_json()})
    certain = uncertainty.of(replace(ball, scene=scene), ball_mesh())
    assert certain.scale_std is not None and 1e-3 < certain.scale_std < 1e-2
    assert (certain.common > 0).all() and certain.deviation == pytest.approx(uncertainty.of(ball, ball_mesh()).deviation)


def test_outlines_that_were_found_are_uncertain(ball: TrainedModel) -> None:
    scene = replace(ball.scene, provenance=ball.scene.provenance | {MASKS_FROM: PICTURES})
    certain, exact = uncertainty.of(replace(ball, scene=scene), ball_mesh()), uncertainty.of(ball, ball_mesh())
    pixel = evidence.of(ball, ball_mesh()).pixel
    assert certain.outline == pytest.approx(uncertainty.OUTLINE * pixel) and (exact.outline == 0).all()
    merged = replace(ball.scene, provenance={"merged": [{}, {MASKS_FROM: PICTURES}]})
    assert uncertainty.of(replace(ball, scene=merged), ball_mesh()).outline == pytest.approx(certain.outline)
    expected = [one.summary()["expected_error"]["value"] for one in (certain, exact)]
    assert expected[0] > expected[1]


def test_nothing_known_is_said_in_words(ball: TrainedModel) -> None:
    far = ball_mesh().apply_translation([0, 0, -5])
    certain = uncertainty.of(ball, far)
    assert not certain.known.any() and certain.summary()["expected_error"] is None
    assert "nothing is known" in uncertainty.text(certain)


def test_a_run_is_compared_with_its_truth(
    ball: TrainedModel, ball_scene: tuple[Scene, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(TrainedModel, "open", lambda _: ball)
    monkeypatch.setattr(extraction, "extract", partial(extraction.extract, resolution=48))
    found = comparison.compare(stated.read(ball.run.path), stated.read(ball_scene[1] / "truth" / "object.ply")).to_json()
    assert found["aligned"]["by"] == "icp" and abs(found["deviation_m"]["mean"]) < 2e-3
    assert found["significant_share"] is not None and 0.9 < found["not_compared_share"] < 1, "three views see little in common"


def test_a_run_of_a_scene_with_a_truth_can_calibrate(
    ball: TrainedModel, ball_scene: tuple[Scene, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(TrainedModel, "open", lambda _: ball)
    found = shape_coverage.measured(ball.run.path, resolution=48)
    assert found.terms.shape == (len(uncertainty.NUMBERS), len(found.errors)) and 0 < found.known < 0.1, (
        "three of four views see little"
    )
    assert np.isfinite(found.terms).all() and np.average(found.errors, weights=found.areas) < 2e-3
    assert 0 <= found.inside(np.array(uncertainty.NUMBERS)) <= 1
