"""Moments of bodies against closed forms."""

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.asset.robot.mass import Weight, inertia, union_moments


def of_box(mass: float, sides: tuple[float, float, float]) -> np.ndarray:
    """Inertia tensor about the centre."""
    a, b, c = np.square(sides)
    return mass / 12 * np.diag([b + c, a + c, a + b])


def test_a_box_of_known_mass(box: trimesh.Trimesh) -> None:
    found = inertia(box, (), Weight(None, 0.6))
    assert found.measured_in == "the closed mesh" and found.mass == pytest.approx(0.6) and found.volume == pytest.approx(0.0012)
    np.testing.assert_allclose(found.centre, [0, 0, 0.03], atol=1e-12)
    np.testing.assert_allclose(found.tensor, of_box(0.6, (0.1, 0.2, 0.06)), atol=1e-12)


def test_a_density_gives_the_mass_of_a_cylinder() -> None:
    cylinder = trimesh.creation.cylinder(0.05, 0.2, sections=512)
    found = inertia(cylinder, (), Weight(7850.0, None))
    mass = 7850 * np.pi * 0.05**2 * 0.2
    side, axis = mass * (3 * 0.05**2 + 0.2**2) / 12, mass * 0.05**2 / 2
    assert found.mass == pytest.approx(mass, rel=1e-4)  # of 512 flat sides
    np.testing.assert_allclose(found.tensor, np.diag([side, side, axis]), rtol=1e-4, atol=1e-9 * mass)


def test_parts_that_overlap_count_once(box: trimesh.Trimesh) -> None:
    """Two boxes that share half of their volume make one of 1.5 times the length; the grid ends within a cell of its sides."""
    other = box.copy()
    other.apply_translation([0.05, 0, 0])
    volume, centre, tensor = union_moments([box, other])
    assert volume == pytest.approx(0.15 * 0.2 * 0.06, rel=0.03)
    np.testing.assert_allclose(centre, [0.025, 0, 0.03], atol=1e-3)
    np.testing.assert_allclose(tensor, of_box(0.0018, (0.15, 0.2, 0.06)), rtol=0.06, atol=1e-9)


def test_an_open_mesh_is_weighed_by_its_parts(box: trimesh.Trimesh) -> None:
    opened = box.copy()
    opened.update_faces(np.arange(len(box.faces)) > 0)
    found = inertia(opened, [box], Weight(1000.0, None))
    assert found.measured_in == "the union of 1 convex parts, since the mesh is not closed"
    assert found.mass == pytest.approx(1.2, rel=0.03)


@pytest.mark.parametrize(("density", "mass", "words"), [(None, None, "neither was given"), (1.0, 1.0, "both were given")])
def test_one_of_mass_and_density_is_needed(density: float | None, mass: float | None, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Weight(density, mass)
