"""What is measured on a scene, and what a configuration says instead."""

import functools
import json
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation

SMALL = ["encoding.levels=2", "encoding.log2_size=8", "sampler.grid=16"]


def facts_of(scene: Scene) -> SceneFacts:
    return SceneFacts.of(scene, scene.views, Normalisation.of(scene))


def fresh(facts: SceneFacts, *overrides: str) -> Model:
    return Model.create(jax.random.key(0), load_config("surfnerf", "fast", [*SMALL, *overrides]), facts)


def created(facts: SceneFacts, *overrides: str) -> Model:
    """With shapes in place of its arrays."""
    return eqx.filter_eval_shape(lambda: fresh(facts, *overrides))


def test_the_box_among_surroundings_is_measured(ball_scene: tuple[Scene, Path]) -> None:
    alone = ball_scene[0]
    low, high = alone.box
    among = replace(alone, background="scene", box=np.stack([low, high - [0, 0, 0.1]]))
    found = facts_of(among)
    np.testing.assert_allclose(found.half_box, [2 / 3, 2 / 3, 1 / 3])  # 0.2 x 0.2 x 0.1 m has a diagonal of 0.3 m: the unit ball
    assert found.towards is not None and np.linalg.norm(found.towards) < 1
    assert facts_of(alone).half_box is None


def test_facts_survive_being_written(ball_scene: tuple[Scene, Path]) -> None:
    for scene in (ball_scene[0], replace(ball_scene[0], background="scene")):
        for facts in (found := facts_of(scene), found.with_gains(np.array([[0.1, 0.2, 0.3], [0.0, 0.0, -1.0]]))):
            assert SceneFacts.from_json(json.loads(json.dumps(facts.to_json()))) == facts


@pytest.mark.parametrize(
    ("background", "bounds_from", "preferred"),
    [
        ("scene", "stated", True),
        ("scene", "box stated; near from 172 points", True),
        ("scene", "cameras alone", False),
        ("white", "stated", False),
    ],
)
def test_rays_that_meet_a_stated_box_are_preferred(
    ball_scene: tuple[Scene, Path], background: str, bounds_from: str, preferred: bool
) -> None:
    """A box that is only guessed may hold anything, and without surroundings there is nothing to prefer it to."""
    facts = facts_of(replace(ball_scene[0], background=background, bounds_from=bounds_from))
    sampler = created(facts).sampler
    assert sampler.prefers_object == preferred
    assert (sampler.bounds.half_box is None) == (background == "white")


def test_gains_begin_as_they_were_measured(ball_scene: tuple[Scene, Path]) -> None:
    measured = np.array([[0.1, 0.2, 0.3], [0.4, 0.4, 0.4]])
    facts = facts_of(ball_scene[0]).with_gains(measured)
    assert created(facts).per_image is None, "the configuration wants none"

    @functools.partial(jax.jit, static_argnums=0)
    def gains(kind: str) -> tuple[jax.Array, jax.Array]:
        model = fresh(facts, f"train.per_image={kind}")
        assert model.per_image is not None
        return model.per_image, model.log_gains

    np.testing.assert_allclose(gains("colour")[0], measured, rtol=1e-6)
    one, log_gains = gains("exposure")
    np.testing.assert_allclose(one, [[0.2], [0.4]], rtol=1e-6)
    np.testing.assert_allclose(log_gains, [[-0.1], [0.1]], atol=1e-6)  # counted from their mean
