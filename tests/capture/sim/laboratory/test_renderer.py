import numpy as np
import pytest
import trimesh

from koala3d.capture.sim.laboratory import renderer
from koala3d.capture.sim.laboratory.lens import Lens
from koala3d.capture.sim.laboratory.materials import Glass, Matt, Metal, Plastic
from koala3d.capture.sim.laboratory.objects import joined
from koala3d.capture.sim.laboratory.renderer import Renderer
from koala3d.capture.sim.laboratory.scenes import Item, Stage
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.mitsuba_variant import SURE

CAMERA = Camera(120, 100, 170.0, 171.0, 81.3, 37.2, k1=-0.11, k2=0.06, p1=8e-4, p2=-9e-4)
PLACES = np.array([[0.40, 0.06, 0.05], [0.45, -0.07, 0.10], [0.52, 0.02, 0.14], [0.47, 0.09, 0.13]])
BASE_FROM_CAMERA = pose.look_at((0.1, -0.1, 0.4), (0.45, 0, 0.1)) @ pose.from_rotation_vector([0, 0, 0.4])


def balls(places: np.ndarray, radius: float) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return joined([ball.copy().apply_translation(place) for place in places])


@pytest.fixture(scope="module")
def dark_balls() -> Renderer:
    """Black balls of 8 mm before an evenly bright room."""
    item = Item("balls", balls(PLACES, 0.004), Matt(np.zeros(3, np.float32)))
    return Renderer(Stage("balls", (item,), np.ones((8, 16, 3), np.float32)), using=SURE)


