from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.imaging.copies import Copies
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.scene import pool as pools
from koala3d.reconstruct.scene import rays
from koala3d.reconstruct.scene.rays import Normalisation, read_scaled
from koala3d.reconstruct.scene.reading import training_pixels


class Silent:
    """A progress that nobody looks at."""

    def advance(self) -> None:
        """Nothing."""


def test_a_pool_is_made_where_memory_is_short(make_scene: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch) -> None:
    scene = make_scene(count=4, truth=False)
    normalisation = Normalisation.of(scene)
    pixels, pool = training_pixels(scene.views, normalisation, 0.5)
    assert pool is None and len(pixels.view) == 4 * 48 * 36
    monkeypatch.setenv(pools.MOST, "1000")
    pixels, pool = training_pixels(scene.views, normalisation, 0.5)
    assert pool is not None and len(pixels.view) == 1000


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
