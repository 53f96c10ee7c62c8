"""Encodings by the name that a configuration gives them."""

from jaxtyping import PRNGKeyArray

from koala3d.reconstruct.config import EncodingConfig
from koala3d.reconstruct.field.encodings.encoding import Encoding
from koala3d.reconstruct.field.encodings.frequencies import Frequencies
from koala3d.reconstruct.field.encodings.lattice import PermutohedralLattice
from koala3d.reconstruct.field.encodings.voxels import VoxelGrid

GRIDS = {"lattice": PermutohedralLattice, "voxels": VoxelGrid}
FEWEST_ROWS = 16
"""Logarithm to base 2 of a level's rows where nothing is said."""


def create_encoding(key: PRNGKeyArray, config: EncodingConfig) -> Encoding:
    """A fresh encoding of the wanted kind and sizes."""
    if config.kind == "frequencies":
        return Frequencies.create(levels=config.levels, coarsest=config.coarsest, finest=config.finest)
    sizes = {"log2_size": FEWEST_ROWS, **config.model_dump(exclude={"kind"}, exclude_none=True)}
    return GRIDS[config.kind].create(key, **sizes)
