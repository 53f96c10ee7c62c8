from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.core.progress import ignore
from koala3d.datasets.imaging.images import linear_from_srgb, srgb_from_linear
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.probe import PIXELS, Probe
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.poses import refined, session_of
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from tests.reconstruct.two_sessions import of_two_sessions


class Silent:
    """A bar of progress that shows nothing."""

    advance = staticmethod(ignore)


def brighter(colour: np.ndarray, gain: float, alpha: np.ndarray) -> np.ndarray:
    """Colours over white whose foreground has another exposure."""
    own = (colour - (1 - alpha)) / np.maximum(alpha, 1e-3)
    return srgb_from_linear(linear_from_srgb(np.clip(own, 0, 1)) * gain) * alpha + 1 - alpha


@pytest.fixture
def probe(ball: TrainedModel) -> Probe:
    found = Probe.of(ball.scene, ball.run.config, ball.run.normalisation)
    assert found is not None
    return found


def test_the_probe_knows_views_and_halves(ball: TrainedModel, probe: Probe) -> None:
    assert set(probe.view) == {0, 1} and len(probe.view) == 2 * 48 * 40, "all pixels, where there are few"
    assert np.mean(probe.left) == 0.5
    for view, one in enumerate(ball.scene.split("test")):
        right = one.world_from_camera[:3, 0]
        across = probe.directions[probe.view == view] @ right
        assert across[probe.left[probe.view == view]].max() < across[~probe.left[probe.view == view]].min()


def test_the_probe_fits_the_exposure_only_where_views_have_gains(ball: TrainedModel, probe: Probe) -> None:
    before = probe.psnr(ball.model, ball.renderer)
    shown = ball.renderer.rays(ball.model, probe.origins, probe.directions, probe.radii)
    gain = np.where(probe.view == 0, 1.6, 0.7)[:, None]
    bright = probe._replace(colour=brighter(probe.colour, gain, shown["opacity"]))
    learned = replace(ball.model, per_image=jnp.zeros((4, 1)))
    assert bright.psnr(ball.model, ball.renderer) < before - 3
    assert bright.psnr(learned, ball.renderer) == pytest.approx(before, abs=1.0)  # the rim's error has another exposure too


def test_the_probe_moves_with_an_object_that_was_turned_over(ball: TrainedModel, probe: Probe) -> None:
    """As `TrainedModel` moves the scene's views: the motion that was learned brings back what the poses are off."""
    scene, normalisation = of_two_sessions(ball.scene), ball.run.normalisation
    session = SceneFacts(normalisation, session=session_of(scene, normalisation)).free_session
    assert session is not None
    back = replace(session, by=jnp.array([-8.0, 8, 8, 8, -8, 8]))
    found = Probe.of(refined(scene, normalisation, None, back), ball.run.config, normalisation)
    assert found is not None and np.abs(found.origins - probe.origins).max() > 1e-3
    learned = replace(ball.model, session=replace(session, by=-back.by))
    expected, off = (one.psnr(ball.model, ball.renderer) for one in (probe, found))
    assert off < expected - 0.3
    assert found.psnr(learned, ball.renderer) == pytest.approx(expected, abs=0.1 * (expected - off))


def test_without_test_views_there_is_no_probe(ball: TrainedModel) -> None:
    scene = ball.scene.with_views(ball.scene.split("train"))
    assert Probe.of(scene, ball.run.config, ball.run.normalisation) is None


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_the_probe_is_a_random_part_of_the_unseen_pixels(make_scene: Callable[..., Scene], scale: float) -> None:
    """The reference holds all the pixels, and draws from them."""
    scene = make_scene(count=9, truth=False)
    normalisation = Normalisation.of(scene)
    unseen = tuple(view for view in scene.views if view.split == "test")
    assert len(unseen) == 3
    everything = Pixels.load(unseen, normalisation, scale, Silent())
    total = len(everything.view)
    index = np.random.default_rng(0).choice(total, min(PIXELS, total), replace=False)
    found = Probe.of(scene, load_config(overrides=[f"scale={scale}"]), normalisation)
    assert found is not None
    for one, other in zip(found[:5], everything.over_white(index), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(found.view, np.asarray(everything.view)[index])
