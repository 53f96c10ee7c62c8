"""A mirror on a table that it mirrors: colours do not tell it from the table, what other views see past it does."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import STATED, Scene, View
from koala3d.datasets.segmentation.backdrop import Backdrop, Plane
from koala3d.datasets.segmentation.grow import Grower
from koala3d.datasets.segmentation.strokes import Stroke

CAMERA = Camera(128, 128, 190.0, 190.0, 64.0, 64.0)
RADIUS, VIEWS = 0.06, 24
MIDDLE = np.array([0.3, -0.1, RADIUS])
"""Of the ball: it touches the table, z = 0."""
BOX = np.array([[0.2, -0.2, 0.0], [0.4, 0.0, 0.2]])


def table(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Its colours: patches of some centimetres."""
    rng = np.random.default_rng(5)
    grid = cv2.resize(rng.uniform(0.25, 0.6, (24, 24, 3)), (384, 384), interpolation=cv2.INTER_CUBIC)
    index = np.clip(((points - MIDDLE[:2]) / 1.2 + 0.5) * 384, 0, 383).astype(int)
    return grid[index[..., 0], index[..., 1]]


def light(origins: NDArray[np.float64], towards: NDArray[np.float64]) -> NDArray[np.float64]:
    """What comes from a direction: the table, or a room whose walls look like it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -origins[..., 2] / towards[..., 2]
    met = origins + np.where(np.isfinite(t), t, 0)[..., None] * towards
    near = (t > 1e-9) & (np.abs(met[..., :2] - MIDDLE[:2]) < 0.6).all(-1)
    return np.where(near[..., None], table(met[..., :2]), table(MIDDLE[:2] + 0.3 * towards[..., [0, 2]]))


def photographed(view: View) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(height, width, 3) picture, and (height, width) which pixels show the ball."""
    origin = np.broadcast_to(view.world_from_camera[:3, 3], (128, 128, 3))
    towards = view.camera.directions(view.camera.pixel_centres()) @ view.world_from_camera[:3, :3].T
    towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    from_middle = origin - MIDDLE
    along = -np.sum(from_middle * towards, -1)
    gap = np.sum(from_middle**2, -1) - along**2
    mask = gap < RADIUS**2
    met = origin + (along - np.sqrt(np.maximum(RADIUS**2 - gap, 0)))[..., None] * towards
    normal = (met - MIDDLE) / RADIUS
    mirrored = towards - 2 * np.sum(towards * normal, -1, keepdims=True) * normal
    return np.where(mask[..., None], light(met + 1e-6 * normal, mirrored), light(origin, towards)), mask


