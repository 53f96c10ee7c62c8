"""What a step needs is planned without running it, and a step in several batches is the same step."""

import pytest

from koala3d.reconstruct.bench.gpu import memory
from koala3d.reconstruct.bench.gpu.plan import SMALL
from koala3d.reconstruct.models import load_config


def test_batches_share_out_the_rays() -> None:
    config = load_config("surfnerf", "paper")
    parts = memory.in_batches(config, 4)
    assert (parts.sampler.rays, parts.surface.rays, parts.train.accumulate) == (16384, 16384, 4)
    assert (parts.train.rate, parts.train.steps) == (config.train.rate, config.train.steps), "the same descent"


def test_batches_are_made_until_they_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    def plan(config, pixels):
        return {"needed_bytes": 2 * 10**9 + 10**6 * config.sampler.rays, "batches": config.train.accumulate}

    monkeypatch.setattr(memory, "plan", plan)
    found = memory.plans(load_config("surfnerf", "paper"), room=24 * 10**9)
    assert [one["batches"] for one in found] == [1, 4] and [one["fits"] for one in found] == [False, True]
    assert memory.plans(load_config("surfnerf", "paper"), room=1)[-1]["fits"] is False, "and it ends"


@pytest.mark.slow
def test_a_plan_counts_every_stage() -> None:
    (found,) = memory.plans(load_config("surfnerf", "paper", list(SMALL)), pixels=1000)
    assert [stage["name"] for stage in found["stages"]] == ["begin", "descend"]
    assert found["fits"] and found["needed_bytes"] > 0
    assert all(stage["operations"] > 0 and stage["moved_bytes"] > 0 for stage in found["stages"])
    assert "256 rays" in memory.text([found]) and "fits into 24.00 GB" in memory.text([found])
