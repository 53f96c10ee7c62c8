import numpy as np
import pytest
import trimesh

from koala3d.capture.sim.laboratory import pieces, textures
from koala3d.capture.sim.laboratory.materials import Glass, Matt, Metal
from koala3d.capture.sim.laboratory.scenes import SCENES, check_name, stage
from koala3d.datasets import pose
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.process.world.similarity import between

CENTRE, SIZE = np.array([0.45, 0.02, 0.15]), np.array([0.26, 0.26, 0.30])


@pytest.mark.parametrize(
    ("name", "material"), [("gold_head", "Au"), ("shiny_ball", "Ag"), ("lidar_guts", "Al"), ("crystal_capture", ""), ("mug", "")]
)
def test_object_stands_on_the_table_inside_its_volume(name, material):
    found = stage(name, centre=CENTRE, size=SIZE, seed=0)
    lower, upper = found.mesh().bounds
    metals = [item.material.name for item in found.items[: found.parts] if isinstance(item.material, Metal)]
    assert metals[:1] == [material][: bool(material)]
    assert lower[2] == pytest.approx(0.0, abs=1e-9)
    assert (lower > CENTRE - SIZE / 2 - 1e-9).all() and (upper < CENTRE + SIZE / 2 + 1e-9).all()
    np.testing.assert_allclose((lower + upper)[:2] / 2, CENTRE[:2], atol=1e-9)


def test_object_is_made_smaller_for_a_small_volume():
    small = stage("gold_head", centre=(0.4, 0, 0.05), size=(0.1, 0.1, 0.1), seed=0).items[0].mesh
    assert small.extents.max() == pytest.approx(0.1)


def test_nothing_else_is_in_the_object_volume():
    for seed in range(3):
        for item in stage("shiny_ball", centre=CENTRE, size=SIZE, seed=seed).items[2:]:  # all but ball and table
            away = np.abs(item.mesh.vertices[:, :2] - CENTRE[:2]) - SIZE[:2] / 2
            assert (away.max(1) > 0).all(), item.name


def test_same_seed_same_laboratory():
    first, again, other = (stage("shiny_ball", centre=CENTRE, size=SIZE, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.room, again.room) and not np.array_equal(first.room, other.room)
    table, same = first.items[1].material, again.items[1].material
    assert isinstance(table, Matt) and isinstance(same, Matt) and np.array_equal(table.reflectance, same.reflectance)


@pytest.mark.parametrize("name", ["lidar_guts", "crystal_capture"])
def test_made_of_many_parts_that_follow_the_seed(name):
    first, again, other = (stage(name, centre=CENTRE, size=SIZE, seed=seed) for seed in (1, 1, 2))
    assert first.parts >= 2 and first.transparent and isinstance(first.items[first.parts - 1].material, Glass)
    vertices = [found.mesh().vertices for found in (first, again, other)]
    assert np.array_equal(vertices[0], vertices[1])
    assert vertices[0].shape != vertices[2].shape or not np.allclose(vertices[0], vertices[2])
    for item in first.items[: first.parts]:
        if isinstance(item.material, Glass):
            assert item.mesh.is_watertight and item.mesh.volume > 0, item.name  # light must find the way out again


@pytest.mark.parametrize("name", ["gold_head", "lidar_guts", "crystal_capture", "mug"])
def test_turned_over_it_is_the_same_object_on_the_same_table(name):
    """About 180 degrees (160 to 200) about an axis at most 20 degrees from level: what was up is at most 40 degrees from down."""
    upright, under, again = (stage(name, centre=CENTRE, size=SIZE, seed=3, pose=lying) for lying in ("upright", "under", "under"))
    known, moved = upright.mesh(), under.mesh()
    found = between(known.vertices, moved.vertices)
    np.testing.assert_allclose(found.points(known.vertices), moved.vertices, atol=1e-9)
    assert found.scale == pytest.approx(1)
    angle = np.rad2deg(pose.rotation_angle(pose.rigid(found.rotation, [0, 0, 0])))
    assert 160 <= angle <= 180 and found.rotation[2, 2] < np.cos(np.deg2rad(120))
    assert moved.bounds[0, 2] == pytest.approx(0, abs=1e-9)
    assert np.abs((moved.bounds.sum(0) / 2 - CENTRE)[:2]).max() <= 0.02 + 1e-9
    assert np.array_equal(again.mesh().vertices, moved.vertices)
    for one, other in zip(upright.items[upright.parts :], under.items[under.parts :], strict=True):
        assert np.array_equal(one.mesh.vertices, other.mesh.vertices), one.name
    assert np.array_equal(upright.room, under.room)


def test_unknown_scene_names_the_nearest():
    with pytest.raises(UsageError, match="did you mean 'gold_head'"):
        check_name("gold_hed")
    assert all(check_name(name) == name for name in SCENES)


def test_board_has_no_object():
    with pytest.raises(KoalaError, match="no object"):
        stage("board", centre=CENTRE, size=SIZE, seed=0)


def test_textures_are_physical():
    rng = np.random.default_rng(0)
    table, room = textures.table_top(rng, 256), textures.room(rng, 64)
    assert table.shape == (256, 256, 3) and 0 < table.min() and table.max() < 1  # no surface gives more light than it gets
    assert room.shape == (64, 128, 3) and room.min() > 0 and room.max() > 20 * np.median(room)  # panels to mirror
    assert np.abs(room[:, 0] - room[:, -1]).max() < 0.2  # closes on itself


def test_noise_covers_its_range_without_jumps():
    noise = textures.noise(100, 120, 6, np.random.default_rng(3))
    assert noise.shape == (100, 120) and noise.min() >= 0 and noise.max() <= 1 and np.ptp(noise) > 0.6
    assert np.abs(np.diff(noise, axis=0)).max() < 0.2


@pytest.mark.parametrize("name", ["gold_head", "lidar_guts", "crystal_capture"])
def test_a_dent_is_a_millimetre_deep_and_nothing_else_differs(name):
    drawn, dented = (stage(piece, centre=CENTRE, size=SIZE, seed=2) for piece in (name, f"{name}-dented"))
    moved = {}
    for before, item in zip(drawn.items[: drawn.parts], dented.items, strict=False):
        vertices = item.mesh.vertices
        away = np.minimum(before.mesh.kdtree.query(vertices)[0], trimesh.proximity.closest_point(before.mesh, vertices)[1])
        moved[item.name] = away
        assert item.mesh.is_watertight == before.mesh.is_watertight, item.name
        far = np.linalg.norm(vertices - vertices[np.argmax(away)], axis=1) > 2.2 * pieces.RADIUS
        assert away[far].max(initial=0) < 1e-9 or away.max() < 1e-9
    deepest = max(away.max() for away in moved.values())
    assert 0.95 * pieces.DEPTH < deepest < 1.05 * pieces.DEPTH
    assert dented.mesh().extents == pytest.approx(drawn.mesh().extents, abs=1e-9)


def test_an_enlarged_piece_stands_where_the_other_does():
    drawn, enlarged = (stage(piece, centre=CENTRE, size=SIZE, seed=2).mesh() for piece in ("mug", "mug-enlarged"))
    assert enlarged.extents == pytest.approx(1.003 * drawn.extents)
    assert enlarged.bounds[0, 2] == pytest.approx(0, abs=1e-9)


def test_only_objects_have_pieces_that_are_not_as_drawn():
    assert check_name("mug-dented") == "mug-dented"
    with pytest.raises(UsageError, match="unknown scene 'board-dented'"):
        check_name("board-dented")
