import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.config import EncodingConfig
from reconstruct.field.cloud import Cloud
from reconstruct.sampling.proposals import Proposal, Spacing, propose
from reconstruct.scene.rays import Normalisation, Rays
from reconstruct.scene.space import BOX


@pytest.mark.parametrize("bounded", [True, False])
def test_spacing_runs_from_near_to_far(bounded: bool) -> None:
    spacing = Spacing.of(Normalisation((0.0, 0.0, 0.0), 1.0, bounded, 0.2, 50.0))
    t = np.asarray(spacing.t(jnp.linspace(0, 1, 200)), np.float64)
    np.testing.assert_allclose(t[[0, -1]], [0.2, 50], rtol=1e-3)  # the ladder's end is flat: 1e-7 there is 1e-4 of t
    lengths = np.diff(t)
    assert (lengths > 0).all()
    if bounded:
        np.testing.assert_allclose(lengths, 49.8 / 199, rtol=1e-4)
    else:
        assert (np.diff(lengths[:-1]) > -1e-3 * lengths[:-2]).all(), "further away, further apart"


def test_samples_gather_where_density_is() -> None:
    """A wall at t in [2, 2.1] that the levels find: the final samples sit there, and each level's weights add up to one."""
    rays = Rays(jnp.zeros((5, 3)), jnp.tile(jnp.array([[0.0, 0.0, 1.0]]), (5, 1)), jnp.full(5, 1e-3))
    spacing = Spacing.of(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.5))
    small = Proposal.create(jax.random.key(1), EncodingConfig(coarsest=8, log2_size=4), 16.0, 0.5)

    def wall(proposal: Proposal, rays: Rays, tdist: jax.Array) -> jax.Array:
        inside = jnp.clip(tdist[:, 1:], 2.0, 2.1) - jnp.clip(tdist[:, :-1], 2.0, 2.1)
        return 300 * inside / jnp.diff(tdist)

    run = jax.jit(lambda key: propose((small, small), rays, spacing, (64, 64, 16), key, wall))
    sdist, levels = run(jax.random.key(0))
    t = np.asarray(spacing.t(sdist))
    assert t.shape == (5, 17)
    assert (np.diff(t) >= 0).all()
    middle = (t[:, 1:] + t[:, :-1]) / 2
    assert np.mean((middle > 1.95) & (middle < 2.15)) > 0.9
    assert [edges.shape for edges, _ in levels] == [(5, 65), (5, 65)]
    for _, weights in levels:
        np.testing.assert_allclose(weights.sum(-1), 1, atol=0.01)  # 30 optical depths, of which the last interval may miss some
    np.testing.assert_array_equal(run(jax.random.key(0))[0], sdist)
    assert (run(jax.random.key(1))[0] != sdist).any()


def test_a_proposal_s_resolutions_double_up_to_its_finest() -> None:
    proposal = Proposal.create(jax.random.key(0), EncodingConfig(coarsest=8, log2_size=6), 64.0, 0.5)
    np.testing.assert_allclose(proposal.encoding.resolutions, [8, 16, 32, 64])
    density = jax.jit(lambda p: proposal.density(Cloud(p, None, BOX)))(jnp.zeros((3, 4)))
    assert density.shape == (4,)
    assert (density > 0).all()
