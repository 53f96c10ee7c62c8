import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.scene.contraction import contract
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.scene.space import BALL, BOX
from tests import drawn
from tests.small import in_scene

CELL = jax.jit(Occupancy.cell)


def occupied(occupancy: Occupancy) -> np.ndarray:
    return np.asarray(occupancy.depth) > 0


@pytest.mark.parametrize("bounded", [True, False])
def test_updates_find_a_ball_and_forget_what_has_gone(bounded: bool) -> None:
    occupancy = Occupancy.create(0, grid=16, outer_grid=8, space=BOX if bounded else BALL, steps=32, possible=None)
    assert np.sum(occupied(occupancy)) > 2000

    @jax.jit
    def looked_at(occupancy: Occupancy, seed: int, x: float, radius: float) -> Occupancy:
        """After so many updates before a ball."""

        def look(key: jax.Array, occupancy: Occupancy) -> Occupancy:
            inside = lambda p: jnp.linalg.norm(p - jnp.array([[1.0], [0], [0]]) * x, axis=0) < radius  # noqa: E731
            return occupancy.updated(lambda p: jnp.where(inside(p), 50.0, 0.0), key, 1500, 0.01)

        keys = jax.random.split(jax.random.key(seed), 120)
        return jax.lax.fori_loop(0, 120, lambda i, occupancy: look(keys[i], occupancy), occupancy)

    def at(*places: tuple[float, float, float]) -> list[bool]:
        return occupied(occupancy)[np.asarray(CELL(occupancy, *np.float32(places).T))].tolist()

    occupancy = looked_at(occupancy, 1, 0.0, 0.5)
    assert at((0.0, 0.0, 0.0), (0.3, -0.2, 0.1), (0.9, 0.0, 0.0), (-0.6, 0.6, 0.6)) == [True, True, False, False]
    share = occupied(occupancy)[: 16**3].mean()
    ball_share = 4 / 3 * np.pi * 0.5**3 / 8
    assert ball_share <= share < 2 * ball_share, "the ball's cells and those that it cuts"
    occupancy = looked_at(occupancy, 2, 0.7, 0.15)
    found = at((0.7, 0.0, 0.0), (0.0, 0.0, 0.0), (-0.3, -0.2, 0.1), (-0.6, 0.6, 0.6))
    assert found == [True, False, False, False], "what has gone is forgotten"
    assert occupied(occupancy)[: 16**3].mean() < 0.02


def test_update_points_lie_in_their_cells() -> None:
    occupancy = Occupancy.create(0, grid=6, outer_grid=8, space=BALL, steps=32, possible=None)
    cells = np.asarray(occupancy.visits)
    points = np.asarray(jax.jit(Occupancy._points)(occupancy, cells, drawn.uniform(3, len(cells), low=0.01, high=0.99)))
    outside = cells >= 6**3
    covered_twice = outside & (np.abs(points).max(0) < 1)  # the inner grid answers for these
    np.testing.assert_array_equal(np.asarray(CELL(occupancy, *points))[~covered_twice], cells[~covered_twice])
    assert (~covered_twice & outside).sum() > 100


def test_masks_rule_cells_out_for_good() -> None:
    possible = np.zeros(8**3, bool)
    possible[100:200] = True
    occupancy = Occupancy.create(0, grid=8, outer_grid=8, space=BOX, steps=32, possible=possible)
    look = jax.jit(lambda o, key: o.updated(lambda p: jnp.full(p.shape[1], 1e3), key, 60, 0.01))
    for key in jax.random.split(jax.random.key(1), 4):
        occupancy = look(occupancy, key)
    np.testing.assert_array_equal(occupied(occupancy), possible)


def test_densities_that_training_met_are_kept() -> None:
    occupancy = Occupancy.create(0, grid=8, outer_grid=8, space=BOX, steps=32, possible=np.zeros(512, bool))
    occupancy = jax.jit(Occupancy.noted)(occupancy, np.int32([3, 3, 7]), np.float32([5.0, 2.0, 1.0]))
    np.testing.assert_array_equal(np.asarray(occupancy.density)[[3, 7, 8]], [5, 1, 0])


def test_the_outer_extent_is_a_step_in_the_scene() -> None:
    """A cell of the contracted surroundings stands for a step that contraction shrinks: checked radially by differences."""
    occupancy = Occupancy.create(0, grid=8, outer_grid=32, space=BALL, steps=32, possible=None)
    points = np.float32([[radius, 0.05, 0.05] for radius in (1.2, 2.0, 5.0)])
    contracted = jax.jit(contract)
    step = np.float32([0.01, 0, 0])
    shrink = (np.asarray(contracted(points + step)) - np.asarray(contracted(points - step)))[:, 0] / 0.02
    cells = CELL(occupancy, *np.asarray(contracted(points)).T)
    extent = np.asarray(occupancy.extent)[np.asarray(cells)]
    np.testing.assert_allclose(extent, 4 / 32 / shrink, rtol=0.25)  # the cell's centre is up to half a cell away


def test_cells_are_kept_longer_where_masks_have_ruled_out_most() -> None:
    small = ["encoding.levels=1", "encoding.log2_size=4", "field.spatial_width=4", "field.view_width=4", "sampler.grid=8"]
    facts = lambda bounded: SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, bounded, 0.5, 4.5))  # noqa: E731
    config = {bounded: in_scene(load_config(overrides=small), facts(bounded)) for bounded in (True, False)}
    samplers = [
        eqx.filter_eval_shape(lambda b=bounded: Model.create(jax.random.key(0), config[b], facts(b))).sampler
        for bounded in config
    ]
    assert [sampler.empty_below for sampler in samplers] == pytest.approx([0.005, 0.05])
