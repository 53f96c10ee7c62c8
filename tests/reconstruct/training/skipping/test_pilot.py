from pathlib import Path

import pytest

from datasets.core.console import progress
from datasets.scene import Scene
from reconstruct.config import Config
from reconstruct.scene.rays import Normalisation, Pixels
from reconstruct.training.skipping.pilot import gain_by_reflecting
from reconstruct.training.skipping.plan import WORTH_DB


@pytest.mark.slow
def test_a_ball_of_one_colour_gains_nothing_by_reflecting(ball_scene: tuple[Scene, Path], small_config: Config) -> None:
    views, normalisation = ball_scene[0].split("train"), Normalisation.of(ball_scene[0])
    with progress("reading", len(views)) as shown:
        pixels = Pixels.load(views, normalisation, 1.0, shown)
    assert gain_by_reflecting(small_config, normalisation, pixels, None) < WORTH_DB