def looking_at(eye: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """World from camera, the picture upright."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], -1)
    return pose


@pytest.fixture(scope="module")
def on_table(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, list[NDArray[np.bool_]]]:
    """Views from all around, from 20 to 65 degrees above the table, and the exact masks."""
    rng, folder, views, masks = np.random.default_rng(2), tmp_path_factory.mktemp("mirror"), [], []
    for number in range(VIEWS):
        up, turn = np.deg2rad([20 + 22.5 * (number % 3), 360 * number / VIEWS * 7])
        eye = MIDDLE + 0.4 * np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
        view = View(f"{number:03}", CAMERA, looking_at(eye, MIDDLE), "train", folder / f"{number:03}.png")
        picture, mask = photographed(view)
        images.write(view.image, images.to_uint8(np.clip(picture + rng.normal(0, 0.01, picture.shape), 0, 1)))
        views.append(view)
        masks.append(mask)
    return Scene("mirror", tuple(views), 0.2, 2.0, BOX, "scene", bounds_from=STATED), masks


def overlaps(found: tuple[NDArray[np.bool_], ...], masks: list[NDArray[np.bool_]]) -> NDArray[np.float64]:
    """Intersection over union of each mask and the truth."""
    return np.array([(one & true).sum() / (one | true).sum() for one, true in zip(found, masks, strict=True)])


def test_a_mirror_is_told_from_the_table_that_it_mirrors(on_table: tuple[Scene, list[NDArray[np.bool_]]]) -> None:
    scene, masks = on_table
    steps: list[int] = []
    grower = Grower(scene)
    found = overlaps(grower.grow(done=lambda done, _: steps.append(done)).masks, masks)
    assert found.mean() > 0.92 and found.min() > 0.85  # one pixel along the outline is 5 % of these masks
    assert len(steps) == 2 * VIEWS
    by_colour = overlaps(Grower(replace(scene, bounds_from="poses alone")).grow().masks, masks)
    assert by_colour.mean() < 0.8


def test_strokes_hold(on_table: tuple[Scene, list[NDArray[np.bool_]]]) -> None:
    scene, masks = on_table
    grower, (_, column) = Grower(scene), np.argwhere(masks[5])[0]
    background = Stroke(view="004", of="background", points=[(64.0, 64.0)], radius=4.0)
    kept = Stroke(view="005", of="object", points=[(float(column), 3.0)], radius=2.0)
    found = grower.grow([background, kept])
    assert not found.masks[4][64, 64] and found.masks[5][3, column]
    first = grower.grow()
    assert first.masks[4][64, 64] and not first.masks[5][3, column]


def test_where_views_agree_on_no_plane_colours_decide(on_table: tuple[Scene, list[NDArray[np.bool_]]], tmp_path: Path) -> None:
    """Each view has a room of its own behind the object."""
    scene, masks = on_table
    views = []
    for number, (view, mask) in enumerate(zip(scene.views, masks, strict=True)):
        rng = np.random.default_rng(number)
        room = cv2.resize(rng.uniform(0.1, 0.5, (6, 6, 3)), (128, 128), interpolation=cv2.INTER_CUBIC)
        picture = np.where(mask[..., None], [0.9, 0.7, 0.1], room)
        images.write(tmp_path / f"{view.name}.png", images.to_uint8(np.clip(picture, 0, 1)))
        views.append(replace(view, image=tmp_path / f"{view.name}.png"))
    grower = Grower(scene.with_views(tuple(views)))
    steps: list[int] = []
    assert overlaps(grower.grow(done=lambda done, _: steps.append(done)).masks, masks).min() > 0.9
    assert len(steps) > 2 * VIEWS


def test_the_plane_is_the_face_that_cameras_see_behind_the_object(on_table: tuple[Scene, list[NDArray[np.bool_]]]) -> None:
    sights = Grower(on_table[0]).space.sights
    plane = Plane.behind(BOX, sights)
    assert plane.centre.tolist() == pytest.approx([0.3, -0.1, 0.0]) and plane.half == pytest.approx(2.2 * 0.2)
    index, on = plane.seen_by(sights[4])
    row, column = np.argwhere(on)[-1]
    place = plane.places.reshape(256, 256, 3)[tuple(np.rint(index[row, column]).astype(int))]
    local = (place - sights[4].world_from_camera[:3, 3]) @ sights[4].world_from_camera[:3, :3]
    np.testing.assert_allclose(sights[4].camera.project(local[None])[0], [column + 0.5, row + 0.5], atol=2)  # places are wider


def test_a_flat_part_of_the_object_is_no_plane(on_table: tuple[Scene, list[NDArray[np.bool_]]]) -> None:
    """A red plate below the box looks the same in all views, as the table does; but nothing around it is red."""
    sights = Grower(on_table[0]).space.sights
    plane = Plane.behind(BOX, sights)
    pictures, plates = [], []
    for sight in sights:
        index, on = plane.seen_by(sight)
        place = (index / 256 * 2 - 1)[..., 0] * plane.half, (index / 256 * 2 - 1)[..., 1] * plane.half
        met = plane.centre + np.stack(place, -1) @ plane.across
        plate = on & (np.abs(np.stack(place, -1)) < 0.07).all(-1)
        colour = np.where(plate[..., None], [0.7, 0.1, 0.1], table(met[..., :2]))
        pictures.append(np.uint8(255 * np.where(on[..., None], colour, 0.9)))
        plates.append(plate)
    differences = Backdrop(plane, pictures, sights).differences()
    assert np.isinf(np.concatenate([one[plate] for one, plate in zip(differences, plates, strict=True)])).mean() > 0.95
    around = np.concatenate([one[~plate] for one, plate in zip(differences, plates, strict=True)])
    assert np.median(around[np.isfinite(around)]) < 0.01 and np.isfinite(around).mean() > 0.5
