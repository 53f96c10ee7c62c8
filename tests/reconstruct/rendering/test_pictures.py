"""What is left out of a picture must not be missed in it."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.field.cloud import Cloud
from reconstruct.numerics.compiling import jit
from reconstruct.numerics.safe import normalise
from reconstruct.output.trained_model import TrainedModel
from reconstruct.rendering import pictures
from reconstruct.rendering.model import Model, Rendered, composite, render
from reconstruct.rendering.pictures import Renderer, composited_normals
from reconstruct.run import Run
from reconstruct.sampling.samples import RaySamples, cloud_of
from reconstruct.scene.rays import Rays, view_rays
from reconstruct.scene.space import BOX


def rays_of(trained: TrainedModel) -> Rays:
    view = trained.scene.split("test")[0]
    return Rays(*map(jnp.asarray, view_rays(view, trained.run.normalisation, trained.camera(view))))


def of_all_samples(model: Model, rays: Rays) -> tuple[Cloud, RaySamples, Rendered, jax.Array]:
    """What a picture is made of, and the normals of every sample composited."""
    found = model.sampler.look(rays)
    cloud = cloud_of(rays, found.samples, space=BOX, footprint=found.footprint)
    rendered, _ = render(model.field, rays, found.samples, cloud)
    _, _, normals = model.field.with_normals(cloud)
    return cloud, found.samples, rendered, composite(normals, found.samples.packed(rendered.weights), found.samples)


def test_normals_of_what_adds_to_a_ray_are_those_of_all_samples(
    make_run: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    trained = TrainedModel.open(make_run().path)
    cloud, samples, rendered, every = jit(of_all_samples)(trained.model, rays_of(trained))
    visible = np.asarray(rendered.opacity) > 0.01
    assert visible.sum() > 100
    bound = 1.01 * trained.run.config.sampler.max_per_ray * pictures.FAINT  # each left out is unit, times less than its share
    for block in (1024, 1 << 20):
        monkeypatch.setattr(pictures, "BLOCKS", (block, block))
        ours = jit(lambda *known: composited_normals(*known))(trained.model.field, cloud, samples, rendered)  # not the last trace
        assert np.all(np.linalg.norm(ours - every, axis=-1) <= bound * rendered.opacity + 1e-6)
        angle = np.degrees(np.arccos(np.clip(np.sum(np.asarray(normalise(ours) * normalise(every)), -1), -1, 1)))[visible]
        assert np.median(angle) < 0.2  # most of what is left out points the same way


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
    monkeypatch.setattr(pictures, "SIZES", (64, 64))
    parts = Renderer(ball.run.normalisation).rays(ball.model, *given, normals=True)
    for name, values in whole.items():
        np.testing.assert_allclose(parts[name], values, rtol=1e-5, atol=1e-5, err_msg=name)
