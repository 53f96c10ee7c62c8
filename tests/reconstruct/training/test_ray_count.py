import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.models import PRESETS, load_config, merged
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training import ray_count
from koala3d.reconstruct.training.step import Step

FACTS = SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.5, 4.0))


def some_pixels() -> Pixels:
    return Pixels(jnp.ones((100, 4), jnp.float16), jnp.ones((100, 3)), jnp.zeros(100, jnp.int32), jnp.zeros((1, 3)), jnp.ones(1))


def test_the_linear_scaling_rule() -> None:
    config = load_config("surfnerf", "paper")
    small = ray_count.scaled(config, config.sampler.rays // 8)
    assert (small.sampler.rays, small.train.steps) == (8192, 200_000)
    assert (small.train.rate, small.train.final_rate) == (0.01 / 8, 0.001 / 8)
    assert (small.surface.first_period, small.surface.last_period, small.surface.rays) == (4096, 32, 8192)
    assert ray_count.scaled(small, config.sampler.rays) == config, "and back"
    assert Config.model_validate(small.model_dump()) == small
    fast = load_config("surfnerf", "fast")
    halved = ray_count.scaled(fast, fast.sampler.rays // 2)
    assert halved.sampler.samples == fast.sampler.samples // 2, "its batch is a number of samples"


def test_rays_are_halved_until_they_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_count, "needed_bytes", lambda config, facts, pixels: 1000 * config.sampler.rays)
    config = load_config("surfnerf", "paper")
    assert ray_count.fitted(config, FACTS, some_pixels(), limit=70_000_000) == config
    fitted = ray_count.fitted(config, FACTS, some_pixels(), limit=9_000_000)
    assert fitted == ray_count.scaled(config, 8192)
    with pytest.raises(ReconstructError, match="does not fit into memory"):
        ray_count.fitted(config, FACTS, some_pixels(), limit=1000)


def test_batches_grow_on_a_gpu_until_they_keep_it_busy_or_fill_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_count, "needed_bytes", lambda config, facts, pixels: 1000 * config.sampler.samples)
    config = load_config("surfnerf", "fast")
    large = ray_count.grown(config, FACTS, some_pixels(), limit=10**9)
    assert (large.sampler.rays, large.sampler.samples, large.surface.rays) == (65536, 2**18, 4096)
    assert large.train == config.train and large.poses == config.poses
    assert ray_count.grown(config, FACTS, some_pixels(), limit=10**8).sampler.samples == 2**16, "as much as fits"
    assert ray_count.grown(config, FACTS, some_pixels(), limit=10**6) == config
    assert ray_count.grown(large, FACTS, some_pixels(), limit=10**9) == large, "once"
    paper = load_config("surfnerf", "paper")
    assert ray_count.grown(paper, FACTS, some_pixels(), limit=10**9) == paper, "two million samples already"


def test_batches_stay_on_a_processor() -> None:
    config = load_config("surfnerf", "fast")
    assert ray_count.sized(config, FACTS, some_pixels()) is config


@pytest.mark.slow
def test_more_rays_need_more_memory() -> None:
    """As the compiler plans it: the tables and a part that grows with the rays."""
    tiny = {
        "encoding": {"levels": 2, "log2_size": 10},
        "surface": {"enabled": False},
        "losses": {"decay": 0},
        "field": {"spatial_width": 8, "view_width": 8, "bottleneck": 4, "ide_degree": 1},
        "sampler": {"proposals": (8, 8), "final": 8, "proposal_finest": (8.0, 16.0), "frustum": "point"},
    }
    config = Config.model_validate(merged(load_config("zipnerf", "paper").model_dump(), tiny))
    few, many = (ray_count.needed_bytes(ray_count.scaled(config, rays), FACTS, some_pixels()) for rays in (256, 1024))
    assert many > 1.5 * few > 0
    assert 0 < ray_count.memory_limit() < 2**50 and np.isfinite(ray_count.SHARE)


@pytest.mark.parametrize("preset", PRESETS)
def test_memory_is_planned_from_shapes_without_values(preset: str) -> None:
    step = Step.of(load_config("surfnerf", preset), FACTS)
    state = jax.eval_shape(lambda: step.initial(jax.random.key(0), None, 1))
    assert all(isinstance(leaf, jax.ShapeDtypeStruct) for leaf in jax.tree.leaves(state))
