import numpy as np
import pytest
import trimesh

from koala3d.capture.sessions.adaptive import places

BOX = np.array([[0.3, -0.1, 0.0], [0.5, 0.1, 0.3]])


@pytest.mark.parametrize("up", [1, -1])
def test_the_box_has_four_sides_and_a_top(up):
    found = places.of_box(BOX, up, 0.01)
    assert found.shares.sum() == pytest.approx(1) and (np.abs(found.normals).sum(1) == 1).all()
    sides, tops = 4 * 0.2 * 0.3, 0.2 * 0.2
    for axis, side in ((0, 1), (0, -1), (1, 1), (1, -1)):
        assert found.shares[found.normals[:, axis] == side].sum() == pytest.approx(sides / 4 / (sides + tops))
    assert found.shares[found.normals[:, 2] == up].sum() == pytest.approx(tops / (sides + tops))
    assert not (found.normals[:, 2] == -up).any(), "it stands on this side"
    outwards = ((found.points - BOX.mean(0)) * found.normals).sum(1)
    assert (outwards > 0.09).all()


def test_cells_of_a_ball_have_its_normals_and_evenly_its_area():
    """A staircase has up to 1.7 times the area of the surface that it follows: shares must not depend on the slope."""
    count, cell = 40, np.full(3, 0.005)
    axis = (np.arange(count) + 0.5) * 0.005 - 0.1
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    found = places.of_cells(np.linalg.norm(grid, axis=-1) < 0.08, np.full(3, -0.1), cell)
    away = found.points / np.linalg.norm(found.points, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((away * found.normals).sum(1), -1, 1))).max() < 12
    np.testing.assert_allclose(np.linalg.norm(found.points, axis=1), 0.08, atol=0.005)
    cap = away[:, 2] > np.cos(np.radians(45))
    diagonal = away @ (np.ones(3) / np.sqrt(3)) > np.cos(np.radians(45))
    share = (1 - np.cos(np.radians(45))) / 2  # of a sphere, Archimedes
    assert found.shares[cap].sum() == pytest.approx(share, rel=0.1)
    assert found.shares[diagonal].sum() == pytest.approx(share, rel=0.1)


def test_places_on_a_mesh_are_even_over_its_area():
    mesh = trimesh.creation.box((0.1, 0.2, 0.4))  # sides of 0.08, 0.04 and 0.02 m^2, each twice
    found = places.of_mesh(mesh.vertices, mesh.faces, 5000)
    for axis, area in enumerate((0.08, 0.04, 0.02)):
        share = found.shares[np.abs(found.normals[:, axis]) > 0.99].sum()
        assert share == pytest.approx(2 * area / 0.28, abs=2e-3)
    assert ((np.abs(found.points) - [0.05, 0.1, 0.2]).max(1) < 1e-12).all()
    assert found.spacing == pytest.approx(np.sqrt(0.28 / 5000))
