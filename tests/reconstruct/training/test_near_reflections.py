"""A training that casts its reflected rays and learns how far its lamps are: every part takes part, and nothing is not finite."""

import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from tests.small import Trainable, small

CHANGES = {
    "field": {"density_bias": 3.0, "roughness_bias": -5.0},
    "light": {"cast": 4, "cast_from": 0.4, "parallax": 4.0, "parallax_learned": True},
}


@pytest.mark.slow
def test_a_training_that_casts_stays_finite_and_learns_the_radius(ball_scene: tuple[Scene, object]) -> None:
    trainable = Trainable.on(small(changes=CHANGES), ball_scene[0])
    state, shares, losses = trainable.start, [], []
    for i in range(10):
        state, (terms,) = trainable.trained(1, state, second=lambda _, i=i: i == 5, done=lambda _, i=i: i / 10)
        assert state.model.casting is not None
        shares.append(float(state.model.casting.cast_share))
        losses.append(terms)
    assert int(state.skipped) == 0 and all(np.isfinite(list(line.values())).all() for line in losses)
    np.testing.assert_allclose(shares, np.clip((np.arange(10) / 10 - 0.4) / 0.1, 0, 1), atol=1e-5)
    assert losses[0]["normal_consistency"] == 0 < losses[5]["normal_consistency"]
    before, after = (s.model.field.appearance.parallax for s in (trainable.start, state))
    assert before is not None and after is not None and float(before.logit) != float(after.logit)
