"""Which places are seen: against rays that are intersected with every triangle."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from koala3d.capture.sessions.adaptive import sight
from koala3d.capture.sessions.adaptive.places import of_mesh
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera


def scene() -> trimesh.Trimesh:
    """A ball behind a small box."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    box = trimesh.creation.box((0.04, 0.06, 0.08))
    box.apply_translation([0.18, 0.02, 0.0])
    return trimesh.util.concatenate([ball, box])


def hidden(mesh: trimesh.Trimesh, points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Möller and Trumbore 1997, every ray against every triangle."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    found = []
    for point in points:
        way = eye - point
        h = np.cross(way, c - a)
        determinant = ((b - a) * h).sum(1)
        inverse = 1 / np.where(np.abs(determinant) < 1e-15, np.inf, determinant)
        s = point - a
        q = np.cross(s, b - a)
        u, v, t = (s * h).sum(1) * inverse, (q @ way) * inverse, ((c - a) * q).sum(1) * inverse
        found.append(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & (t < 1) & (inverse != 0)).any())
    return np.array(found)


def test_places_behind_others_are_not_seen():
    mesh = scene()
    places = of_mesh(mesh.vertices, mesh.faces, 20_000)
    eye = np.array([0.5, 0.0, 0.1])
    facing = sight.facing(places, pose.look_at(eye, (0, 0, 0), (0, 0, 1)))
    towards = eye - places.points
    cosine = (towards * places.normals).sum(1) / np.linalg.norm(towards, axis=1)
    assert (facing[cosine <= 0] == 0).all()
    at = np.random.default_rng(0).choice(np.flatnonzero(cosine > sight.GOOD), 300, replace=False)
    truly = hidden(mesh, places.points[at] + 1e-4 * places.normals[at], eye)
    assert 0.1 < truly.mean() < 0.6, "the premise: the box hides some of the ball"
    np.testing.assert_allclose(facing[at][~truly & (facing[at] > 0)], cosine[at][~truly & (facing[at] > 0)], atol=1e-6)
    assert (truly != (facing[at] == 0)).mean() < 0.04  # measured: 0.02, along the rim of the shadow


def test_what_is_outside_the_picture_is_not_seen():
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    places, eye = of_mesh(mesh.vertices, mesh.faces, 3000), pose.look_at((0.5, 0.0, 0.0), (0, 0, 0), (0, 0, 1))
    whole = Camera(200, 200, 300.0, 300.0, 100.0, 100.0)
    assert ((sight.facing(places, eye, whole) > 0) == (sight.facing(places, eye) > 0)).all()
    upper = sight.facing(places, eye, replace(whole, height=100))
    assert (upper[places.points[:, 2] < -0.01] == 0).all() and (upper > 0).sum() == pytest.approx(
        (sight.facing(places, eye) > 0).sum() / 2, rel=0.1
    )


def test_the_middle_square_is_in_the_picture_whichever_way_up():
    camera = Camera(300, 200, 250.0, 250.0, 155.0, 98.0)
    square = sight.whichever_way_up(camera)
    assert (square.width, square.height) == (200, 200) and (square.cx, square.cy) == (105.0, 98.0)
