from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.datasets.spline import Grid, Spline
from koala3d.reconstruct.scene.rays import (
    Normalisation,
    Pixels,
    Rays,
    direction_of_cameras,
    read_scaled,
    scaled_camera,
    view_rays,
)


class Silent:
    """A progress that nobody looks at; counts."""

    count = 0

    def advance(self) -> None:
        self.count += 1


@pytest.mark.parametrize("mask", [False, True])
def test_the_box_comes_into_the_cube_or_the_ball(make_scene: Callable[..., Scene], mask: bool) -> None:
    scene = make_scene(mask=mask)
    normalisation = Normalisation.of(scene)
    corners = np.stack(np.meshgrid(*scene.box.T, indexing="ij"), -1).reshape(-1, 3)
    inside = (corners - normalisation.centre) * normalisation.scale
    assert normalisation.bounded is mask
    reach = np.abs(inside).max() if mask else np.linalg.norm(inside, axis=-1).max()
    np.testing.assert_allclose(reach, 1, atol=1e-9)
    np.testing.assert_allclose(normalisation.near, scene.near * normalisation.scale)
    assert normalisation.near < normalisation.far <= 1e3


def test_rays_project_back_to_their_pixels(make_scene: Callable[..., Scene]) -> None:
    """A point at t along a pixel's ray, back in the world and the camera, lies at depth t / scale and on the pixel's centre."""
    scene = make_scene()
    view, normalisation = scene.views[2], Normalisation.of(scene)
    origins, directions, radii = view_rays(view, normalisation)
    t = np.linspace(0.5, 3, len(origins))[:, None]
    world = (origins + t * directions.astype(np.float64)) / normalisation.scale + normalisation.centre
    local = (world - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    np.testing.assert_allclose(local[:, 2], t[:, 0] / normalisation.scale, rtol=1e-5)
    np.testing.assert_allclose(
        view.camera.project(local), view.camera.pixel_centres().reshape(-1, 2), atol=1e-3
    )  # float32 of 90 px
    np.testing.assert_allclose(radii, 2 / np.sqrt(12) / 90, rtol=1e-6)


def test_rays_of_a_splined_lens_project_back_to_their_pixels(make_scene: Callable[..., Scene]) -> None:
    """Rays of an image at half its size, through knots that were estimated at the whole."""
    scene = make_scene()
    grid = Grid(-0.9, -0.75, 0.25, 0.25, 8, 7)
    spline = Spline(grid, tuple(np.random.default_rng(0).normal(0, 5e-3, 2 * grid.count).tolist()))
    view = replace(scene.views[2], camera=replace(scene.views[2].camera, spline=spline))
    camera = scaled_camera(view, 0.5)
    _, directions, _ = view_rays(view, Normalisation.of(scene), camera)
    local = directions.astype(np.float64) @ view.world_from_camera[:3, :3]
    pixels = camera.pixel_centres().reshape(-1, 2)
    np.testing.assert_allclose(camera.project(local), pixels, atol=1e-3)  # float32 of 45 px
    assert np.abs(replace(camera, spline=None).project(local) - pixels).max() > 0.1  # the knots matter


def test_pixels_come_with_their_own_ray_and_colour(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(count=4, mask=True)
    normalisation, progress = Normalisation.of(scene), Silent()
    pixels = Pixels.load(scene.views, normalisation, 0.5, progress)
    assert progress.count == 4
    size = 48 * 36
    assert pixels.colour.shape == (4 * size, 4)
    index = np.array([0, size - 1, size, 3 * size + 77])
    rays, colour, viewdirs = jax.jit(lambda p, i: (*(found := p.take(i)), found[0].viewdirs))(pixels, index)
    assert isinstance(rays, Rays)
    for row, i in enumerate(index):
        view = scene.views[i // size]
        picture = read_scaled(view, 0.5).reshape(size, -1)
        np.testing.assert_allclose(np.asarray(colour)[row, : picture.shape[1]], picture[i % size], atol=1e-3)  # float16
        origins, directions, _ = view_rays(view, normalisation, scaled_camera(view, 0.5))
        np.testing.assert_allclose(np.asarray(rays.origins)[row], origins[i % size], atol=1e-6)
        np.testing.assert_allclose(np.asarray(rays.directions)[row], directions[i % size], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(viewdirs, axis=-1), 1, atol=1e-6)


def test_a_ring_of_cameras_above_lies_above(make_scene: Callable[..., Scene]) -> None:
    """Each camera of the ring, 0.4 m wide, stands 0.19 to 0.35 m above the box's centre; around, they cancel."""
    scene = make_scene()
    x, y, z = direction_of_cameras(scene.views, Normalisation.of(scene))
    assert np.hypot(x, y) < 0.1
    assert np.sin(np.arctan2(0.19, 0.4)) < z < np.sin(np.arctan2(0.35, 0.4))


def test_pixels_that_take_no_part_are_never_drawn(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    """A gripper at the lower edge, and the corners of a lens whose formula ends: other pixels of the view stand in for them."""
    scene = make_scene(count=3)
    first, second, third = scene.views
    height, width = first.camera.height, first.camera.width
    gripper = np.full((height, width), 255, np.uint8)
    gripper[height - 5 :] = 0
    images.write(tmp_path / "ignored.png", gripper)
    bent = replace(second.camera, fx=0.6 * width, fy=0.6 * width, k1=-0.6)
    views = (replace(first, ignored=tmp_path / "ignored.png"), replace(second, camera=bent), third)
    found = Pixels.load(views, Normalisation.of(scene), 1.0, Silent())
    whole = Pixels.load((first, second, third), Normalisation.of(scene), 1.0, Silent())
    size = height * width
    assert found.total == whole.total
    above = np.asarray(whole.directions[: size - 5 * width])
    drawn = {tuple(ray) for ray in np.asarray(found.directions[:size])}
    assert drawn == {tuple(ray) for ray in above}
    valid = bent.valid_pixels()
    assert valid is not None and 0.3 < valid.mean() < 0.95, "the premise: the corners have no rays"
    rays = {tuple(ray) for ray in view_rays(views[1], Normalisation.of(scene), None, np.flatnonzero(valid))[1]}
    assert {tuple(ray) for ray in np.asarray(found.directions[size : 2 * size])} == rays
    np.testing.assert_array_equal(found.directions[2 * size :], whole.directions[2 * size :])
