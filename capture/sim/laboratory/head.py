"""The golden head: a life-like head on a plinth, defined by a distance function and meshed on demand.

Lengths below are in centimetres in the frame of the head: x forward (out of the face), y to its left, z up, the bottom of
the plinth at z = 0. The mesh is in metres.
"""

from functools import cache

import numpy as np
import trimesh
from skimage.measure import marching_cubes

from koala3d.capture.sim.laboratory.solids import Field, carved, drum, ellipsoid, joined, rod, sphere

LOWER, UPPER = np.array([-10.0, -8.0, -0.6]), np.array([10.0, 8.0, 27.0])


def head_distance(points: Field) -> Field:
    """Approximate signed distance [cm] of (..., 3) points [cm] from the head."""
    mirrored = points * np.array([1, 0, 1], np.float32) + np.abs(points) * np.array([0, 1, 0], np.float32)  # symmetric: y >= 0
    solid = joined(_skull(mirrored), _face(mirrored), 1.6)
    for add in (_eyes, _nose, _mouth, _ears, _hair):
        solid = add(mirrored, solid)
    solid = joined(solid, _neck(mirrored), 1.0)
    return np.maximum(joined(solid, _plinth(points), 0.5), -points[..., 2])  # flat bottom


def _skull(p: Field) -> Field:
    cranium = ellipsoid(p, (-1.3, 0, 18.7), (7.3, 5.9, 6.5))
    temple = ellipsoid(p, (2.2, 0, 17.8), (4.2, 4.7, 4.6))
    return joined(cranium, temple, 1.5)


def _face(p: Field) -> Field:
    face = ellipsoid(p, (1.9, 0, 14.0), (4.1, 4.4, 5.2))
    jaw = joined(ellipsoid(p, (2.4, 0, 10.9), (3.4, 3.3, 2.6)), rod(p, (-0.8, 4.1, 12.6), (3.6, 2.0, 9.6), 1.1, 1.0), 1.4)
    chin = ellipsoid(p, (5.0, 0, 9.25), (1.25, 1.5, 1.15))
    cheek = ellipsoid(p, (3.7, 3.0, 14.3), (1.7, 1.35, 1.1))
    return joined(joined(joined(face, jaw, 1.5), chin, 1.0), cheek, 1.0)


def _eyes(p: Field, solid: Field) -> Field:
    solid = joined(solid, rod(p, (5.75, 0.7, 17.05), (4.35, 3.5, 17.2), 0.5, 0.45), 0.7)
    solid = carved(solid, ellipsoid(p, (6.1, 2.15, 15.85), (1.5, 1.45, 0.85)), 0.7)
    ball = sphere(p, (4.35, 2.05, 15.85), 1.12)
    lids = carved(sphere(p, (4.35, 2.05, 15.85), 1.3), ellipsoid(p, (5.9, 2.1, 15.78), (1.4, 1.25, 0.42)), 0.08)
    return joined(joined(solid, lids, 0.25), ball, 0.05)


def _nose(p: Field, solid: Field) -> Field:
    bridge = rod(p, (5.75, 0, 16.9), (7.35, 0, 13.9), 0.45, 0.72)
    wing = ellipsoid(p, (6.5, 0.78, 13.55), (0.75, 0.5, 0.52))
    solid = joined(solid, joined(bridge, wing, 0.45), 0.55)
    return carved(solid, ellipsoid(p, (6.9, 0.42, 13.05), (0.38, 0.24, 0.42)), 0.2)


def _mouth(p: Field, solid: Field) -> Field:
    solid = carved(solid, rod(p, (7.0, 0, 12.95), (7.1, 0, 12.3), 0.3, 0.36), 0.5)
    upper = rod(p, (6.15, 0.25, 12.0), (4.95, 1.75, 11.6), 0.42, 0.2)
    lower = rod(p, (6.05, 0, 11.2), (4.95, 1.65, 11.5), 0.5, 0.2)
    solid = joined(joined(solid, upper, 0.35), lower, 0.35)
    solid = carved(solid, rod(p, (6.9, 0, 11.62), (5.2, 1.95, 11.5), 0.14, 0.1), 0.22)
    return carved(solid, ellipsoid(p, (6.3, 0, 10.35), (0.7, 1.1, 0.35)), 0.6)


