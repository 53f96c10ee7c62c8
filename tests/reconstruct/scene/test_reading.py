from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datasets.imaging.copies import Copies
from datasets.scene import Scene
from reconstruct.scene import pool as pools
from reconstruct.scene import rays
from reconstruct.scene.rays import Normalisation, Pixels, read_scaled
from reconstruct.scene.reading import PROBE, held_out, probe, training_pixels


class Silent:
    """A progress that nobody looks at."""

    def advance(self) -> None:
        """Nothing."""


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_the_probe_is_a_random_part_of_the_unseen_pixels(make_scene: Callable[..., Scene], scale: float) -> None:
    """The reference holds all the pixels, and draws from them."""
    scene = make_scene(count=9, truth=False)
    normalisation = Normalisation.of(scene)
    unseen = tuple(view for view in scene.views if view.split == "test")
    assert len(unseen) == 3
    everything = Pixels.load(unseen, normalisation, scale, Silent())
    total = len(everything.view)
    index = np.random.default_rng(0).choice(total, min(PROBE, total), replace=False)
    found = probe(scene, normalisation, scale)
    assert found is not None
    for one, other in zip(found, everything.over_white(index), strict=True):
        np.testing.assert_array_equal(one, other)


def test_without_test_views_there_is_no_probe(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(count=4, truth=False)
    assert probe(scene.with_views(scene.split("train")), Normalisation.of(scene), 1.0) is None


def test_a_pool_is_made_where_memory_is_short(make_scene: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch) -> None:
    scene = make_scene(count=4, truth=False)
    normalisation = Normalisation.of(scene)
    pixels, pool = training_pixels(scene.views, normalisation, 0.5)
    assert pool is None and len(pixels.view) == 4 * 48 * 36
    rest, held = held_out(pixels, pool)
    assert len(rest.view) + len(held.view) == len(pixels.view)
    monkeypatch.setenv(pools.MOST, "1000")
    pixels, pool = training_pixels(scene.views, normalisation, 0.5)
    assert pool is not None and len(pixels.view) == 1000
    rest, held = held_out(pixels, pool)
    assert rest is pixels and len(held.view) == 4 * 48 * 36 // 100


def test_a_large_picture_is_kept_at_its_scale(
    make_scene: Callable[..., Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (view,), copies = make_scene(count=1, truth=False).views, Copies(tmp_path / "kept")
    read_scaled(view, 0.5, copies)
    assert not (tmp_path / "kept").exists(), "small ones are not"
    monkeypatch.setattr(rays, "WORTH_A_COPY", 96 * 72)
    first, again = read_scaled(view, 0.5, copies), read_scaled(view, 0.5, copies)
    assert len(list((tmp_path / "kept").iterdir())) == 1
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(again, read_scaled(view, 0.5))
    again[:] = 0  # belongs to the caller
    np.testing.assert_array_equal(first, read_scaled(view, 0.5, copies))
