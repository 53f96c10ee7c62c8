import numpy as np
import pytest

from tests.bench import shape_coverage
from tests.bench.shape_coverage import Measured


def scene(name: str, numbers: tuple[float, ...], seed: int, *, worse: float = 1.0) -> Measured:
    """Errors that are as the numbers say, or worse."""
    rng = np.random.default_rng(seed)
    terms = np.exp(rng.normal(size=(3, 3000))) * [[1e-4], [1e-4], [1e-3]]
    std = np.sqrt(np.sum((np.asarray(numbers)[:, None] * terms) ** 2, 0))
    return Measured(name, terms, worse * np.abs(std * rng.normal(size=3000)), np.ones(3000), 1.0)


def test_numbers_are_found_again_and_hold_on_the_scene_that_was_left_out() -> None:
    numbers = (1.0, 2.0, 0.3)
    scenes = [scene(str(seed), numbers, seed) for seed in range(4)]
    assert shape_coverage.fitted(scenes) == pytest.approx(numbers, rel=0.25)
    text = shape_coverage.table(scenes).splitlines()
    assert len(text) == 7 and all(" yes " in line for line in text[1:5])


def test_a_scene_that_is_worse_than_the_others_falls_short() -> None:
    numbers = (1.0, 2.0, 0.3)
    scenes = [scene(str(seed), numbers, seed) for seed in range(3)] + [scene("worse", numbers, 9, worse=3.0)]
    text = shape_coverage.table(scenes).splitlines()
    assert text[4].startswith("worse") and " low " in text[4]
    assert scenes[3].ratio(np.array(numbers)) == pytest.approx(3 * np.sqrt(2 / np.pi), rel=0.05), "3 times that of normal errors"
