"""Gains of views, measured where they are known because the pictures were made with them."""

from collections.abc import Callable

import numpy as np
import pytest

from datasets.imaging import images
from datasets.scene import Scene
from datasets.structure import exposure, matching
from datasets.structure.exposure import Gains


def measured(scene: Scene) -> Gains:
    return exposure.measured(scene.views, matching.compared(scene.views, np.zeros(3)))


def injured(scene: Scene, gains: dict[int, tuple[float, float, float]]) -> Scene:
    """The scene with the linear light of some pictures multiplied, red, green and blue, and clipped."""
    for index, gain in gains.items():
        light = images.linear_from_srgb(images.read(scene.views[index].image)) * np.array(gain)
        images.write(scene.views[index].image, images.srgb_from_linear(light).clip(0, 1))
    return scene


def test_equally_exposed_views_do_not_differ(two_walls: Callable[..., Scene]) -> None:
    found = measured(two_walls())
    assert found.known.all() and not found.brighter.any() and not found.tinted.any()
    assert np.abs(found.log).max() < 0.1, "a texture of a pixel's width shades with the angle, hardly"
    assert found.words().startswith("0 of 12 views")


def test_known_gains_are_found_within_their_uncertainty(two_walls: Callable[..., Scene]) -> None:
    before = measured(two_walls())
    gains = {3: (0.5, 0.5, 0.5), 8: (1.8, 1.8, 1.8), 10: (1.3, 1.0, 0.8)}
    found = measured(injured(two_walls(), gains))
    truth = np.zeros((12, 3))
    for index, gain in gains.items():
        truth[index] = np.log(gain)
    error = found.log - before.log - truth
    assert np.abs(error - np.median(error, 0)).max() < 0.12  # two thirds of the bright view's points are clipped, the brightest
    assert list(np.flatnonzero(found.brighter)) == [3, 8] and list(np.flatnonzero(found.tinted)) == [10]
    assert "2 of 12 views are brighter or darker" in found.words() and "1 have another white balance" in found.words()
    assert (found.sigma < 0.05).all(), "hundreds of points per pair"


def test_without_matches_nothing_is_known(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    for view in scene.views:
        images.write(view.image, np.full((150, 200, 3), 0.5))
    found = measured(scene)
    assert not found.known.any() and not found.log.any() and not found.brighter.any() and not found.tinted.any()
    assert found.words() == "too few points were matched"


def test_of_many_views_some_are_compared(two_walls: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "COMPARED", 6)
    found = measured(two_walls())
    assert found.log.shape == (12, 3) and found.known.sum() == 6 and not found.log[~found.known].any()


@pytest.mark.parametrize(("log", "sigma", "spread", "differs"), [
    (0.6, 0.01, 0.1, True),
    (0.3, 0.01, 0.1, False),  # shading alone reaches 1.3
    (0.6, 0.15, 0.1, False),  # not sure
    (0.6, 0.01, 0.4, False),  # points differ among themselves
])  # fmt: skip
def test_a_view_differs_where_that_is_large_sure_and_clear(log: float, sigma: float, spread: float, differs: bool) -> None:
    gains = Gains(np.full((1, 3), log), np.full((1, 3), sigma), np.array([spread]))
    assert bool(gains.brighter[0]) is differs and not gains.tinted[0]


def test_views_without_a_connection_are_not_compared() -> None:
    """Two pairs of views and the larger group: what is not connected has no common scale."""
    known = exposure._largest_group(np.array([[0, 1], [1, 2], [3, 4]]), 5)
    assert list(known) == [True, True, True, False, False]


def test_one_wrong_pair_of_many_does_not_move_the_gains() -> None:
    random = np.random.default_rng(0)
    truth = random.normal(0, 0.3, 8)
    pairs = [(i, j) for i in range(8) for j in range(i)]
    system = np.zeros((len(pairs), 8))
    for row, (i, j) in enumerate(pairs):
        system[row, i], system[row, j] = 1, -1
    ratios = system @ truth + random.normal(0, 0.01, len(pairs))
    ratios[3] += 2.0
    values, sigma = exposure._solved(system, ratios, np.full(len(pairs), 0.01))
    error = values - (truth - truth.mean())
    assert np.abs(error).max() < 0.02 and (sigma < 0.02).all()  # Huber's weights leave the wrong pair a hundredth of its pull
