"""The whole rig with a lens that no formula expresses: simulated sessions with a ripple of half a pixel."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import Rig, ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate
from koala3d.calib.errors import TargetError
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.handeye.verify import verify
from koala3d.calib.intrinsics import projection
from koala3d.calib.page import evidence, maps, report, summary
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.reports.html import ReportPage
from koala3d.datasets.spline import Grid, Spline

ARM = Accuracy(3e-5, float(np.deg2rad(0.005)))


def with_surface(camera: Camera, kind: str) -> Camera:
    """`camera` with a surface of up to 0.5 px in a grid finer than any that is fitted, its middle beside that of the image.

    A bump, a tenth of the width wide, moves all pixels one way; a ripple of half the width to and from its middle.
    """
    step_x, step_y = camera.width / 30 / camera.fx, camera.height / 17 / camera.fy
    grid = Grid(-camera.cx / camera.fx - 2 * step_x, -camera.cy / camera.fy - 2 * step_y, step_x, step_y, 35, 22)
    away = (grid.places * [camera.fx, camera.fy] + [camera.cx, camera.cy]) / camera.width - [0.62, 0.22]
    far = np.linalg.norm(away, axis=1, keepdims=True)
    bump = 0.5 * np.exp(-(far**2) / (2 * 0.11**2)) * [0.8, 0.6]
    ripple = 0.5 * np.sin(2 * np.pi * far / 0.5) * away / np.maximum(far, 1e-9)
    moved = {"bump": bump, "ripple": ripple}[kind]
    return replace(camera, spline=Spline(grid, tuple((moved / [camera.fx, camera.fy]).ravel().tolist())))


RIG = replace(KOALA, camera=with_surface(KOALA.camera, "ripple"))


def session(rig: Rig, seed: int, views: int = 25) -> TargetSession:
    rng = np.random.default_rng(seed)
    drawn = simulate(rng, rig, viewpoints(rng, rig, views, ViewRange()), sigma_px=0.1, arm=ARM)
    size = rig.camera.width, rig.camera.height
    name = {"frames_sha256": str(seed)}
    return TargetSession(rig.board, *size, tuple(drawn.observations()), drawn.session.base_from_flange, provenance=name)


@pytest.fixture(scope="module")
def seen() -> TargetSession:
    return session(RIG, 0)


@pytest.fixture(scope="module")
def splined(seen: TargetSession) -> Calibration:
    return calibrate.calibrate_handeye(seen, lens="splined")


@pytest.fixture(scope="module")
def plain(seen: TargetSession) -> Calibration:
    return calibrate.calibrate_handeye(seen, lens="rational")


def off(found: Calibration, pixels: np.ndarray, rig: Rig = RIG) -> tuple[float, float]:
    """How far the camera's place on the flange [mm] and the rays of `pixels` in the flange's frame [px] are off, rms.

    Rays, not the camera's own axes: these are a convention where a lens is free to imitate a turn.
    """
    place = 1e3 * np.linalg.norm(found.flange_from_camera.matrix[:3, 3] - rig.flange_from_camera[:3, 3])
    rays = []
    for camera, matrix in ((found.camera, found.flange_from_camera.matrix), (rig.camera, rig.flange_from_camera)):
        direction = camera.directions(pixels) @ matrix[:3, :3].T
        rays.append(direction / np.linalg.norm(direction, axis=1, keepdims=True))
    return float(place), rig.camera.fx * float(np.sqrt(np.mean(((rays[0] - rays[1]) ** 2).sum(1))))


def test_the_camera_is_nearer_to_where_it_is(seen: TargetSession, splined: Calibration, plain: Calibration) -> None:
    pixels = np.concatenate([o.pixels for o in seen.observations])
    (place, rays), (place_plain, rays_plain) = off(splined, pixels), off(plain, pixels)
    assert place < 0.5 * place_plain and rays < 0.7 * rays_plain  # medians of five: 0.07 of 0.14 mm, 0.12 of 0.47 px
    assert splined.residuals.held_out_px < plain.residuals.held_out_px
    assert splined.residuals.rms_px < 0.1 * np.sqrt(2) < plain.residuals.rms_px


def test_another_session_is_predicted_better(splined: Calibration, plain: Calibration) -> None:
    other = session(RIG, 1)
    assert verify(other, splined).rms_px < verify(other, plain).rms_px


def test_the_file_holds_the_knots_and_that_of_another_lens_has_no_word_of_them(
    splined: Calibration, plain: Calibration, tmp_path: Path
) -> None:
    splined.save(tmp_path / "splined.json")
    again = Calibration.load(tmp_path / "splined.json")
    assert again.camera == splined.camera and again.camera_std == splined.camera_std
    plain.save(tmp_path / "plain.json")
    text = (tmp_path / "plain.json").read_text()
    assert "spline" not in text and "knot" not in text


def test_a_session_with_this_camera_given_counts_its_knots_with_their_uncertainty(splined: Calibration) -> None:
    few = session(RIG, 2, views=8)
    found = calibrate.calibrate_handeye(few, given=splined)
    knots = [name for name in splined.camera_std if projection.is_knot(name)]
    assert len(knots) == 2 * splined.camera.spline.grid.count
    before, after = (np.array([one.camera_std[name] for name in knots]) for one in (splined, found))
    assert (after < 1.001 * before).all() and after.mean() < before.mean()
    assert found.residuals.rms_px < 0.1 * np.sqrt(2)


@pytest.mark.slow
def test_the_same_session_with_this_camera_given_assumes_of_knots_what_it_assumed_before(
    seen: TargetSession, splined: Calibration
) -> None:
    again = calibrate.calibrate_handeye(seen, given=splined)
    change = np.abs(projection.vector(again.camera) - projection.vector(splined.camera))[12:] * splined.camera.fx
    assert change.max() < 0.01  # of knots of 1 px: the same information, counted once
    stds = [[one.camera_std[name] for name in splined.camera_std] for one in (again, splined)]
    np.testing.assert_allclose(*stds, rtol=0.02)


def test_uncertainty_over_the_image_includes_the_knots(splined: Calibration) -> None:
    whole = maps.projection_uncertainty(splined, 0.5).values_px
    stds = {name: 1e-12 if projection.is_knot(name) else std for name, std in splined.camera_std.items()}
    without = maps.projection_uncertainty(replace(splined, camera_std=stds), 0.5).values_px
    own = np.sqrt(np.maximum(whole**2 - without**2, 0.0))  # of the knots, but for their correlation with the rest
    middle, corner = np.s_[12:15, 22:26], np.s_[:3, :4]  # corners of the image hardly show the target
    assert own[middle].max() < 0.04 < 0.2 < own[corner].mean() < 1.0  # a knot alone is uncertain by 0.96 px beforehand


def test_summary_and_page_say_so_in_a_line(seen: TargetSession, splined: Calibration) -> None:
    text = summary.describe_calibration(splined)
    assert "12 x 8 knots move pixels by up to" in text and "knot 0" not in text
    held = evidence.gather(splined, seen)
    assert np.sqrt(np.mean((held.residuals[held.kind][held.inliers] ** 2).sum(1))) == pytest.approx(
        splined.residuals.rms_px, rel=0.01
    )
    page = ReportPage("Calibration")
    report._camera(page, splined)
    assert "12 x 8 knots move pixels by up to" in page.render() and "knot 0" not in page.render()


def test_too_few_corners_are_refused() -> None:
    few = session(RIG, 0)
    some = [replace(o, ids=o.ids[::6], pixels=o.pixels[::6], points=o.points[::6]) for o in few.observations]
    with pytest.raises(TargetError, match="too few corners for a splined lens"):
        calibrate.calibrate_handeye(few.with_observations(some), lens="splined")


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("kind", ["plain", "bump", "ripple"])
def test_five_sessions_of_each_kind(kind: str) -> None:
    """Those of docs/calibration_figures.md: medians of five sessions, and how often `auto` takes knots."""
    rig = KOALA if kind == "plain" else replace(KOALA, camera=with_surface(KOALA.camera, kind))
    rows, taken = {"rational": [], "splined": []}, 0
    for seed in range(5):
        drawn = session(rig, seed)
        pixels = np.concatenate([o.pixels for o in drawn.observations])
        taken += calibrate.calibrate_intrinsics(drawn, "auto").camera.spline is not None
        for lens, found in rows.items():
            alone = calibrate.calibrate_intrinsics(drawn, lens).residuals.held_out_px
            rig_found = calibrate.calibrate_handeye(drawn, lens=lens)
            found.append((alone, rig_found.residuals.held_out_px, *off(rig_found, pixels, rig)))
    medians = {lens: np.median(found, axis=0) for lens, found in rows.items()}
    print(f"\n{kind}: auto takes knots in {taken} of 5")
    for lens, (alone, arm, place, rays) in medians.items():
        print(f"  {lens}: unseen views {alone:.3f} px, through the arm {arm:.3f} px; off by {place:.3f} mm, rays {rays:.3f} px")
    formula, knots = medians["rational"], medians["splined"]
    if kind == "plain":
        assert taken == 0 and knots[0] < 1.02 * formula[0]
    else:
        assert taken == 5 and knots[0] < 1.04 * 0.137 < formula[0]  # what a plain lens gives
        assert kind == "bump" or (knots[2:] < 0.6 * formula[2:]).all()  # a bump moves the camera by less than the arm errs
