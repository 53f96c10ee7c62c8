"""Scenes under near lamps: pictures that fit the shape, and light that is told apart as it is in truth."""

from functools import cache

import numpy as np
import pytest

from koala3d.datasets.core.mitsuba_variant import SURE
from koala3d.reconstruct.rendered.near.materials import Coated, Glass, Matte, Metal, Partly
from koala3d.reconstruct.rendered.near.scenes import LAMP_DISTANCE, LAMP_RADIUS, NEAR
from koala3d.reconstruct.rendered.near.views import Lit
from koala3d.reconstruct.rendered.shiny import RADIUS_M
from koala3d.reconstruct.rendered.stages import BENCHMARK, STAGES, spiral_poses
from koala3d.reconstruct.rendered.views import DISTANCE_M, Maps, camera_of

SIZE, CELLS = 20, 40
POSES = spiral_poses(6, 0)


@cache
def looked(name: str, number: int = 3) -> Maps:
    """A small picture of a scene from one of six poses, the lowest first."""
    pytest.importorskip("mitsuba")
    scene = NEAR[name]()
    return Lit(scene, scene.shape(), cells=CELLS, using=SURE).maps(camera_of(SIZE), POSES[number])


def seen(maps: Maps) -> np.ndarray:
    return maps["alpha"][..., 0] > 0.99


@pytest.mark.parametrize("name", NEAR)
def test_pictures_are_finite_and_lit(name: str) -> None:
    maps = looked(name)
    assert set(maps) == {"alpha", "depth", "normals", "diffuse", "specular"}
    assert all(np.isfinite(values).all() and values.shape[:2] == (SIZE, SIZE) for values in maps.values())
    light = (maps["diffuse"] + maps["specular"])[seen(maps)]
    assert 0.02 < np.median(light) < 0.8 and (maps["diffuse"] >= 0).all() and (maps["specular"] >= 0).all()
    assert not (maps["diffuse"] + maps["specular"])[maps["alpha"][..., 0] == 0].any()


def test_matte_is_diffuse_and_metal_specular() -> None:
    stones, kettle = looked("painted_stones"), looked("steel_kettle")
    assert not stones["specular"].any() and stones["diffuse"].any()
    belly = kettle["specular"].sum(-1) > 0
    knob = kettle["diffuse"].sum(-1) > 0
    assert belly.mean() > 3 * knob.mean() > 0


def test_parts_of_a_mixed_material_add_up_to_the_whole() -> None:
    """The egg rendered with both kinds of light at once. Noise of 144 paths per pixel, of lamps that few paths meet, is 3 %."""
    from koala3d.reconstruct.rendered.near import renderer

    maps, scene = looked("lacquered_egg"), NEAR["lacquered_egg"]()
    mesh = renderer.Mesh(*renderer_mesh(scene))
    loaded = renderer.Renderer(scene, (mesh,), using=SURE)
    loaded._scenes["all"] = renderer.loaded(scene, (mesh,), "all")
    pose = POSES[3].copy()
    pose[:3, 3] /= RADIUS_M
    whole = np.mean([loaded._rendered("all", camera_of(SIZE), pose, seed) for seed in range(9)], 0)
    parts = (maps["diffuse"] + maps["specular"])[seen(maps)]
    np.testing.assert_allclose(np.median(parts / whole[seen(maps)]), 1, atol=0.03)


def renderer_mesh(scene):
    from koala3d.reconstruct.rendered.surfaces import surface_of

    return surface_of(scene.shape(), CELLS)


def test_the_mirror_is_where_its_line_says() -> None:
    """High up all light is specular, low down all of it diffuse."""
    maps, camera, pose = looked("half_mirror", 1), camera_of(SIZE), POSES[1]
    rays = camera.directions(camera.pixel_centres()) @ pose[:3, :3].T
    height = (pose[:3, 3] + maps["depth"] * rays)[..., 2] / RADIUS_M
    top, bottom = seen(maps) & (height > 0.2), seen(maps) & (height < -0.2)
    assert top.sum() > 5 and bottom.sum() > 5
    assert maps["diffuse"][top].max() < 1e-6 and maps["specular"][bottom].max() < 1e-6  # the renderer's rounding


def test_the_same_view_is_the_same_again() -> None:
    scene = NEAR["half_mirror"]()
    again = Lit(scene, scene.shape(), cells=CELLS, using=SURE).maps(camera_of(SIZE), POSES[3])
    assert all((again[channel] == values).all() for channel, values in looked("half_mirror").items())


def test_all_materials_are_there_and_mixed_ones_stand_alone() -> None:
    parts = [part.material for made in NEAR.values() for part in made().parts]
    assert {type(material) for material in parts} == {Metal, Matte, Coated, Partly, Glass}
    for made in NEAR.values():
        kinds = [type(part.material) for part in made().parts]
        assert len(kinds) == 1 or not {Coated, Partly} & set(kinds)


def test_lamps_hang_behind_the_cameras_and_near() -> None:
    """No camera sees a lamp before the scene, and none is so far that its direction is the same at all places."""
    assert DISTANCE_M / RADIUS_M < LAMP_DISTANCE - LAMP_RADIUS < LAMP_DISTANCE < 7
    for made in NEAR.values():
        for lamp in made().lamps:
            np.testing.assert_allclose(np.linalg.norm(lamp.place), LAMP_DISTANCE, rtol=1e-9)


def test_ten_scenes_make_the_benchmark() -> None:
    assert len(BENCHMARK) == 10 and set(BENCHMARK) <= set(STAGES)
