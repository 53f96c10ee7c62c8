"""A chrome ball, whose material is exactly known, in light it was not photographed in: formula and path tracer agree."""

from dataclasses import replace

import numpy as np
import pytest
from trimesh.creation import icosphere

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.mitsuba_variant import SURE
from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.output.proof import relighting
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.path_tracing import trial
from koala3d.reconstruct.path_tracing.reading import StoredAsset
from koala3d.reconstruct.rendered.light import Light
from koala3d.reconstruct.rendered.shiny import RADIUS_M, chrome_ball
from koala3d.reconstruct.rendered.views import Traced


def chrome() -> StoredAsset:
    """The solid of `chrome_ball`, in a frame with y up whose origin is below it."""
    mesh, even = icosphere(subdivisions=4), np.ones((4, 4, 1), np.float32)
    points, radius = np.asarray(mesh.vertices), 0.8 * RADIUS_M
    frame = assets.base_from_asset(np.array([[-radius] * 3, [radius] * 3]))
    return replace(
        trial.ball(),
        vertices=radius * points - np.linalg.inv(frame)[:3, 3] * [0, -1, 0],
        normals=points,
        uv=points[:, :2] / 2 + 0.5,
        faces=np.asarray(mesh.faces),
        base_colour=np.array([0.88, 0.88, 0.90], np.float32) * even,
        roughness=np.float32((1 / np.sqrt(2 * 400)) ** 0.5) * even,  # concentration 400, see `Surface.levels`
        base_from_asset=frame,
    )


def test_a_chrome_ball_looks_in_another_light_as_the_formula_says(ball: TrainedModel) -> None:
    pytest.importorskip("mitsuba", reason="Mitsuba is absent: pip install 'koala-capture[sim]'")
    places = (pose.look_at(np.array(place), np.zeros(3)) for place in ([0.4, 0.1, 0.2], [-0.1, -0.4, -0.1]))
    views = tuple(replace(ball.scene.views[0], world_from_camera=place) for place in places)
    light = Light.studio(9)
    lit = relighting.TrueLight(9, light, Traced(replace(chrome_ball(), light=light)))
    found = relighting.measure(ball, chrome(), lit, views, paths=32, out=None, using=SURE)
    # At the rim the formula's lobe stays round where GGX's grows long; 32 paths leave noise.
    assert found["psnr_inside"] > 27 and np.allclose(found["gains"], 1, atol=0.06)
    wrong = replace(chrome(), base_from_asset=chrome().base_from_asset @ pose.rigid(np.diag([-1.0, 1, -1]), np.zeros(3)))
    turned = relighting.measure(ball, wrong, lit, views, paths=32, out=None, using=SURE)
    assert turned["psnr_inside"] > 27  # the light's picture turns with the asset's frame


def test_gains_are_those_of_the_light() -> None:
    truth = np.random.default_rng(0).uniform(0.1, 0.9, (8, 8, 4))
    truth[..., 3] = 1
    found = truth * [0.5, 0.25, 2, 1]
    assert np.allclose(relighting.fitted([(truth, found)]), [2, 4, 0.5])


def test_scenes_without_a_formula_are_refused(ball: TrainedModel) -> None:
    with pytest.raises(UsageError, match=r"cannot be shown in another light.*gold_rings"):
        relighting.true_light(ball, 9)
