"""What pages draw has the size and place that it stands for."""

import numpy as np
import pytest
import trimesh

from koala3d.datasets import pose
from koala3d.datasets.page import shapes


@pytest.mark.parametrize("ends", [[[0, 0, 0], [0, 0, 0.5]], [[0.1, 0.2, 0.3], [-0.4, 0.25, 0.1]], [[1, 1, 1], [1, 1, 1]]])
def test_capsules_are_closed_and_have_their_volume(ends: list) -> None:
    radius = 0.1
    mesh = trimesh.Trimesh(*shapes.capsule(ends, radius), process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0  # volume is signed: faces look outward
    length = np.linalg.norm(np.subtract(*ends))
    exact = np.pi * radius**2 * length + 4 / 3 * np.pi * radius**3
    assert 0.9 * exact < mesh.volume < exact  # inscribed: sixteen corners take 2.6% off a cylinder, 8% off a ball
    distance = np.linalg.norm(np.cross(mesh.vertices - ends[0], np.subtract(ends[1], ends[0])), axis=-1)
    assert distance.max() <= (radius + 1e-6) * max(length, 1e-12)


def test_a_box_has_its_twelve_edges() -> None:
    box = np.array([[-1.0, 0, 2], [1, 3, 3]])
    edges = shapes.box_edges(box)
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=-1)
    assert edges.shape == (12, 2, 3) and np.allclose(sorted(lengths), [1] * 4 + [2] * 4 + [3] * 4)
    assert len(np.unique(edges.reshape(-1, 3), axis=0)) == 8


def test_up_is_z_or_the_mean_of_the_images() -> None:
    ring = [pose.look_at((np.cos(a), np.sin(a), 0.5), (0, 0, 0)) for a in np.arange(0, 6, 0.7)]
    assert np.allclose(shapes.upright(ring), [0, 0, 1])
    turned = pose.from_rotation_vector([np.pi / 2, 0, 0])  # takes z to -y, as in COLMAP's worlds
    assert np.allclose(shapes.upright([turned @ matrix for matrix in ring]), [0, -1, 0], atol=0.15)
    assert np.allclose(shapes.upright([np.eye(4), np.diag([1.0, -1, -1, 1])]), [0, 0, 1])  # they say nothing


def test_a_legend_names_counts_and_colours() -> None:
    words = shapes.legend({"train": 3, "test": 1})
    assert "train: 3" in words and "test: 1" in words and "rgb(31, 119, 180)" in words
