"""Bodies of simple shapes, whose mass and inertia are known in closed form."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets import pose
from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.materials import Textures
from koala3d.reconstruct.asset.robot.body import Body, body
from koala3d.reconstruct.asset.robot.mass import Weight
from koala3d.reconstruct.asset.unwrap import unwrap

PLACE = pose.from_rotation_vector([0, 0, 0.4], [0.4, -0.1, 0.02])
"""Where the shapes stand in the robot's base, which their frame must not depend on."""


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes its log into the working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def make_body() -> Callable[..., Body]:
    """Factory of bodies of a mesh that stands at the origin, with plain textures, at `PLACE` in the world."""
    pytest.importorskip("coacd", reason="CoACD is absent: pip install 'koala-capture[asset]'")
    pytest.importorskip("xatlas", reason="xatlas is absent: pip install 'koala-capture[asset]'")

    def make(mesh: trimesh.Trimesh, weight: Weight, name: str = "a shape") -> Body:
        surface = mesh.copy()
        surface.apply_transform(PLACE)
        frame = assets.base_from_asset(surface.vertices)
        grey = np.full((64, 64, 3), 128, np.uint8)
        laid_out = unwrap(surface, 64).moved(pose.inverse(frame))
        return body(Asset(name, laid_out, Textures(grey, grey, grey, grey), frame, True, {"run": "none"}), surface, weight)

    return make


@pytest.fixture
def box() -> trimesh.Trimesh:
    """0.1 x 0.2 x 0.06 m, its lower side on the table."""
    mesh = trimesh.creation.box((0.1, 0.2, 0.06))
    mesh.apply_translation([0, 0, 0.03])
    return mesh


@pytest.fixture
def bracket() -> trimesh.Trimesh:
    """An L, 0.1 m deep: a foot of 0.12 x 0.04 m (width, height) and on its left a post of 0.04 x 0.1 m."""
    outline = np.array([[0, 0], [0.12, 0], [0.12, 0.04], [0.04, 0.04], [0.04, 0.14], [0, 0.14]])
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    front, back = (np.insert(outline, 1, depth, axis=1) for depth in (0.0, 0.1))
    sides = [[[i, (i + 1) % 6, i + 6], [(i + 1) % 6, (i + 1) % 6 + 6, i + 6]] for i in range(6)]
    faces = np.concatenate([cap, cap[:, ::-1] + 6, np.reshape(sides, (-1, 3))[:, ::-1]])
    mesh = trimesh.Trimesh(np.concatenate([front, back]), faces, process=False)
    assert mesh.is_volume and mesh.volume > 0
    return mesh
