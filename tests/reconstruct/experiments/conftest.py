"""Rows of benchmarks that nobody has run."""

from collections.abc import Callable
from typing import Any

import pytest


@pytest.fixture
def make_row() -> Callable[..., dict[str, Any]]:
    """Factory of finished records of the ball; values given by name replace the defaults."""

    def make(**given: Any) -> dict[str, Any]:
        row: dict[str, Any] = {
            "kind": "quality", "scene": "chrome_ball", "scale": 1.0, "views": 0.0, "model": "surfnerf", "preset": "fast",
            "budget_s": 15.0, "seed": 0.0, "status": "done", "psnr": 25.0, "normal_mae_alpha_acc_deg": 10.0,
            "rays_per_s": 50_000.0, "steps": 1000.0, "training_s": 15.0, "compilation_s": 9.0, "cold": 1.0, "load": 0.5,
            "machine": "a processor", "cores": 2.0, "memory_gb": 24.0,
            "python": "3.11", "jax": "0.9", "jaxlib": "0.9", "numpy": "2", "commit": "abc",
        }  # fmt: skip
        return row | given

    return make
