"""Lenses that no formula expresses: knots are found where corners ask for them, and stay away elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate
from koala3d.calib.errors import TargetError
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.intrinsics import estimate, lenses, projection, splined
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.spline import Grid, Spline

NOISE_PX = 0.1
EXPECTED_PX = NOISE_PX * np.sqrt(2 * (1 - 6 / 96))
"""Error of views that were not seen, through the true lens: six numbers of a pose are fitted to 48 corners."""


def with_bump(camera: Camera, most_px: float = 0.5, wide: float = 0.11) -> Camera:
    """`camera` with a bump beside the middle, `wide` times the width (one deviation), in a grid finer than any that is fitted."""
    step_x, step_y = camera.width / 30 / camera.fx, camera.height / 17 / camera.fy
    grid = Grid(-camera.cx / camera.fx - 2 * step_x, -camera.cy / camera.fy - 2 * step_y, step_x, step_y, 35, 22)
    away = (grid.places * [camera.fx, camera.fy] + [camera.cx, camera.cy]) / camera.width - [0.62, 0.22]
    height = most_px * np.exp(-(away**2).sum(1) / (2 * wide**2))
    knots = height[:, None] * [0.8 / camera.fx, 0.6 / camera.fy]
    return replace(camera, spline=Spline(grid, tuple(knots.ravel().tolist())))


BUMP = with_bump(KOALA.camera)


def corners(camera: Camera, seed: int = 0, views: int = 25, noise_px: float = NOISE_PX) -> list:
    """Corners by view, of the ordinary rig with another camera."""
    rng, rig = np.random.default_rng(seed), replace(KOALA, camera=camera)
    return simulate(rng, rig, viewpoints(rng, rig, views, ViewRange()), sigma_px=noise_px, arm=Accuracy()).observations()


def found(camera: Camera, name: str, **options: float) -> estimate.Intrinsics:
    """What is estimated with a lens of this name."""
    seen, spline = corners(camera, **options), lenses.SPLINES.get(name, "never")
    return estimate.calibrate(seen, camera.width, camera.height, lenses=lenses.LENSES[name], spline=spline)


@pytest.fixture(scope="module")
def knots() -> estimate.Intrinsics:
    return found(BUMP, "auto")


def test_a_lens_with_a_bump_is_predicted_to_the_noise_of_the_corners_by_knots_alone(knots: estimate.Intrinsics) -> None:
    formula = found(BUMP, "rational")
    assert formula.lens.grid is None and knots.lens.grid is not None
    assert formula.held_out_px > 1.06 * EXPECTED_PX
    assert knots.held_out_px < 1.03 * EXPECTED_PX  # 2400 numbers determine it to 1.5 %
    assert knots.rms_px < formula.rms_px


def test_knots_are_those_of_the_bump_where_corners_were_seen() -> None:
    precise = found(BUMP, "splined", noise_px=0.01)
    seen = np.concatenate([o.pixels for o in precise.observations])
    assert len(seen) > 0.99 * sum(len(o.ids) for o in corners(BUMP))  # that the formula does not fit makes no corner wrong

    def turned_best(camera: Camera) -> float:
        """Rms distance of where `camera` and the true one see the same rays, but for a turn [px]."""
        rays, truth = camera.directions(seen), BUMP.directions(seen)
        rays, truth = (r / np.linalg.norm(r, axis=1, keepdims=True) for r in (rays, truth))
        left, _, right = np.linalg.svd(truth.T @ rays)
        return BUMP.fx * float(np.sqrt(np.mean(((rays @ (left @ right).T - truth) ** 2).sum(1))))

    plain = found(BUMP, "brown", noise_px=0.01).camera
    assert turned_best(precise.camera) < 0.25 * turned_best(plain)


@pytest.mark.parametrize("seed", range(10))
def test_a_plain_lens_gets_no_knots(seed: int) -> None:
    """The test whether corners ask for knots errs once in millions, were they exactly Gaussian: none of ten sessions."""
    assert found(KOALA.camera, "auto", seed=20 + seed).lens == lenses.USUAL


def test_a_bent_target_is_not_taken_for_a_lens() -> None:
    rng = np.random.default_rng(0)
    taken, points = viewpoints(rng, KOALA, 25, ViewRange()), KOALA.board.points
    away = 2 * (points[:, :2] - points[:, :2].min(0)) / np.ptp(points[:, :2], axis=0) - 1
    bent = points + np.column_stack([0 * away, 4e-4 * (1 - away[:, 0] ** 2)])
    seen = simulate(rng, KOALA, taken, sigma_px=NOISE_PX, arm=Accuracy(), printed=bent).observations()
    chosen = estimate.calibrate(seen, 1920, 1080, spline="if better")
    assert chosen.rms_px > 1.1 * EXPECTED_PX and chosen.lens.grid is None


def test_knots_that_no_corner_sees_stay_at_zero_and_as_uncertain_as_assumed() -> None:
    seen = [replace(o, **_left_half(o)) for o in corners(BUMP)]
    fitted = estimate.calibrate(seen, 1920, 1080, lenses=[lenses.USUAL], spline="always")
    grid, std = fitted.camera.spline.grid, np.array([s for name, s in fitted.std.items() if projection.is_knot(name)])
    knots, stds = (np.reshape(part, (grid.rows, grid.columns, 2)) for part in (fitted.camera.spline.array, std))
    assumed = splined.prior(fitted.camera, lenses.USUAL.free, np.concatenate([o.pixels for o in seen]))
    before = np.sqrt(np.diag(assumed.covariance)).reshape(stds.shape)
    assert np.abs(knots[:, -2:] * fitted.camera.fx).max() < 0.1 < np.abs(knots * fitted.camera.fx).max()  # of 1 px
    np.testing.assert_allclose(stds[:, -1], before[:, -1], rtol=0.05)  # hardly more is known than before
    assert (stds[3:5, 3:5] < 0.5 * before[3:5, 3:5]).all()  # in the middle of what was seen


def _left_half(observation) -> dict:
    chosen = observation.pixels[:, 0] < 1100
    return {"ids": observation.ids[chosen], "pixels": observation.pixels[chosen], "points": observation.points[chosen]}


def test_the_surface_holds_nothing_that_formula_or_turn_express(knots: estimate.Intrinsics) -> None:
    camera, pixels = knots.camera, np.concatenate([o.pixels for o in knots.observations])
    moved = pixels - replace(camera, spline=None).project(camera.directions(pixels))
    assert np.linalg.norm(moved, axis=1).max() > 0.2
    away = (pixels - [camera.cx, camera.cy]) / camera.fx
    x, y = away.T
    for field in ((1 + 0 * x, 0 * x), (x, 0 * x), (-y, x), (x * x, x * y), (x * (x * x + y * y), y * (x * x + y * y))):
        field = np.stack(field, -1) / np.linalg.norm(field)
        assert abs((field * moved).sum()) < 0.02 * np.linalg.norm(
            moved
        )  # the fields of the curved lens differ a little from these


def test_too_few_corners_are_refused_and_get_no_knots_by_themselves() -> None:
    few = [replace(o, ids=o.ids[::5], pixels=o.pixels[::5], points=o.points[::5]) for o in corners(BUMP, views=20)]
    with pytest.raises(TargetError, match=r"too few corners for a splined lens \(\d+ corners were seen, at least 250"):
        estimate.calibrate(few, 1920, 1080, lenses=[lenses.USUAL], spline="always")
    assert estimate.calibrate(few, 1920, 1080, lenses=[lenses.USUAL], spline="if better").lens.grid is None


def test_grids_follow_the_corners_and_the_shape_of_the_image() -> None:
    wide, high = (
        splined.flat(KOALA.camera, 1200).spline,
        splined.flat(replace(KOALA.camera, width=1080, height=1920), 1200).spline,
    )
    assert (wide.grid.columns, wide.grid.rows) == (high.grid.rows, high.grid.columns) == (12, 8)
    coarse = splined.flat(KOALA.camera, 260).spline.grid
    assert (coarse.columns, coarse.rows) == (7, 5) and len(set(wide.knots)) == 1
    corner = KOALA.camera.undistorted().directions([[0, 0], [1920, 1080]])[:, :2]
    assert (wide.grid.weights(corner).sum(1) > 1 - 1e-12).all()  # all four knots along each axis are there
