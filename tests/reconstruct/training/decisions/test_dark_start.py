from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.sampling.hull import cells_in_masks
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.scene.reading import training_pixels
from koala3d.reconstruct.training.decisions import dark_start
from koala3d.reconstruct.training.decisions.evidence.agreement import FEWEST_VIEWS, agreement, sessions
from tests.small import Trainable

CELLS = 64


@pytest.fixture(scope="module")
def painted(glossy_scene: tuple[Scene, Path]) -> tuple[Pixels, np.ndarray]:
    """Pixels of a painted ball with a highlight, and the cells that its masks leave."""
    scene = glossy_scene[0]
    views, normalisation = scene.split("train"), Normalisation.of(scene)
    pixels, _ = training_pixels(views, normalisation, 1.0, None)
    cells = cells_in_masks(pixels, views, normalisation, CELLS, 1.0)
    assert cells is not None
    return pixels, cells


def of_colour(pixels: Pixels, light: np.ndarray) -> Pixels:
    """The same pixels in a grey (n,), encoded as sRGB."""
    grey = jnp.asarray(np.repeat(light[:, None], 3, 1), jnp.float16)
    return replace(pixels, colour=jnp.concatenate([grey, pixels.colour[:, 3:]], -1))


def test_views_agree_on_paint_and_not_on_what_a_mirror_shows(painted: tuple[Pixels, np.ndarray]) -> None:
    pixels, cells = painted
    found = agreement(pixels, cells)
    assert found is not None and found > dark_start.PAINTED  # waves of paint over a cell and a highlight, and still
    shows_lamp = np.random.default_rng(0).random(len(pixels.origins)) < 0.5
    mirror = of_colour(pixels, np.where(shows_lamp[np.asarray(pixels.view)], 0.8, 0.5))
    found = agreement(mirror, cells)
    assert found is not None and 0.3 < found < 0.5  # 0.21 and 0.60 of linear light; some places show one of them alone
    even = agreement(of_colour(pixels, np.full(pixels.total, 0.5)), cells)
    np.testing.assert_allclose(even, 1.0, atol=0.01)  # `DARK` in 0.2


def test_an_object_that_was_turned_over_is_compared_within_each_session(painted: tuple[Pixels, np.ndarray]) -> None:
    """What a lamp brightens in one session it leaves dark in the other."""
    pixels, cells = painted
    count = len(np.unique(np.asarray(pixels.view)))
    assert count >= 2 * FEWEST_VIEWS
    second = np.arange(count) % 2 > 0
    session = sessions(np.where(second[:, None, None], np.diag([1.0, -1, -1]), np.eye(3)))
    assert session is not None and len(np.unique(session)) == 2 and (session[second] == session[1]).all()
    brighter = of_colour(pixels, np.where(second[np.asarray(pixels.view)], 0.8, 0.5))
    mixed, apart = agreement(brighter, cells), agreement(brighter, cells, session)
    assert mixed is not None and mixed < 0.6
    assert apart is not None and apart > 0.98


def test_few_views_of_a_session_are_left_out_and_views_that_all_differ_tell_nothing() -> None:
    turns = np.repeat(np.stack([np.eye(3), np.diag([1.0, -1, -1])]), [2 * FEWEST_VIEWS, FEWEST_VIEWS - 1], 0)
    session = sessions(turns)
    assert session is not None and (session[-FEWEST_VIEWS + 1 :] == -1).all() and (session[: 2 * FEWEST_VIEWS] >= 0).all()
    assert sessions(Rotation.random(12, rng=0).as_matrix()) is None
    assert sessions(None) is None


def test_too_few_pixels_tell_nothing(painted: tuple[Pixels, np.ndarray]) -> None:
    pixels, cells = painted
    assert agreement(pixels, np.zeros_like(cells)) is None


def test_the_overlay_for_paint_holds_where_views_agree(trainable: Trainable) -> None:
    config = trainable.step.config
    assert config.kinds == ("blank", "painted")
    assert (config.field.diffuse_bias, config.field.specular_bias) == (-1.1, 0)


def test_a_model_without_reflections_has_no_question(painted: tuple[Pixels, np.ndarray]) -> None:
    for model in ("zipnerf", "refnerf"):  # no reflection; no such overlay
        skip = dark_start.decided(*painted, load_config(model))
        assert not skip.skipped and "one start for all" in skip.evidence
    assert "without masks" in dark_start.decided(painted[0], None, load_config()).evidence
