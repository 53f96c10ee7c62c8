from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.scene import pool as pools
from koala3d.reconstruct.scene import rays
from koala3d.reconstruct.scene.pool import Pool
from koala3d.reconstruct.scene.rays import Normalisation, Pixels

LENS = Camera(96, 72, 90.0, 88.0, 47.0, 37.0, k1=-0.2, k2=0.05, p1=0.001, p2=-0.002)
SIZE = 96 * 72
SHARE = 500


class Silent:
    """A progress that nobody looks at."""

    def advance(self) -> None:
        """Nothing."""


@pytest.fixture
def scene(make_scene: Callable[..., Scene]) -> Scene:
    """Five views through a lens that distorts."""
    return make_scene(LENS, 5, truth=False, mask=True)


def pool_of(scene: Scene, **options) -> Pool:
    """A pool of `SHARE` pixels a view, each turn after ten steps."""
    rays_drawn = pools.REUSE * SHARE // 10
    return Pool(scene.views, Normalisation.of(scene), 1.0, most=5 * SHARE, rays=rays_drawn, **options)


def whole(scene: Scene) -> Pixels:
    """All pixels in memory."""
    return Pixels.load(scene.views, Normalisation.of(scene), 1.0, Silent())


def rows(pixels: Pixels, index: np.ndarray | slice) -> set[tuple[float, ...]]:
    """View, direction and colour of some pixels."""
    parts = (np.asarray(pixels.view)[index, None], np.asarray(pixels.directions)[index], np.asarray(pixels.colour)[index])
    return {tuple(row) for row in np.concatenate(parts, -1, dtype=np.float64).tolist()}


def test_the_pool_is_a_part_of_what_memory_would_hold(scene: Scene) -> None:
    pool, everything = pool_of(scene), whole(scene)
    pixels = pool.pixels(Silent())
    assert pool.is_needed and pixels.colour.shape == (5 * SHARE, 4)
    assert np.bincount(np.asarray(pixels.view)).tolist() == [SHARE] * 5
    np.testing.assert_array_equal(pixels.origins, everything.origins)
    np.testing.assert_array_equal(pixels.radii, everything.radii)
    index = np.concatenate([view * SIZE + pool.drawn(view, 0) for view in range(5)])
    for name in ("view", "colour"):
        np.testing.assert_array_equal(getattr(pixels, name), np.asarray(getattr(everything, name))[index])
    # the inverse of the lens stops where all the points of one call have converged to 1e-15
    np.testing.assert_allclose(pixels.directions, np.asarray(everything.directions)[index], atol=1e-7, rtol=0)


def test_every_pixel_comes_in_as_often_as_the_others(scene: Scene) -> None:
    pool, turns = pool_of(scene), 400
    counts = np.bincount(np.concatenate([pool.drawn(2, times) for times in range(turns)]), minlength=SIZE)
    expected = turns * SHARE / SIZE  # 29; binomial
    assert abs(counts.mean() - expected) < 1e-9 and counts.min() > expected - 6 * np.sqrt(expected)
    assert np.abs(counts[:1000].mean() - expected) < 5 * np.sqrt(expected / 1000), "the first rows are like the others"


def test_views_take_turns(scene: Scene) -> None:
    pool = pool_of(scene)
    pixels, changed = pool.pixels(Silent()), []
    assert pool.period == 10
    for step in range(0, 60, 5):
        before = np.asarray(pixels.directions)
        pixels = pool.renewed(pixels, step)
        changed.append(np.flatnonzero((before != np.asarray(pixels.directions)).reshape(5, SHARE * 3).any(-1)).tolist())
    assert changed[0] == [] and changed[1::2] == [[]] * 6, "nothing happens between turns"
    assert sorted(view for turn in changed[:12:2] for view in turn) == [0, 1, 2, 3, 4]
    assert np.asarray(pixels.view).tolist() == np.repeat(np.arange(5), SHARE).tolist()


@pytest.mark.parametrize("step", [7, 30, 95, 1234])
def test_a_resumed_pool_is_that_of_an_undisturbed_training(scene: Scene, step: int) -> None:
    steady, resumed = pool_of(scene), pool_of(scene)
    pixels = steady.pixels(Silent())
    for now in range(0, step, 4):
        pixels = steady.renewed(pixels, now)
    pixels = steady.renewed(pixels, step)
    again = resumed.renewed(resumed.pixels(Silent()), step)
    for one, other in zip(jax.tree.leaves(pixels), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, other)


def test_copies_change_nothing(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rays, "WORTH_A_COPY", 1)
    found = []
    for copies in (None, Copies(tmp_path / "kept"), Copies(tmp_path / "kept")):
        pool = pool_of(scene, copies=copies)
        found.append(jax.tree.leaves(pool.renewed(pool.pixels(Silent()), 30)))
    assert len(list((tmp_path / "kept").iterdir())) == 5
    for leaves in zip(*found, strict=True):
        np.testing.assert_array_equal(leaves[0], leaves[1])
        np.testing.assert_array_equal(leaves[0], leaves[2])


def test_a_small_scene_needs_no_pool(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not Pool(scene.views, Normalisation.of(scene), 1.0).is_needed
    assert Pool(scene.views, Normalisation.of(scene), 1.0).overview_scale == 1.0
    monkeypatch.setenv(pools.MOST, "9999")
    assert Pool(scene.views, Normalisation.of(scene), 1.0).is_needed
    assert not Pool(scene.views, Normalisation.of(scene), 0.5).is_needed, "9,999 is more than 5 x 48 x 36"


def test_shares_follow_the_sizes_of_pictures(make_scene: Callable[..., Scene]) -> None:
    small, large = make_scene(count=3, truth=False), LENS.scaled(192, 144)
    views = tuple(v if i else type(v)(v.name, large, v.world_from_camera, "train", v.image) for i, v in enumerate(small.views))
    pool = Pool(views, Normalisation.of(small), 1.0, most=600)
    assert pool.shares.tolist() == [400, 100, 100] and pool.sizes.tolist() == [4 * SIZE, SIZE, SIZE]
