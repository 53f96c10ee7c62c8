from dataclasses import replace

import numpy as np

from koala3d.calib.targets import screening
from koala3d.datasets.camera_model import Camera


def test_good_corners_all_stay(small):
    kept, left_out = screening.agreeing_with_plane(small.observations)
    assert left_out == {} and [len(o.ids) for o in kept] == [len(o.ids) for o in small.observations]


def test_a_corner_of_the_next_square_goes_alone(small):
    first = small.observations[0]
    pixels = first.pixels.copy()
    pixels[7] += 3 * (pixels[8] - pixels[7])
    kept, left_out = screening.agreeing_with_plane([replace(first, pixels=pixels), *small.observations[1:]])
    assert left_out == {} and set(first.ids) - set(kept[0].ids) == {first.ids[7]}


def test_a_view_of_something_else_is_named(small):
    rng = np.random.default_rng(0)
    broken = replace(small.observations[2], pixels=rng.uniform(0, 500, small.observations[2].pixels.shape))
    observations = [broken if i == 2 else o for i, o in enumerate(small.observations)]
    kept, left_out = screening.agreeing_with_plane(observations)
    assert list(left_out) == ["002"] and "flat target" in left_out["002"] and len(kept) == len(observations) - 1


def test_a_lens_that_bends_every_view_is_not_an_outlier(simulate):
    wide = simulate(seed=65, views=10, camera=Camera(960, 600, 250.0, 250.0, 484.0, 296.0, 0.02, -0.008, fisheye=True))
    kept, left_out = screening.agreeing_with_plane(wide.observations)
    assert left_out == {}
    assert np.mean([len(a.ids) / len(b.ids) for a, b in zip(kept, wide.observations, strict=True)]) > 0.95
