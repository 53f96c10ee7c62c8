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
