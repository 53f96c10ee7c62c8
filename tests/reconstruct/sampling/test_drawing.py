"""What the occupancy grid expects of steps, and how likely each is drawn."""

import jax
import numpy as np
import pytest

from koala3d.reconstruct.sampling.drawing import LEAST_IMPORTANCE, draw, draw_probability, expected_depth
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.sampling.steps import FRONT, Steps
from koala3d.reconstruct.scene.space import BALL, BOX

DEPTH = jax.jit(expected_depth, static_argnums=4)
PROBABILITY = jax.jit(draw_probability, static_argnums=1)
WITH = jax.jit(Occupancy.with_occupied)


def test_a_camera_inside_the_ball_expects_nothing_of_steps_of_no_length(some_rays, steps_of) -> None:
    """Nothing lies between the near plane and the ball there, so that nothing may be drawn from it."""
    rays = some_rays(16, distance=0.3)
    steps = steps_of(rays, bounded=False)
    np.testing.assert_array_equal(steps.enter, steps.near)
    occupancy = Occupancy.create(0, grid=16, outer_grid=8, space=BALL, steps=32, possible=None)
    depth = np.asarray(DEPTH(occupancy, rays, steps, np.full(16, 0.5, np.float32), BALL))
    assert not (depth[:, :FRONT] > 0).any()
    assert (depth[:, FRONT:] > 0).any(-1).all()


@pytest.mark.parametrize("bounded", [True, False])
def test_expected_depth_equals_a_loop(bounded: bool, some_rays, steps_of) -> None:
    rays, grid, outer = some_rays(24), 12, 10
    occupancy = Occupancy.create(0, grid=grid, outer_grid=outer, space=BOX if bounded else BALL, steps=32, possible=None)
    rng = np.random.default_rng(1)
    flags = rng.random(occupancy.occupied.shape) < 0.4
    occupancy = WITH(occupancy, flags)
    steps, jitter = steps_of(rays, bounded, 32), np.float32(rng.random(24))
    found = np.asarray(DEPTH(occupancy, rays, steps, jitter, BOX if bounded else BALL)) > 0
    t = np.asarray(jax.jit(Steps.at)(steps, np.float32(np.arange(steps.count) + jitter[:, None])), np.float64)
    origins, directions = np.asarray(rays.origins, np.float64), np.asarray(rays.directions, np.float64)
    missed = np.asarray(steps.leave) <= np.asarray(steps.enter)
    clear = occupied = 0
    for ray in range(24):
        for step in range(steps.count):
            if missed[ray] and (bounded or FRONT <= step < FRONT + 32):
                assert not found[ray, step]
                continue
            point = origins[ray] + t[ray, step] * directions[ray]
            radius = np.linalg.norm(point)
            point = point if bounded or radius <= 1 else (2 - 1 / radius) * point / radius
            inner = bounded or np.abs(point).max() < 1
            size, reach = (grid, 1.0) if inner else (outer, 2.0)
            place = (point / reach + 1) / 2 * size
            if np.abs(place - np.round(place)).min() < 1e-4 or abs(np.abs(point).max() - 1) < 1e-5:
                continue  # float32 may take the neighbouring cell
            i, j, k = np.clip(np.floor(place), 0, size - 1).astype(int)
            index = (i * size + j) * size + k + (0 if inner else grid**3)
            assert found[ray, step] == flags[index], (ray, step)
            clear, occupied = clear + 1, occupied + int(found[ray, step])
    assert clear > 300
    assert 0.2 < occupied / clear < 0.6


def test_probabilities_follow_what_each_step_shows_and_sum_to_what_is_wanted(some_depths) -> None:
    depth, wanted = some_depths(40, 192), 16
    found = np.asarray(PROBABILITY(depth, wanted), np.float64)
    exact = depth.astype(np.float64)
    importance = np.where(exact > 0, exact * np.exp(-(np.cumsum(exact, -1) - exact)) + LEAST_IMPORTANCE, 0)
    assert ((found > 0) == (exact > 0)).all()
    assert found.max() <= 1
    for row, shares in zip(importance, found, strict=True):
        occupied = (row > 0).sum()
        # three rounds leave a little to give where many steps are certain: a sixteenth of one sample
        assert abs(shares.sum() - min(wanted, occupied)) < 1 / 16
        open_steps = (shares > 0) & (shares < 1)
        if open_steps.any():
            ratio = shares[open_steps] / row[open_steps]
            np.testing.assert_allclose(ratio, ratio[0], rtol=1e-4)  # float32 sums over 192 steps


def test_drawn_steps_equal_a_search() -> None:
    """Probabilities of whole 64ths, whose sums are exact: where each integer is passed, in ascending order, `most` at the end."""
    rng = np.random.default_rng(0)
    probability = np.where(rng.random((200, 96)) < 0.4, rng.integers(1, 65, (200, 96)), 0) / 64
    probability[0] = 0
    offset, most = rng.integers(0, 64, 200) / 64, 12
    steps, count = jax.jit(draw, static_argnums=2)(np.float32(probability), np.float32(offset), most)
    passed = np.floor(np.cumsum(probability, -1) + offset[:, None])
    assert (passed[:, -1] > most).any()
    for row, found, number in zip(passed, np.asarray(steps), np.asarray(count), strict=True):
        expected = np.flatnonzero(np.diff(row, prepend=0))[:most]
        np.testing.assert_array_equal(found[:number], expected)
