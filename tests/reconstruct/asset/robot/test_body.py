"""Bodies of known shapes: their frame, their parts, and how they stand in MuJoCo."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from koala3d.datasets import pose
from koala3d.reconstruct.asset.robot import mjcf, urdf
from koala3d.reconstruct.asset.robot.body import Body, level, standing_margin
from koala3d.reconstruct.asset.robot.mass import Weight
from koala3d.reconstruct.asset.robot.saving import name_of, save, summary
from tests.reconstruct.asset.robot.conftest import PLACE

SECONDS = 2.0
CUT = 1e-5
"""CoACD places vertices to a ten-thousandth of the size."""


@pytest.fixture
def mujoco() -> Any:
    """The simulator."""
    return pytest.importorskip("mujoco", reason="MuJoCo is absent: pip install 'koala-capture[test]'")


@pytest.fixture
def standing(bracket: trimesh.Trimesh, make_body: Callable[..., Body]) -> Body:
    """The L, of 0.5 kg."""
    return make_body(bracket, Weight(None, 0.5), "an L")


def fallen(mujoco: Any, model: Any) -> tuple[float, float]:
    """Distance [m] and angle [rad] by which the only body of a model moved in `SECONDS`."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    place, turn = data.xpos[1].copy(), data.xmat[1].reshape(3, 3).copy()
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
    cosine = (np.trace(turn.T @ data.xmat[1].reshape(3, 3)) - 1) / 2
    return float(np.linalg.norm(data.xpos[1] - place)), float(np.arccos(np.clip(cosine, -1, 1)))


def test_the_origin_is_on_the_table_below_the_centre_of_gravity(standing: Body) -> None:
    """Of the L's 0.0048 and 0.004 square metres, the foot's middle is at (0.06, 0.02) and the post's at (0.02, 0.09)."""
    areas = np.array([0.12 * 0.04, 0.04 * 0.1])
    x, z = areas @ [[0.06, 0.02], [0.02, 0.09]] / areas.sum()
    np.testing.assert_allclose(standing.inertia.centre, [0, 0, z], atol=CUT)
    frame = pose.inverse(PLACE) @ standing.asset.base_from_asset
    np.testing.assert_allclose(frame, pose.rigid(PLACE[:3, :3].T, [x, 0.05, 0]), atol=CUT)  # along the world's axes
    corners = standing.asset.mesh.vertices @ frame[:3, :3].T + frame[:3, 3]
    np.testing.assert_allclose([corners.min(0), corners.max(0)], [[0, 0, 0], [0.12, 0.1, 0.14]], atol=1e-6)  # single precision
    assert standing.margin == pytest.approx(min(x, 0.12 - x), abs=1e-4)  # 0.05 in depth is more


def test_parts_are_convex_and_cover_the_mesh(standing: Body) -> None:
    assert len(standing.parts) > 1 and all(part.is_convex and part.is_volume for part in standing.parts)
    assert sum(part.volume for part in standing.parts) == pytest.approx(0.1 * 0.0088, rel=0.03)  # CoACD cuts at 2000 places


def test_the_inertia_is_that_of_foot_and_post(standing: Body) -> None:
    expected = np.zeros((3, 3))
    parts = [((0.06, 0.05, 0.02), (0.12, 0.1, 0.04)), ((0.02, 0.05, 0.09), (0.04, 0.1, 0.1))]
    masses = [0.5 * np.prod(sides) / 0.00088 for _, sides in parts]
    middle = sum(mass * np.array(centre) for mass, (centre, _) in zip(masses, parts, strict=True)) / 0.5
    for mass, (centre, sides) in zip(masses, parts, strict=True):
        arm = np.array(centre) - middle
        expected += mass / 12 * (np.sum(np.square(sides)) * np.eye(3) - np.diag(np.square(sides)))
        expected += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    turn = PLACE[:3, :3]  # the body keeps the world's axes: it is turned as it stands there
    np.testing.assert_allclose(standing.inertia.tensor, turn @ expected @ turn.T, atol=1e-12)


