"""What pages draw: cameras, boxes, capsules, marks. Sizes in the world unit of what is shown."""

from collections.abc import Sequence

import numpy as np
import viser
from numpy.typing import ArrayLike, NDArray

from datasets import pose
from datasets.camera_model import Camera
from datasets.page.server import Page
from datasets.structure.bounds import corners

Colour = tuple[int, int, int]

COLOURS: dict[str, Colour] = {
    "train": (31, 119, 180),
    "val": (148, 103, 189),
    "test": (214, 39, 40),
    "calibration": (44, 160, 44),
    "blocked": (120, 120, 120),
    "error": (220, 20, 20),
    "warning": (240, 150, 0),
    "box": (190, 150, 30),
}
"""sRGB of what is drawn, by its meaning."""
SIDES = 16
"""Corners of the circles that capsules are made of."""


def colour_of(name: str) -> Colour:
    """sRGB bytes of a split or another meaning; dark grey for what has none."""
    return COLOURS.get(name, (60, 60, 60))


def legend(counts: dict[str, int]) -> str:
    """Markdown that says which colour means what: a line for each name, with its count."""
    dots = (f'<span style="color: rgb{colour_of(name)}">&#9679;</span> {name}: {count}' for name, count in counts.items())
    return "  \n".join(dots)


def placed(world_from_thing: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(4,) quaternion `wxyz` and (3,) position of a (4, 4) pose, as the page wants them."""
    matrix = np.asarray(world_from_thing, np.float64)
    return pose.quaternion(matrix), matrix[:3, 3]


def add_camera(
    page: Page, name: str, world_from_camera: ArrayLike, camera: Camera, *, colour: Colour, length: float
) -> viser.CameraFrustumHandle:
    """A viewing pyramid of `length` at a (4, 4) pose; the picture, where one is given later, lies on its far side."""
    rotation, position = placed(world_from_camera)
    half = 0.5 * camera.height / camera.fy
    return page.scene.add_camera_frustum(
        name,
        fov=2 * float(np.arctan(half)),
        aspect=camera.width / camera.height,
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
    """Put a browser's camera at a (4, 4) pose, with as high a field of view, turning about a point `distance` ahead."""
    matrix = np.asarray(world_from_camera, np.float64)
    with client.atomic():
        client.camera.up_direction = -matrix[:3, 1]
        client.camera.position = matrix[:3, 3]
        client.camera.look_at = matrix[:3, 3] + distance * matrix[:3, 2]
        client.camera.fov = 2 * float(np.arctan(0.5 * camera.height / camera.fy))


def box_edges(box: ArrayLike) -> NDArray[np.float64]:
    """(12, 2, 3) edges of an upright box of (2, 3) corners."""
    places = corners(box)
    return np.array([(places[i], places[i | bit]) for i in range(8) for bit in (1, 2, 4) if not i & bit])


def add_box(page: Page, name: str, box: ArrayLike, *, colour: Colour) -> viser.LineSegmentsHandle:
    """The edges of an upright box of (2, 3) corners."""
    edges = box_edges(box).astype(np.float32)
    return page.scene.add_line_segments(name, edges, colour, thickness=1.5, thickness_units="screen")


def add_lines(page: Page, name: str, segments: ArrayLike, *, colour: Colour, thickness: float = 1.5) -> viser.LineSegmentsHandle:
    """(n, 2, 3) line segments, `thickness` in pixels of the screen."""
    ends = np.asarray(segments, np.float32)
    return page.scene.add_line_segments(name, ends, colour, thickness=thickness, thickness_units="screen")


def add_mark(page: Page, name: str, words: str, position: ArrayLike, *, colour: Colour, size: float) -> None:
    """A ball of radius `size` with a few words beside it, at (3,) `position`."""
    place = np.asarray(position, np.float64)
    page.scene.add_icosphere(f"{name}/ball", size, colour, subdivisions=2, position=place)
    page.scene.add_label(f"{name}/words", words, position=place, anchor="bottom-left")


def capsule(ends: ArrayLike, radius: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """(n, 3) vertices and (m, 3) faces, outward, of all that lies within `radius` of the segment of (2, 3) `ends`."""
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
    """(m, 3) faces of rings of SIDES vertices each, closed by one vertex more at either end."""
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
    """(3,) unit direction that is up in most of the pictures; the world's z where that is not far from it."""
    mean = -np.mean([np.asarray(matrix)[:3, 1] for matrix in world_from_cameras], axis=0)
    length = float(np.linalg.norm(mean))
    if length < 1e-6 or mean[2] > 0.7 * length:
        return np.array([0.0, 0.0, 1.0])
    return mean / length
