import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import load_config, merged
from koala3d.reconstruct.numerics.safe import linear_from_srgb
from koala3d.reconstruct.rendering.model import Model, Rendered
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from tests import drawn

FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))
SMALL = {"encoding": {"levels": 2, "log2_size": 6}, "field": {"spatial_width": 4, "view_width": 4, "bottleneck": 2}}


def some_rendered(rgb: list[list[float]], opacity: list[float]) -> Rendered:
    nothing = np.zeros((len(opacity), 3))
    alone = nothing[:, 0]
    return Rendered(*map(drawn.array, (rgb, opacity, nothing, nothing, alone, nothing, alone, nothing[:, :1])))


EXPOSED = jax.jit(lambda seen, gains: seen.exposed(gains).rgb)
LIGHT = jax.jit(linear_from_srgb)


def test_a_gain_multiplies_the_light_of_the_foreground() -> None:
    """One stop more is twice the linear light, whatever the opacity; an empty ray stays empty."""
    seen = some_rendered([[0.5, 0.2, 0.01], [0.25, 0.1, 0.005], [0.0, 0.0, 0.0]], [1.0, 0.5, 0.0])
    brighter = np.asarray(EXPOSED(seen, np.full((3, 1), np.log(2.0), np.float32)))
    rgb = np.asarray(seen.rgb)
    np.testing.assert_allclose(np.asarray(LIGHT(brighter))[:1], 2 * np.asarray(LIGHT(rgb))[:1], rtol=1e-4)
    np.testing.assert_allclose(brighter[1], brighter[0] / 2, rtol=1e-5)
    np.testing.assert_allclose(brighter[2], 0, atol=1e-6)
    np.testing.assert_allclose(EXPOSED(seen, np.zeros((3, 3), np.float32)), rgb, atol=1e-6)
    redder = np.asarray(EXPOSED(seen, np.float32(np.log([[2.0, 1.0, 1.0]] * 3))))
    np.testing.assert_allclose(redder[0, 1:], rgb[0, 1:], rtol=1e-5)
    gradient = jax.jit(jax.grad(lambda g: jnp.sum(seen.exposed(g).rgb)))(np.zeros((3, 1), np.float32))
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize(("kind", "shape"), [("none", None), ("exposure", (5, 1)), ("colour", (5, 3))])
def test_gains_and_proposals_are_there_where_they_are_wanted(kind: str, shape: tuple | None) -> None:
    tree = merged(load_config().model_dump(), merged(SMALL, {"train": {"per_image": kind}}))
    created = lambda views: eqx.filter_eval_shape(  # noqa: E731
        lambda: Model.create(jax.random.key(0), Config.model_validate(tree), FACTS, views)
    )
    model = created(5)
    assert (None if model.per_image is None else model.per_image.shape) == shape and model.sampler.encodings == ()
    tree["sampler"]["kind"] = "proposal"
    assert len(created(0).sampler.encodings) == 2