def test_it_stands_still_in_mujoco(standing: Body, tmp_path: Path, mujoco: Any) -> None:
    save(standing, tmp_path / "l", "mjcf")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "l" / mjcf.SCENE))
    assert model.body_mass[1] == pytest.approx(0.5, rel=1e-6)
    moments = np.linalg.eigvalsh(standing.inertia.tensor)
    np.testing.assert_allclose(np.sort(model.body_inertia[1]), moments, rtol=1e-6)
    np.testing.assert_allclose(model.body_ipos[1], standing.inertia.centre, atol=1e-8)
    distance, angle = fallen(mujoco, model)
    assert distance < 1e-3 and angle < np.deg2rad(0.5)  # contacts give way by tenths of a millimetre


def test_what_carries_no_centre_of_gravity_falls_over(bracket: trimesh.Trimesh, make_body: Callable[..., Body],
                                                      tmp_path: Path, mujoco: Any) -> None:  # fmt: skip
    """The L on the side of its post's end: the check above can fail."""
    turned = bracket.copy()
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [0, 1, 0]))
    turned.apply_translation(-turned.bounds[0])
    body = make_body(turned, Weight(None, 0.5))
    assert body.margin < 0 and "it does not stand by itself" in summary(body)[1]
    save(body, tmp_path / "l", "mjcf")
    assert fallen(mujoco, mujoco.MjModel.from_xml_path(str(tmp_path / "l" / mjcf.SCENE)))[1] > np.deg2rad(45)


def test_urdf_stands_still_in_mujoco(standing: Body, tmp_path: Path, mujoco: Any) -> None:
    save(standing, tmp_path / "l", "urdf")
    world = mujoco.MjSpec.from_string('<mujoco><worldbody><geom type="plane" size="1 1 0.1"/></worldbody></mujoco>')
    body = mujoco.MjSpec.from_file(str(tmp_path / "l" / urdf.FILE))
    world.worldbody.add_frame().attach_body(body.worldbody.first_body(), "l_", "").add_freejoint()
    distance, angle = fallen(mujoco, model := world.compile())
    assert model.body_mass[1] == pytest.approx(0.5, rel=1e-6)
    assert distance < 1e-3 and angle < np.deg2rad(0.5)


def test_another_reader_finds_mass_inertia_and_parts_in_the_urdf(standing: Body, tmp_path: Path) -> None:
    urchin = pytest.importorskip("urchin", reason="urchin, which comes with EAIK, has no wheel for this Python")
    save(standing, tmp_path / "l", "urdf")
    link = urchin.URDF.load(str(tmp_path / "l" / urdf.FILE)).link_map["an_L"]
    assert link.inertial.mass == pytest.approx(0.5) and len(link.collisions) == len(standing.parts)
    np.testing.assert_allclose(link.inertial.inertia, standing.inertia.tensor, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(link.inertial.origin[:3, 3], standing.inertia.centre, atol=1e-9)
    parts = [mesh for collision in link.collisions for mesh in collision.geometry.meshes]
    assert sum(mesh.volume for mesh in parts) == pytest.approx(0.00088, rel=0.03)
    (mesh,) = link.visuals[0].geometry.meshes
    vertices = standing.asset.mesh.vertices
    np.testing.assert_allclose(mesh.bounds, [vertices.min(0), vertices.max(0)], atol=1e-6)
    assert mesh.visual.material.image.size == (64, 64)


def test_files_that_are_named_are_there(standing: Body, tmp_path: Path) -> None:
    for kind, name in (("urdf", urdf.FILE), ("mjcf", mjcf.FILE)):
        save(standing, tmp_path / kind, kind)
        root = ElementTree.parse(tmp_path / kind / name)
        named = {e.get("file") or e.get("filename") for e in root.iter()} - {None}
        assert named and not {file for file in named if not (tmp_path / kind / file).is_file()}
    assert name_of(standing) == "an_L"


def test_an_uneven_underside_is_levelled(box: trimesh.Trimesh) -> None:
    """One corner of the box is half a millimetre too high, less than a hundredth of the height; another is 2 mm too high."""
    for gap, height in ((0.0005, 0.0), (0.002, 0.002)):
        uneven = box.copy()
        uneven.vertices[np.argmin(uneven.vertices.sum(-1)), 2] = gap
        (found,) = level([uneven.convex_hull])
        assert found.is_volume and found.vertices[np.argmin(found.vertices.sum(-1)), 2] == height
        assert standing_margin(found.vertices) == pytest.approx(0.05 if not height else 0.0, abs=1e-9)
