import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reconstruct.models import load_config
from reconstruct.rendering.model import Model
from reconstruct.sampling.occupancy import Occupancy
from reconstruct.scene.contraction import contract
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.rays import Normalisation
from reconstruct.scene.space import BALL, BOX


@pytest.mark.parametrize("bounded", [True, False])
def test_updates_find_a_ball_and_forget_what_has_gone(bounded: bool) -> None:
    occupancy = Occupancy.create(0, grid=16, outer_grid=8, space=BOX if bounded else BALL, steps=32, possible=None)
    assert occupancy.occupied.sum() > 2000

    @jax.jit
    def look(occupancy: Occupancy, key: jax.Array, x: float, radius: float) -> Occupancy:
        return occupancy.updated(
            lambda p: jnp.where(jnp.linalg.norm(p - jnp.array([[1.0], [0], [0]]) * x, axis=0) < radius, 50.0, 0.0),
            key,
            1500,
            0.01,
        )

    for key in jax.random.split(jax.random.key(1), 120):
        occupancy = look(occupancy, key, 0.0, 0.5)
    at = lambda *p: int(occupancy.occupied[occupancy.cell(*jnp.asarray(p, jnp.float32))])  # noqa: E731
    assert at(0.0, 0.0, 0.0) == at(0.3, -0.2, 0.1) == 1
    assert at(0.9, 0.0, 0.0) == at(-0.6, 0.6, 0.6) == 0
    share = float(occupancy.occupied[: 16**3].mean())
    ball_share = 4 / 3 * np.pi * 0.5**3 / 8
    assert ball_share <= share < 2 * ball_share, "the ball's cells and those that it cuts"
    for key in jax.random.split(jax.random.key(2), 120):
        occupancy = look(occupancy, key, 0.7, 0.15)
    assert at(0.7, 0.0, 0.0) == 1
    assert at(0.0, 0.0, 0.0) == at(-0.3, -0.2, 0.1) == 0, "what has gone is forgotten"
    assert occupancy.occupied[: 16**3].mean() < 0.02


def test_update_points_lie_in_their_cells() -> None:
    occupancy = Occupancy.create(0, grid=6, outer_grid=8, space=BALL, steps=32, possible=None)
    cells = occupancy.visits
    points = occupancy._points(cells, jax.random.uniform(jax.random.key(1), (3, len(cells)), minval=0.01, maxval=0.99))
    outside = np.asarray(cells) >= 6**3
    covered_twice = outside & (np.abs(points).max(0) < 1)  # the inner grid answers for these
    np.testing.assert_array_equal(occupancy.cell(*points)[~covered_twice], cells[~covered_twice])
    assert (~covered_twice & outside).sum() > 100


def test_masks_rule_cells_out_for_good() -> None:
    possible = np.zeros(8**3, bool)
    possible[100:200] = True
    occupancy = Occupancy.create(0, grid=8, outer_grid=8, space=BOX, steps=32, possible=possible)
    look = jax.jit(lambda o, key: o.updated(lambda p: jnp.full(p.shape[1], 1e3), key, 60, 0.01))
    for key in jax.random.split(jax.random.key(1), 4):
        occupancy = look(occupancy, key)
    np.testing.assert_array_equal(np.asarray(occupancy.occupied, bool), possible)


def test_densities_that_training_met_are_kept() -> None:
    occupancy = Occupancy.create(0, grid=8, outer_grid=8, space=BOX, steps=32, possible=np.zeros(512, bool))
    occupancy = occupancy.noted(jnp.array([3, 3, 7]), jnp.array([5.0, 2.0, 1.0]))
    np.testing.assert_array_equal(occupancy.density[jnp.array([3, 7, 8])], [5, 1, 0])


def test_the_outer_extent_is_a_step_in_the_scene() -> None:
    """A cell of the contracted surroundings stands for a step that contraction shrinks: checked radially by differences."""
    occupancy = Occupancy.create(0, grid=8, outer_grid=32, space=BALL, steps=32, possible=None)
    for radius in (1.2, 2.0, 5.0):
        point = jnp.array([radius, 0.05, 0.05])
        shrink = float((contract(point + jnp.array([0.01, 0, 0])) - contract(point - jnp.array([0.01, 0, 0])))[0]) / 0.02
        cell = occupancy.cell(*contract(point))
        np.testing.assert_allclose(
            occupancy.extent[cell], 4 / 32 / shrink, rtol=0.25
        )  # the cell's centre is up to half a cell away


def test_cells_are_kept_longer_where_masks_have_ruled_out_most() -> None:
    small = ["encoding.levels=1", "encoding.log2_size=4", "field.spatial_width=4", "field.view_width=4", "sampler.grid=8"]
    config = load_config(overrides=[*small, "sampler.outer_grid=8", "sampler.optical_depth=0.05"])
    facts = lambda bounded: SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, bounded, 0.5, 4.5))  # noqa: E731
    samplers = [Model.create(jax.random.key(0), config, facts(bounded)).sampler for bounded in (True, False)]
    assert [sampler.empty_below for sampler in samplers] == pytest.approx([0.005, 0.05])
