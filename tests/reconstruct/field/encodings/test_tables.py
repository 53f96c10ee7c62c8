import jax
import numpy as np
import pytest

from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.field.encodings.tables import HEADROOM, fitting_sizes, mean_squares, row_of, starts
from koala3d.reconstruct.field.encodings.voxels import VoxelGrid
from tests import drawn

RESOLUTIONS = (4.0, 8.0, 64.0)


def test_tables_are_as_small_as_their_vertices_allow() -> None:
    assert fitting_sizes(RESOLUTIONS, 16, None) == (16, 16, 16)
    sizes = fitting_sizes(RESOLUTIONS, 16, 8.0)
    assert sizes == (12, 15, 16), "4 (2 * 4 + 1)^3 = 2916 rows, 4 (2 * 8 + 1)^3 = 19652, more than there is room for"
    for resolution, size in zip(RESOLUTIONS, sizes, strict=True):
        assert 2**size >= min(2**16, HEADROOM * (2 * resolution) ** 3)
    assert fitting_sizes(RESOLUTIONS, 6, 1e-9) == (6, 6, 6), "never more than asked for"
    assert max(fitting_sizes(RESOLUTIONS, 16, 1e-9)) == 8


def test_levels_of_unequal_size_lie_one_after_the_other() -> None:
    sizes = (4, 6, 5)
    assert starts(sizes).ravel().tolist() == [0, 16, 80]
    keys = np.random.default_rng(0).integers(0, 2**31 - 1, (3, 4000)).astype(np.uint32)
    rows = np.asarray(jax.jit(row_of, static_argnums=1)(keys, sizes))
    for level, size in enumerate(sizes):
        assert rows[level].min() == 0 and rows[level].max() == 2**size - 1
        counts = np.bincount(rows[level], minlength=2**size)
        assert counts.min() > 0.5 * counts.mean(), "spread over the whole table"  # 62 to 250 per row: 4 deviations


def test_decay_counts_each_level_alike_whatever_its_size() -> None:
    table, squares = np.repeat(np.float32([[1, 3], [1, 3]]), (16, 64), 1), jax.jit(mean_squares, static_argnums=1)
    np.testing.assert_allclose(squares(table, (4, 6)), 1 + 9)
    np.testing.assert_allclose(squares(table[:, :32], (4, 4)), 1 + 9)


@pytest.mark.parametrize("kind", [PermutohedralLattice, VoxelGrid])
def test_a_small_table_is_read_where_it_lies(kind: type) -> None:
    """Each level's rows hold the level's number: interpolation, whose weights add up to one, must give it back."""
    sizes = {"levels": 3, "features": 1, "log2_size": 12, "coarsest": 2.0, "finest": 20.0, "volume": 8.0}
    grid = drawn.filled(lambda: kind.create(jax.random.key(0), **sizes))
    assert len(set(grid.log2_sizes)) > 1 and grid.table.shape[1] == sum(2**size for size in grid.log2_sizes)
    numbered = np.repeat([1.0, 2.0, 3.0], [2**size for size in grid.log2_sizes])[None]
    held = kind(drawn.array(numbered), grid.blur, grid.resolutions, grid.log2_sizes)
    found = jax.jit(lambda grid, points: grid(points))(held, drawn.uniform(3, 500, low=-1))
    np.testing.assert_allclose(found, np.repeat([[1.0], [2.0], [3.0]], 500, 1), rtol=1e-5)
