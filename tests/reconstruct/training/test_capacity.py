import jax
import pytest

from koala3d.reconstruct import models
from koala3d.reconstruct.training.capacity import with_rows
from tests.small import small


@pytest.mark.parametrize(
    ("steps", "log2_size"),
    [(1, 16), (3_360, 16), (9_000, 16), (12_000, 17), (14_000, 17), (28_000, 18), (40_000, 19), (1_000_000, 19)],
)
def test_longer_trainings_have_more_rows(steps: int, log2_size: int) -> None:
    config = models.load_config(overrides=[f"train.steps={steps}"])
    assert with_rows(config, None).encoding.log2_size == log2_size


def test_a_budget_of_seconds_stands_for_steps() -> None:
    config = models.load_config(overrides=["train.steps=1"])
    assert [with_rows(config, seconds).encoding.log2_size for seconds in (15, 60, 300)] == [16, 17, 19]


def test_a_device_takes_larger_batches_and_shorter_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert with_rows(models.load_config(), 15).encoding.log2_size == 19


def test_what_is_set_stays() -> None:
    assert with_rows(small("surfnerf"), 3600) == small("surfnerf")
    assert with_rows(models.load_config(preset="paper"), 1.0).encoding.log2_size == 21
