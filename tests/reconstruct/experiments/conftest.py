"""Rows of results that nobody has measured."""

from collections.abc import Callable
from typing import Any

import pytest

from koala3d.reconstruct.experiments.results import Origin, Row


@pytest.fixture
def make_row() -> Callable[..., Row]:
    """Factory of rows of two seeds of the ball; figures given by name replace the defaults."""

    def make(
        scene: str = "chrome_ball", *, model: str = "surfnerf", setting: str = "base", budget_s: float = 15.0, **figures: Any
    ) -> Row:
        values = {"psnr": 25.0, "normal_mae_alpha_acc_deg": 10.0, "rays_per_s": 50_000.0, **figures}
        spread = {"psnr": 0.1, "normal_mae_alpha_acc_deg": 0.2, "rays_per_s": 100.0}
        origin = Origin(model, "fast", setting, budget_s)
        return Row(scene, origin.name, values, deviations=spread, seeds=2, origin=origin)

    return make
