import jax
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.field.encodings.tables import row_of, starts
from koala3d.reconstruct.field.encodings.voxels import VoxelGrid
from tests import drawn


def test_rows_are_spread_over_the_whole_table() -> None:
    assert starts(3, 6).ravel().tolist() == [0, 64, 128]
    keys = np.random.default_rng(0).integers(0, 2**31 - 1, (3, 4000)).astype(np.uint32)
    for rows in np.asarray(jax.jit(row_of, static_argnums=1)(keys, 6)):
        counts = np.bincount(rows, minlength=64)
        assert len(counts) == 64 and counts.min() > 0.5 * counts.mean()  # 62 a row: 4 deviations


@pytest.mark.parametrize("kind", [PermutohedralLattice, VoxelGrid])
def test_a_table_is_read_where_it_lies(kind: type) -> None:
    """Each level's rows hold the level's number: interpolation, whose weights add up to one, must give it back."""
    sizes = {"levels": 3, "features": 1, "log2_size": 8, "coarsest": 2.0, "finest": 20.0}
    grid = drawn.filled(lambda: kind.create(jax.random.key(0), **sizes))
    numbered = np.repeat([1.0, 2.0, 3.0], 2**8)[None]
    held = kind(drawn.array(numbered), grid.blur, grid.resolutions, grid.log2_size)
    found = jax.jit(lambda grid, points: grid(points))(held, drawn.uniform(3, 500, low=-1))
    np.testing.assert_allclose(found, np.repeat([[1.0], [2.0], [3.0]], 500, 1), rtol=1e-5)
