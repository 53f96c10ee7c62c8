"""The painted ball as an asset: its colours, shape and views are known exactly."""

from pathlib import Path

import pytest
import trimesh

from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.light import Light
from koala3d.reconstruct.output.trained_model import TrainedModel
from tests.reconstruct.conftest import CENTRE, RADIUS

SIZE = 128  # texels: about 0.8 mm on the ball
_baked: list[tuple[Asset, Light]] = []


@pytest.fixture
def baked(painted: TrainedModel) -> tuple[Asset, Light]:
    """The asset and its light, baked once for all tests."""
    if not _baked:
        sphere = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
        sphere.apply_translation(CENTRE)
        _baked.append(assets.bake(painted, sphere, size=SIZE))
    return _baked[0]


@pytest.fixture
def asset(baked: tuple[Asset, Light]) -> Asset:
    """Of the ball."""
    return baked[0]


@pytest.fixture
def glb(asset: Asset, tmp_path: Path) -> Path:
    """As a file."""
    from koala3d.reconstruct.asset.writing import glb

    glb.save(asset, tmp_path / "ball.glb")
    return tmp_path / "ball.glb"
