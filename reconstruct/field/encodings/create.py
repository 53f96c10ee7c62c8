"""Encodings by the name that a configuration gives them."""

from jaxtyping import PRNGKeyArray

from reconstruct.config import EncodingConfig
from reconstruct.field.encodings.encoding import Encoding
from reconstruct.field.encodings.frequencies import Frequencies
from reconstruct.field.encodings.lattice import PermutohedralLattice
from reconstruct.field.encodings.voxels import VoxelGrid

GRIDS = {"lattice": PermutohedralLattice, "voxels": VoxelGrid}


def create_encoding(key: PRNGKeyArray, config: EncodingConfig) -> Encoding:
    """A fresh encoding of the wanted kind and sizes."""
    if config.kind == "frequencies":
        return Frequencies.create(levels=config.levels, coarsest=config.coarsest, finest=config.finest)
    return GRIDS[config.kind].create(key, **config.model_dump(exclude={"kind"}))
