"""The pieces of a step do what the step does."""

import pytest

from koala3d.reconstruct.bench.cost.kernels import Bench, corners
from koala3d.reconstruct.models import load_config

SMALL = ["sampler.samples=1024", "sampler.rays=256", "encoding.log2_size=8", "encoding.levels=2", "sampler.grid=32",
         "surface.rays=8", "surface.samples=8"]  # fmt: skip


@pytest.mark.slow
def test_all_pieces_are_measured() -> None:
    bench = Bench.of(load_config("surfnerf", "fast", SMALL))
    found = {kernel.name: kernel for kernel in bench.kernels()}
    assert len(found) == 12 and all(kernel.seconds > 0 for kernel in found.values())
    assert found["encoding"].gathers == 1024 * 2 * 2 * 4
    assert found["encoding, backward alone"].scatters == found["encoding"].gathers
    assert found["spatial network"].operations >= 2 * 1024 * (4 * 64 + 64 * 23)


def test_vertices_by_kind_of_grid() -> None:
    for model, count in (("surfnerf", 4), ("zipnerf", 8)):
        bench = Bench.of(load_config(model, "fast", SMALL))
        assert corners(bench.model.field.encoding) == count
        assert bench.rays.origins.shape == (256, 3)
