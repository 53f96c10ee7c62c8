"""What is left out of a picture must not be missed in it."""

import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering import pictures
from koala3d.reconstruct.rendering.pictures import Renderer
from koala3d.reconstruct.scene.rays import Rays, view_rays


def rays_of(trained: TrainedModel) -> Rays:
    view = trained.scene.split("test")[0]
    return Rays(*map(jnp.asarray, view_rays(view, trained.run.normalisation, trained.camera(view))))


def test_rays_that_meet_nothing_show_what_is_behind_and_cost_nothing(ball: TrainedModel) -> None:
    rays = rays_of(ball)
    given = [np.asarray(values) for values in (rays.origins, rays.directions, rays.radii)]
    pink = Renderer(ball.run.normalisation, background=(1.0, 0.5, 0.75))
    found = pink.rays(ball.model, *given, normals=True)
    hit = found["opacity"][:, 0] > 0
    assert 0.05 < hit.mean() < 0.9
    np.testing.assert_array_equal(found["rgb"][~hit], np.broadcast_to(np.float32([1.0, 0.5, 0.75]), (np.sum(~hit), 3)))
    assert all(np.all(values[~hit] == 0) for name, values in found.items() if name != "rgb")
    away = pink.rays(ball.model, given[0], -given[1], given[2])
    np.testing.assert_array_equal(away["opacity"], 0)
    alone = pink.rays(ball.model, *(values[hit] for values in given), normals=True)
    for name, values in alone.items():  # other rays beside it: the sums run in another order
        np.testing.assert_allclose(values, found[name][hit], rtol=1e-5, atol=1e-5, err_msg=name)


def test_pictures_larger_and_smaller_than_what_is_rendered_at_once_are_the_same(
    ball: TrainedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    rays = rays_of(ball)
    given = [np.asarray(values) for values in (rays.origins, rays.directions, rays.radii)]
    whole = Renderer(ball.run.normalisation).rays(ball.model, *given, normals=True)
    monkeypatch.setattr(pictures, "SIZES", (64,))
    monkeypatch.setattr(pictures, "SHADED", 48)
    parts = Renderer(ball.run.normalisation).rays(ball.model, *given, normals=True)
    for name, values in whole.items():
        np.testing.assert_allclose(parts[name], values, rtol=1e-5, atol=1e-5, err_msg=name)


def test_a_pixel_is_nearer_to_the_mean_over_its_area_than_the_ray_through_its_middle(ball: TrainedModel) -> None:
    """At the rim of the ball; depths stay those of the ball, since what is beside it has none."""
    view, renderer = ball.scene.split("test")[0], ball.renderer
    camera = ball.camera(view)
    fine = renderer.rays(ball.model, *renderer.rays_of(view, camera.scaled(8 * camera.width, 8 * camera.height)))["opacity"]
    area = fine.reshape(camera.height, 8, camera.width, 8).mean((1, 3))
    middle = renderer.rays(ball.model, *renderer.rays_of(view, camera))
    picture = ball.picture(view)
    rim = (area > 0.05) & (area < 0.95)
    off = [np.abs(one - area)[rim].mean() for one in (picture.opacity[..., 0], middle["opacity"].reshape(area.shape))]
    assert rim.sum() > 50 and off[0] < 0.7 * off[1]
    deep, whole = picture.depth[..., 0], middle["depth"][middle["depth"] > 0] / renderer.normalisation.scale
    assert deep[rim & (deep > 0)].min() > whole.min() - 1e-3 and deep.max() < whole.max() + 1e-2
