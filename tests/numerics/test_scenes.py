"""The same scene in millimetres, metres and kilometres, and pictures with holes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import BRIGHTEST, Normalisation, Pixels, read_scaled
from koala3d.reconstruct.training.step import Step

SMALL = [
    "encoding.levels=3",
    "encoding.log2_size=8",
    "field.spatial_width=8",
    "field.view_width=8",
    "field.ide_degree=2",
    "sampler.rays=128",
    "sampler.samples=1024",
    "sampler.grid=16",
    "sampler.steps=32",
    "sampler.max_per_ray=8",
    "surface.rays=16",
    "surface.samples=8",
]


def enlarged(scene: Scene, factor: float) -> Scene:
    """The same scene with lengths in another unit."""
    views = []
    for view in scene.views:
        matrix = view.world_from_camera.copy()
        matrix[:3, 3] *= factor
        views.append(replace(view, world_from_camera=matrix))
    return replace(scene, views=tuple(views), near=scene.near * factor, far=scene.far * factor, box=scene.box * factor)


def loaded(scene: Scene, normalisation: Normalisation) -> Pixels:
    views = scene.split("train")
    with progress("reading", len(views)) as shown:
        return Pixels.load(views, normalisation, 1.0, shown)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_scene_trains_alike_in_millimetres_metres_and_kilometres(make_scene: Callable[..., Scene]) -> None:
    """Within 0.2 dB: rays agree to an ulp or two, which a training makes larger."""
    scene = make_scene()
    normalisation = Normalisation.of(scene)
    one_step = Step.of(load_config(overrides=SMALL), SceneFacts(normalisation))
    seed, step, psnr = jnp.asarray(0, jnp.int32), None, []
    for factor in (1.0, 1e3, 1e-3):
        other = enlarged(scene, factor)
        found = Normalisation.of(other)
        assert found.bounded == normalisation.bounded and found.near == pytest.approx(normalisation.near, rel=1e-12)
        assert found.scale * factor == pytest.approx(normalisation.scale, rel=1e-12)
        pixels = loaded(other, found)
        if step is None:
            reference = pixels
            step = one_step.compiled(one_step.initial(jax.random.key(0)), pixels, xla_backend_optimization_level=0)
        for one, same in zip(jax.tree.leaves(pixels), jax.tree.leaves(reference), strict=True):
            np.testing.assert_allclose(one, same, rtol=2e-6, atol=1e-6)
        state = one_step.initial(jax.random.key(0))
        for chunk in range(5):
            progress = jnp.asarray(0.1 + 0.2 * chunk, jnp.float32)
            state, terms = step(state, pixels, seed, progress, jnp.asarray(6, jnp.int32), jnp.asarray(True), jnp.asarray(True))
        psnr.append(-10 * np.log10(float(terms["mse"])))
    assert np.ptp(psnr) < 0.2, psnr


@pytest.mark.parametrize(("near", "far"), [(1e-6, 1e6), (1e-6, 2e-6), (1e5, 1e6)])
def test_any_planes_of_depth_make_a_normalisation(make_scene: Callable[..., Scene], near: float, far: float) -> None:
    normalisation = Normalisation.of(replace(make_scene(), near=near, far=far))
    assert np.isfinite([normalisation.near, normalisation.far, normalisation.scale]).all()
    assert normalisation.far <= 1e3


def test_what_a_mask_hides_may_be_anything(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(mask=True)
    view = scene.views[1]
    shown = view.read()
    holed = images.read(view.image).astype(np.float32)
    holed[shown[..., 3] == 0] = np.nan
    path = view.image.with_suffix(".exr")
    images.write(path, images.linear_from_srgb(holed))
    for scale in (1.0, 0.5):
        picture = read_scaled(replace(view, image=path), scale)
        assert np.isfinite(picture).all()
        np.testing.assert_allclose(
            picture[..., :3] * picture[..., 3:], (read_scaled(view, scale)[..., :3] * picture[..., 3:]), atol=2e-3
        )
    holed[30, 40] = np.nan  # in the middle of the object
    images.write(path, images.linear_from_srgb(holed))
    with pytest.raises(DatasetError, match="not finite"):
        read_scaled(replace(view, image=path), 1.0)


def test_light_that_half_precision_cannot_hold_stays_finite(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene(count=2)
    glaring = np.full((72, 96, 3), 1e30, np.float32)
    images.write(tmp_path / "sun.exr", glaring)
    bright = scene.with_views(tuple(replace(view, image=tmp_path / "sun.exr", split="train") for view in scene.views))
    pixels = loaded(bright, Normalisation.of(bright))
    assert np.isfinite(np.asarray(pixels.colour)).all() and float(pixels.colour.max()) == pytest.approx(BRIGHTEST, rel=1e-3)
