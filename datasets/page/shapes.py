"""Shapes on pages: cameras, boxes, capsules, markers. Sizes are in the world unit of the scene."""

from collections.abc import Sequence

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.page.server import Page
from koala3d.datasets.structure.bounds import corners

Colour = tuple[int, int, int]

COLOURS: dict[str, Colour] = {
    "train": (31, 119, 180), "val": (148, 103, 189), "test": (214, 39, 40), "calibration": (44, 160, 44),
    "blocked": (120, 120, 120), "error": (220, 20, 20), "warning": (240, 150, 0), "box": (190, 150, 30),
}  # fmt: skip
"""sRGB colours by meaning."""
SIDES = 16  # number of corners of the circles of capsules


def colour_of(name: str) -> Colour:
    """sRGB colour of a split or another meaning; dark grey for unknown names."""
    return COLOURS.get(name, (60, 60, 60))


def legend(counts: dict[str, int]) -> str:
    """Markdown legend of colours: a line per name, with its count."""
    dots = (f'<span style="color: rgb{colour_of(name)}">&#9679;</span> {name}: {count}' for name, count in counts.items())
    return "  \n".join(dots)


def placed(world_from_object: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(4,) quaternion `wxyz` and (3,) position of a (4, 4) pose, in viser's form."""
    matrix = np.asarray(world_from_object, np.float64)
    return pose.quaternion(matrix), matrix[:3, 3]


def add_camera(
    page: Page, name: str, world_from_camera: ArrayLike, camera: Camera, *, colour: Colour, length: float
) -> viser.CameraFrustumHandle:
    """A viewing frustum of `length` at a (4, 4) pose; an image that is set later lies on its far plane."""
    rotation, position = placed(world_from_camera)
    fov, aspect = 2 * float(np.arctan(0.5 * camera.height / camera.fy)), camera.width / camera.height
    return page.scene.add_camera_frustum(
        name,
        fov=fov,
        aspect=aspect,
        scale=length / 2,
        thickness=1.5,
        thickness_units="screen",
        color=colour,
        wxyz=rotation,
        position=position,
        cast_shadow=False,
        receive_shadow=False,
    )


def look_through(client: viser.ClientHandle, world_from_camera: ArrayLike, camera: Camera, *, distance: float) -> None:
    """Move a browser's camera to a (4, 4) pose with the same vertical field of view, orbiting a point `distance` ahead."""
    matrix = np.asarray(world_from_camera, np.float64)
    with client.atomic():
        client.camera.up_direction = -matrix[:3, 1]
        client.camera.position = matrix[:3, 3]
        client.camera.look_at = matrix[:3, 3] + distance * matrix[:3, 2]
        client.camera.fov = 2 * float(np.arctan(0.5 * camera.height / camera.fy))


def box_edges(box: ArrayLike) -> NDArray[np.float64]:
    """(12, 2, 3) edges of an axis-aligned box of (2, 3) corners."""
    places = corners(box)
    return np.array([(places[i], places[i | bit]) for i in range(8) for bit in (1, 2, 4) if not i & bit])


def add_box(page: Page, name: str, box: ArrayLike, *, colour: Colour) -> viser.LineSegmentsHandle:
    """The edges of an axis-aligned box of (2, 3) corners."""
    edges = box_edges(box).astype(np.float32)
    return page.scene.add_line_segments(name, edges, colour, thickness=1.5, thickness_units="screen")


def add_lines(page: Page, name: str, segments: ArrayLike, *, colour: Colour, thickness: float = 1.5) -> viser.LineSegmentsHandle:
    """(n, 2, 3) line segments, `thickness` in screen pixels."""
    ends = np.asarray(segments, np.float32)
    return page.scene.add_line_segments(name, ends, colour, thickness=thickness, thickness_units="screen")


def add_mark(page: Page, name: str, words: str, position: ArrayLike, *, colour: Colour, size: float) -> None:
    """A labelled ball of radius `size` at (3,) `position`."""
    place = np.asarray(position, np.float64)
    page.scene.add_icosphere(f"{name}/ball", size, colour, subdivisions=2, position=place)
    page.scene.add_label(f"{name}/words", words, position=place, anchor="bottom-left")


def capsule(ends: ArrayLike, radius: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """(n, 3) vertices and (m, 3) outward faces of the capsule of `radius` about the segment of (2, 3) `ends`."""
    start, end = np.asarray(ends, np.float64)
    axis = end - start
    length = float(np.linalg.norm(axis))
    along = axis / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    side = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    side /= np.linalg.norm(side)
    other = np.cross(along, side)
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    circle = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other
    rise = np.linspace(-np.pi / 2, np.pi / 2, SIDES // 2 + 2)[1:-1]
    centres = [start if angle < 0 else end for angle in rise]
    rings = [c + radius * (np.cos(a) * circle + np.sin(a) * along) for c, a in zip(centres, rise, strict=True)]
    vertices = np.concatenate([*rings, [start - radius * along, end + radius * along]])
    return vertices.astype(np.float32), _tube_faces(len(rings))


def _tube_faces(rings: int) -> NDArray[np.uint32]:
    """(m, 3) faces of rings of SIDES vertices each, closed by one more vertex at either end."""
    corner, following = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    faces = [np.stack([np.full(SIDES, rings * SIDES), following, corner], -1)]
    for ring in range(rings - 1):
        low, high = ring * SIDES, (ring + 1) * SIDES
        faces += [
            np.stack([low + corner, low + following, high + corner], -1),
            np.stack([low + following, high + following, high + corner], -1),
        ]
    last = (rings - 1) * SIDES
    faces.append(np.stack([np.full(SIDES, rings * SIDES + 1), last + corner, last + following], -1))
    return np.concatenate(faces).astype(np.uint32)


def upright(world_from_cameras: Sequence[ArrayLike]) -> NDArray[np.float64]:
    """(3,) mean up direction of the images as a unit vector; the world's z axis where it is close to it."""
    mean = -np.mean([np.asarray(matrix)[:3, 1] for matrix in world_from_cameras], axis=0)
    length = float(np.linalg.norm(mean))
    if length < 1e-6 or mean[2] > 0.7 * length:
        return np.array([0.0, 0.0, 1.0])
    return mean / length
