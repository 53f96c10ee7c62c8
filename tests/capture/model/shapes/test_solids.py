"""Bodies around the arm: distances against many points, and files that cannot be read."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydantic import TypeAdapter, ValidationError

from koala3d.capture.model.shapes.solids import AnySolid, BoxSolid, CylinderSolid, MeshSolid, Solid
from koala3d.datasets.core.errors import UsageError

TURNED = {"position": [0.3, -0.2, 0.4], "rotation_deg": [20, -35, 50]}
SEGMENTS = np.random.default_rng(0).uniform(-1, 1, (20, 2, 3))


@pytest.fixture
def bodies(tmp_path: Path) -> dict[str, tuple[Solid, trimesh.Trimesh]]:
    """A body of each kind, and the same as a mesh in its own frame."""
    torus = trimesh.creation.torus(0.3, 0.1)
    torus.export(tmp_path / "torus.ply")
    return {
        "box": (BoxSolid(kind="box", name="b", size=(0.4, 0.2, 0.6), pose=TURNED), trimesh.creation.box((0.4, 0.2, 0.6))),
        "cylinder": (
            CylinderSolid(kind="cylinder", name="c", radius=0.2, height=0.5, pose=TURNED),
            trimesh.creation.cylinder(0.2, 0.5, sections=200),
        ),
        "mesh": (MeshSolid(kind="mesh", name="m", file=str(tmp_path / "torus.ply"), pose=TURNED), torus),
    }


@pytest.mark.parametrize("kind", ["box", "cylinder", "mesh"])
def test_distances_equal_those_to_many_points(kind: str, bodies: dict[str, tuple[Solid, trimesh.Trimesh]]) -> None:
    solid, mesh = bodies[kind]
    placed = mesh.copy().apply_transform(solid.pose.matrix())
    points = trimesh.sample.sample_surface_even(placed, 20_000, seed=0)[0]
    share = np.linspace(0, 1, 60)[:, None]
    found = solid.distance(SEGMENTS)
    for ends, distance in zip(SEGMENTS, found, strict=True):
        along = ends[0] * (1 - share) + ends[1] * share
        slow = np.linalg.norm(along[:, None] - points[None], axis=-1).min()
        own = np.abs((along - solid.pose.matrix()[:3, 3]) @ solid.pose.matrix()[:3, :3])
        within = {"box": own < [0.2, 0.1, 0.3], "cylinder": np.column_stack([np.hypot(*own.T[:2]) < 0.2, own[:, 2] < 0.25])}
        inside = kind in within and within[kind].all(axis=1).any()
        # the points lie 1 cm apart on the body and 3 cm apart on the segment; a mesh may be 5 mm nearer than it is
        assert (distance < 0.01) if inside else slow - 0.02 < distance < slow + 0.005, (distance, slow)
    assert (found > 0.2).any() and (found < 0.1).any(), "the premise: near ones and far ones"


@pytest.mark.parametrize("kind", ["box", "cylinder", "mesh"])
def test_what_is_drawn_is_where_the_body_is(kind: str, bodies: dict[str, tuple[Solid, trimesh.Trimesh]]) -> None:
    solid, _ = bodies[kind]
    vertices, faces = solid.outline()
    assert faces.max() < len(vertices)
    np.testing.assert_allclose(solid.distance(np.stack([vertices, vertices], axis=1)), 0, atol=0.006)


def test_a_distance_worked_by_hand() -> None:
    box = BoxSolid(kind="box", name="b", size=(0.2, 0.2, 0.2), pose={"position": [1, 0, 0]})
    pillar = CylinderSolid(kind="cylinder", name="c", radius=0.1, height=1.0, pose={"position": [1, 0, 0]})
    beside = np.array([[0.5, 0.0, 0.0], [0.5, 0.0, 2.0]])
    assert box.distance(beside) == pytest.approx(0.4, abs=1e-3) and pillar.distance(beside) == pytest.approx(0.4, abs=1e-3)
    through = np.array([[0.5, 0.0, 0.0], [1.5, 0.0, 0.0]])
    assert box.distance(through) == pillar.distance(through) == 0
    above = np.array([[1.0, 0.0, 0.8], [1.0, 0.0, 2.0]])
    assert box.distance(above) == pytest.approx(0.7, abs=5e-3) and pillar.distance(above) == pytest.approx(0.3, abs=5e-3)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("none.ply", None, "no such file"),
        ("a.xyz", "1", "no known suffix"),
        ("b.ply", "ply", "cannot be read"),
        ("c.obj", "", "cannot"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_named(tmp_path: Path, name: str, text: str | None, words: str) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(UsageError, match=words):
        MeshSolid(kind="mesh", name="m", file=str(tmp_path / name)).distance(SEGMENTS)


@pytest.mark.parametrize("wrong", [{"size": [0.1, 0.0, 0.1]}, {"size": [0.1, -1, 0.1]}, {"name": ""}, {"kind": "cone"}])
def test_impossible_bodies_are_refused(wrong: dict) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter(AnySolid).validate_python({"kind": "box", "name": "b", "size": [0.1, 0.1, 0.1]} | wrong)
