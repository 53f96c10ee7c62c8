import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import EncodingConfig
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.sampling.proposals import Proposal, Spacing, propose
from koala3d.reconstruct.scene.bounds import Bounds
from koala3d.reconstruct.scene.rays import Rays
from koala3d.reconstruct.scene.space import BALL, BOX
from tests import drawn


@pytest.mark.parametrize("bounded", [True, False])
def test_spacing_runs_from_near_to_far(bounded: bool) -> None:
    spacing = Spacing.of(Bounds(drawn.array(0.2), drawn.array(50.0), None), BOX if bounded else BALL)
    t = np.asarray(jax.jit(lambda s: spacing.t(s))(np.linspace(0, 1, 200, dtype=np.float32)), np.float64)
    np.testing.assert_allclose(t[[0, -1]], [0.2, 50], rtol=1e-3)  # the ladder's end is flat: 1e-7 there is 1e-4 of t
    lengths = np.diff(t)
    assert (lengths > 0).all()
    if bounded:
        np.testing.assert_allclose(lengths, 49.8 / 199, rtol=1e-4)
    else:
        assert (np.diff(lengths[:-1]) > -1e-3 * lengths[:-2]).all(), "further away, further apart"


def test_samples_gather_where_density_is() -> None:
    """A wall at t in [2, 2.1] that the levels find: the final samples sit there, and each level's weights add up to one."""
    rays = Rays(*map(drawn.array, (np.zeros((5, 3)), np.tile([0.0, 0.0, 1.0], (5, 1)), np.full(5, 1e-3))))
    spacing = Spacing.of(Bounds(drawn.array(0.5), drawn.array(4.5), None), BOX)
    small = drawn.filled(lambda: Proposal.create(jax.random.key(1), EncodingConfig(coarsest=8, log2_size=4), 16.0, 0.5))

    def wall(proposal: Proposal, rays: Rays, tdist: jax.Array) -> jax.Array:
        inside = jnp.clip(tdist[:, 1:], 2.0, 2.1) - jnp.clip(tdist[:, :-1], 2.0, 2.1)
        return 300 * inside / jnp.diff(tdist)

    @jax.jit
    def run(seed: int) -> tuple[jax.Array, jax.Array, list]:
        sdist, levels = propose((small, small), rays, spacing, (64, 64, 16), jax.random.key(seed), wall)
        return sdist, spacing.t(sdist), levels

    sdist, t, levels = jax.tree.map(np.asarray, run(0))
    assert t.shape == (5, 17)
    assert (np.diff(t) >= 0).all()
    middle = (t[:, 1:] + t[:, :-1]) / 2
    assert np.mean((middle > 1.95) & (middle < 2.15)) > 0.9
    assert [edges.shape for edges, _ in levels] == [(5, 65), (5, 65)]
    for _, weights in levels:
        np.testing.assert_allclose(weights.sum(-1), 1, atol=0.01)  # 30 optical depths, of which the last interval may miss some
    np.testing.assert_array_equal(run(0)[0], sdist)
    assert (np.asarray(run(1)[0]) != sdist).any()


def test_a_proposal_s_resolutions_double_up_to_its_finest() -> None:
    proposal = drawn.filled(lambda: Proposal.create(jax.random.key(0), EncodingConfig(coarsest=8, log2_size=6), 64.0, 0.5))
    np.testing.assert_allclose(proposal.encoding.resolutions, [8, 16, 32, 64])
    density = np.asarray(jax.jit(lambda p: proposal.density(Cloud(p, None, BOX)))(np.zeros((3, 4), np.float32)))
    assert density.shape == (4,)
    assert (density > 0).all()