def centroids(dark: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(n, 2) centres of mass of (height, width) darkness within 6 px of each expected place."""
    centres = CAMERA.pixel_centres()
    found = []
    for place in expected:
        weight = dark * (np.abs(centres - place).max(-1) < 6)
        found.append((weight[..., None] * centres).sum((0, 1)) / weight.sum())
    return np.array(found)


def test_points_land_where_the_camera_model_says(dark_balls):
    """Light and surfaces alike, over the whole chain of renderer, pinhole and lens."""
    camera_from_base = pose.inverse(BASE_FROM_CAMERA)
    expected = CAMERA.project(PLACES @ camera_from_base[:3, :3].T + camera_from_base[:3, 3])
    assert (expected > 8).all() and (expected < np.array([112, 92])).all()  # the premise: all in the picture
    lens = Lens(CAMERA)
    light = lens.image(dark_balls.radiance(lens.pinhole, BASE_FROM_CAMERA, samples=64, seed=1))
    fine = Lens(CAMERA, supersampling=4, taps=6)
    trials = [
        dark_balls.surfaces(fine.pinhole, BASE_FROM_CAMERA, seed=seed).is_object for seed in range(8)
    ]  # one ray a pixel is noisy
    shown = fine.image(np.asarray(np.mean(trials, axis=0, dtype=np.float32))[..., None])
    for dark in (1 - light[..., 0], shown[..., 0]):
        assert np.abs(centroids(dark, expected) - expected).max() < 0.05


def test_depth_is_along_z_and_normals_point_outward(dark_balls):
    lens = Lens(CAMERA, supersampling=8)
    seen = dark_balls.surfaces(lens.pinhole, BASE_FROM_CAMERA, seed=0)
    camera_from_base = pose.inverse(BASE_FROM_CAMERA)
    centre = camera_from_base[:3, :3] @ PLACES[0] + camera_from_base[:3, 3]
    column, row = np.round(lens.pinhole.project(centre) - 0.5).astype(int)
    toward = centre / np.linalg.norm(centre)
    assert seen.is_object[row, column] and seen.hit[row, column]
    assert seen.depth[row, column] == pytest.approx((centre - 0.004 * toward)[2], abs=2e-4)  # facets of the ball
    assert seen.normals[row, column] @ (BASE_FROM_CAMERA[:3, :3] @ toward) < -0.95
    assert not seen.hit[0, 0] and seen.depth[0, 0] == 0


def test_black_scatters_nothing_and_gold_is_yellow():
    room = np.ones((8, 16, 3), np.float32)
    camera = Camera(8, 8, 40.0, 40.0, 4.0, 4.0)
    view = pose.look_at((0.1, 0, 0.1), (0.45, 0, 0.1))
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1).apply_translation([0.45, 0, 0.1])
    gold, black = (
        Renderer(Stage("ball", (Item("ball", ball, material),), room), using=SURE).radiance(camera, view, samples=64, seed=0)
        for material in (Metal("Au", 0.1), Matt(np.zeros(3, np.float32)))
    )
    assert black[3:5, 3:5].max() == 0
    red, green, blue = gold[3:5, 3:5].mean((0, 1))
    assert 0.8 < red <= 1.0 and red > green > 1.5 * blue  # gold reflects nearly all red and a third of the blue


def test_same_seed_same_light(dark_balls):
    pinhole = Lens(CAMERA).pinhole
    first, again, other = (dark_balls.radiance(pinhole, BASE_FROM_CAMERA, samples=4, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_strips_of_a_picture_fit_together(dark_balls, monkeypatch):
    pinhole = Lens(CAMERA).pinhole
    whole = dark_balls.radiance(pinhole, BASE_FROM_CAMERA, samples=16, seed=3)
    monkeypatch.setattr(renderer, "PATHS_AT_ONCE", 16 * 21 * pinhole.width)
    parts = dark_balls.radiance(pinhole, BASE_FROM_CAMERA, samples=16, seed=3)
    assert parts.shape == whole.shape and not np.array_equal(parts, whole)  # the premise: there are several, with other noise
    edge = (whole > 0) & (whole < 1)
    assert 0 < edge.mean() < 0.01
    np.testing.assert_array_equal(parts[~edge & (parts % 1 == 0)], whole[~edge & (parts % 1 == 0)])
    assert np.abs(parts - whole)[edge].mean() < 0.15  # 16 stratified samples of a half-covered pixel: a step or two of 1 / 16


def test_glass_lets_light_through_and_plastic_keeps_its_colour():
    room = np.ones((8, 16, 3), np.float32)
    camera, view = Camera(8, 8, 40.0, 40.0, 4.0, 4.0), pose.look_at((0.1, 0, 0.1), (0.45, 0, 0.1))
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1).apply_translation([0.45, 0, 0.1])
    glass, green = (
        Renderer(Stage("ball", (Item("ball", ball, material, smooth=True),), room), using=SURE).radiance(
            camera, view, samples=64, seed=0
        )
        for material in (Glass(1.5), Plastic((0.02, 0.3, 0.05), 0.2))
    )
    assert glass[3:5, 3:5].mean() > 0.95  # nothing is lost in clear glass, whichever way it goes
    red, light, blue = green[3:5, 3:5].mean((0, 1))
    assert light > 2 * max(red, blue) and red > 0.03  # the coat mirrors 4 % of all colours


def test_all_parts_of_an_object_are_the_object():
    room = np.ones((8, 16, 3), np.float32)
    balls = [trimesh.creation.icosphere(3, 0.03).apply_translation([0.45, y, 0.1]) for y in (-0.06, 0.06, 0.2)]
    items = tuple(Item(f"ball {i}", ball, Metal("Al", 0.1), smooth=True) for i, ball in enumerate(balls))
    camera, view = Camera(60, 20, 60.0, 60.0, 30.0, 10.0), pose.look_at((0.1, 0, 0.1), (0.45, 0, 0.1))
    seen = Renderer(Stage("balls", items, room, parts=2), using=SURE).surfaces(camera, view, seed=0)
    middles = [round(30 - 60 * y / 0.35) for y in (-0.06, 0.06, 0.2)]  # the camera's x is -y of the base
    shown = [bool(seen.is_object[10, min(max(column, 0), 59)]) for column in middles]
    assert shown[:2] == [True, True] and not shown[2]
