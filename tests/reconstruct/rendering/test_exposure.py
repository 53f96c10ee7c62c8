import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets.imaging.images import linear_from_srgb, srgb_from_linear
from koala3d.reconstruct.rendering.exposure import across_halves, exposed, left_half
from koala3d.reconstruct.rendering.model import Rendered
from tests import drawn

GAIN = np.log([1.8, 1.3, 0.7])


@pytest.fixture
def shown() -> dict[str, np.ndarray]:
    """A picture of 40 x 30 with an opacity from nothing to all, over white."""
    random = np.random.default_rng(0)
    opacity = np.clip(np.linspace(-0.2, 1.2, 40), 0, 1)[None, :, None].repeat(30, 0)
    return {"rgb": random.uniform(0.05, 0.7, (30, 40, 3)) * opacity + 1 - opacity, "opacity": opacity}


def test_a_gain_acts_on_linear_light_as_in_training(shown: dict[str, np.ndarray]) -> None:
    rgb, opacity = shown["rgb"].reshape(-1, 3), shown["opacity"].reshape(-1, 1)
    dark, own, count = 0 * rgb, rgb - (1 - opacity), np.zeros(len(rgb))
    model = Rendered(*map(drawn.array, (own, opacity[:, 0], dark, dark, count, dark, count, dark)))
    trained = np.asarray(jax.jit(lambda model, gain: model.exposed(gain).over(jnp.ones((1, 3))))(model, np.float32(GAIN)[None]))
    found = exposed(rgb, opacity, 1.0, GAIN)
    dim = trained.max(-1) < 1  # there training leaves the light above 1
    assert dim.sum() > 600 and np.abs(found - trained)[dim].max() < 1e-5  # float32
    opaque = opacity[:, 0] == 1
    assert np.allclose(linear_from_srgb(found[opaque]), np.minimum(linear_from_srgb(rgb[opaque]) * np.exp(GAIN), 1), atol=1e-5)


@pytest.mark.parametrize("gains", [1, 3])
def test_each_half_gets_the_exposure_of_the_other(shown: dict[str, np.ndarray], gains: int) -> None:
    left = left_half(30, 40)
    truth = np.where(left[..., None], *(exposed(shown["rgb"], shown["opacity"], 1.0, g) for g in (GAIN[:gains], -GAIN[:gains])))
    rgb, fits = across_halves(shown, truth, left, 1.0, gains)
    np.testing.assert_allclose(fits, [GAIN[:gains], -GAIN[:gains]], atol=0.01)  # the search ends at 0.001
    np.testing.assert_allclose(rgb[left], exposed(shown["rgb"], shown["opacity"], 1.0, -GAIN[:gains])[left], atol=0.01)
    np.testing.assert_allclose(rgb[~left], exposed(shown["rgb"], shown["opacity"], 1.0, GAIN[:gains])[~left], atol=0.01)


def test_what_is_measured_was_not_fitted_on(shown: dict[str, np.ndarray]) -> None:
    """Whatever a half shows does not change its own colours."""
    left = left_half(30, 40)
    truth = exposed(shown["rgb"], shown["opacity"], 1.0, GAIN)
    changed = np.where(left[..., None], np.float32(0.9), truth)
    first, second = (across_halves(shown, one, left, 1.0, 3)[0] for one in (truth, changed))
    assert np.array_equal(first[left], second[left]) and np.abs(first[~left] - second[~left]).max() > 0.05


def test_pictures_that_show_nothing_keep_their_colours(shown: dict[str, np.ndarray]) -> None:
    empty = {"rgb": np.ones((30, 40, 3), np.float32), "opacity": np.zeros((30, 40, 1), np.float32)}
    rgb, fits = across_halves(empty, shown["rgb"], left_half(30, 40), 1.0, 3)
    assert np.array_equal(rgb, empty["rgb"]) and np.array_equal(fits, np.zeros((2, 3)))


def test_light_is_clipped_as_a_camera_clips_it() -> None:
    white = srgb_from_linear(np.full((1, 3), 0.8))
    assert np.array_equal(exposed(white, np.ones((1, 1)), 0.0, np.log([2.0])), np.ones((1, 3)))
