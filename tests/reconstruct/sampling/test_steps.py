import jax
import numpy as np
import pytest

from koala3d.reconstruct.sampling.steps import BEHIND, FRONT, Steps

AT = jax.jit(Steps.at)


@pytest.mark.parametrize("bounded", [True, False])
def test_steps_ascend_and_cover_what_they_promise(bounded: bool, some_rays, steps_of) -> None:
    rays = some_rays(64)
    steps = steps_of(rays, bounded)
    t = np.asarray(AT(steps, np.tile(np.linspace(0, steps.count, 500, dtype=np.float32), (64, 1))), np.float64)
    assert np.isfinite(t).all()
    assert (np.diff(t, axis=-1) >= -1e-5).all()  # rounding at the joints of the parts, t up to 100
    assert (t[:, 0] >= 0.05 - 1e-6).all()
    points = np.asarray(rays.origins)[:, None] + t[..., None] * np.asarray(rays.directions)[:, None]
    if bounded:
        hits = np.asarray(steps.leave) > np.asarray(steps.enter)
        assert 40 < hits.sum() < 64, "some rays hit and some miss"
        assert np.abs(points[hits]).max() <= 1 + 1e-5
        surface = np.abs(points[hits][:, [0, -1]]).max(-1)
        np.testing.assert_allclose(surface, 1, atol=1e-5)
    else:
        assert steps.count == FRONT + 64 + BEHIND
        np.testing.assert_allclose(t[:, 0], 0.05, atol=1e-6)
        np.testing.assert_allclose(t[:, -1], 100, rtol=1e-5)
        hits = np.asarray(steps.leave) > np.asarray(steps.enter)
        ends = (
            np.asarray(rays.origins)[:, None]
            + np.stack([steps.enter, steps.leave], -1)[..., None] * np.asarray(rays.directions)[:, None]
        )
        np.testing.assert_allclose(np.linalg.norm(ends[hits], axis=-1), 1, atol=1e-5)