def _ears(p: Field, solid: Field) -> Field:
    turned = p - np.array([-0.9, 5.4, 15.3], np.float32)
    turned = turned @ np.array([[0.97, -0.26, 0.0], [0.2, 0.94, 0.0], [0.2, 0.0, 1.0]], np.float32)
    lobe = ellipsoid(turned, (0.45, 0.1, -1.6), (0.7, 0.45, 0.8))
    shell = joined(ellipsoid(turned, (0, 0.3, 0.3), (1.45, 0.6, 1.9)), lobe, 0.5)
    shell = carved(shell, ellipsoid(turned, (0.1, 1.0, 0.35), (0.95, 0.6, 1.3)), 0.25)
    ridge = rod(turned, (0.45, 0.55, 0.9), (0.3, 0.5, -0.5), 0.2, 0.22)
    return joined(solid, joined(shell, ridge, 0.2), 0.5)


def _hair(p: Field, solid: Field) -> Field:
    """Wavy strands combed back over the skull: waves in the distance that fade out at the hairline."""
    x, y, z = np.moveaxis(p, -1, 0)
    hairline = 20.3 - 0.55 * np.maximum(3.4 - x, 0) - 0.02 * y * y
    hairline = np.where(x < -1.2, np.maximum(hairline - 1.6 * (-1.2 - x), 10.8), hairline)
    amount = 1 / (1 + np.exp(-np.clip((z - hairline) * 4.0, -30, 30)))
    angle = np.arctan2(y, z - 14.5)
    strands = np.abs(np.sin(9.0 * angle + 0.55 * np.sin(0.9 * x + 1.3 * z)))
    return solid - (0.34 + 0.3 * (strands - 0.5)) * amount


def _neck(p: Field) -> Field:
    throat = rod(p, (-1.5, 0, 3.5), (-0.7, 0, 11.5), 3.9, 3.5)
    muscle = rod(p, (1.3, 0.8, 4.5), (-2.0, 3.9, 12.0), 0.9, 0.8)
    flare = ellipsoid(p, (-1.0, 0, 2.6), (4.8, 5.4, 2.0))
    return joined(joined(throat, muscle, 1.0), flare, 1.8)


def _plinth(p: Field) -> Field:
    return joined(drum(p, (-0.8, 0, 1.0), 5.6, 1.0, 0.25), drum(p, (-0.8, 0, 2.2), 4.9, 0.5, 0.25), 0.3)


@cache
def head_mesh(step_cm: float = 0.2) -> trimesh.Trimesh:
    """Closed mesh of the head [m] with smooth normals, sampled every `step_cm`; takes about two seconds, then cached."""
    axes = [np.arange(low, high, step_cm, dtype=np.float32) for low, high in zip(LOWER, UPPER, strict=True)]
    grids = (np.meshgrid(part, *axes[1:], indexing="ij") for part in np.array_split(axes[0], 8))
    volume = np.concatenate([head_distance(np.stack(grid, -1)) for grid in grids])
    vertices, faces, _, _ = marching_cubes(volume, 0.0, spacing=(step_cm,) * 3)
    vertices = vertices + LOWER
    normals = _gradient(vertices.astype(np.float32))
    mesh = trimesh.Trimesh(vertices / 100, faces[:, ::-1], vertex_normals=normals, process=False)
    if mesh.volume < 0:
        mesh.invert()
        mesh.vertex_normals = normals
    return mesh


def _gradient(points: Field) -> Field:
    """(n, 3) outward unit normals from central differences of the distance."""
    width = np.float32(0.05)
    steps = width * np.eye(3, dtype=np.float32)
    slope = np.stack([head_distance(points + step) - head_distance(points - step) for step in steps], -1)
    return slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-9)
