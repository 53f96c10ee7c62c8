"""How simulated objects were turned over, against the motion that the simulation used; and what cannot be told."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from koala3d.capture.sim.laboratory.scenes import stage
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.cli import main
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.edit.turned import by_points, joined
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.process.world.similarity import between
from koala3d.datasets.reports.scene import cameras, turned_views
from koala3d.datasets.scene import TURNED, Scene, View
from koala3d.datasets.segmentation.known_shape import silhouettes
from koala3d.datasets.turned.outlines import outlines_of
from koala3d.datasets.turned.registration import Registration, registered
from koala3d.datasets.turned.tangency import Pairs
from koala3d.reconstruct.cli import main as reconstruct

CENTRE, SIZE = np.array([0.4, 0.0, 0.1]), np.array([0.2, 0.2, 0.2])
CAMERA = Camera(480, 360, 560.0, 560.0, 240.0, 180.0, k1=-0.05)
VIEWS = 24
Drawn = Callable[[list[View]], list[np.ndarray]]


def cameras_of(lying: str) -> list[np.ndarray]:
    """Cameras of an arm that goes around the table, 5 to 70 degrees above it: of each session its own."""
    rng, found = np.random.default_rng([7, *lying.encode()]), []
    for index in range(VIEWS):
        height, angle = np.deg2rad(rng.uniform(5, 70)), 2.4 * index
        outward = [np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.sin(height)]
        found.append(pose.look_at(CENTRE + 0.45 * np.array(outward), CENTRE))
    return found


def scene_of(name: str, lying: str, drawn: Drawn, folder: Path) -> Scene:
    folder = folder / f"{name}_{lying}"
    views = [View(f"{i:02d}", CAMERA, m, "train", folder / f"{i:02d}.png") for i, m in enumerate(cameras_of(lying))]
    for view, mask in zip(views, drawn(views), strict=True):
        images.write(view.image, np.concatenate([np.full((*mask.shape, 3), 0.5), mask[..., None].astype(float)], -1))
    box = np.stack([CENTRE - SIZE / 2, CENTRE + SIZE / 2])
    return Scene(f"{name}_{lying}", tuple(views), 0.1, 1.0, box, "white", True, provenance={"pose": lying})


@cache
def mesh_of(name: str, lying: str) -> trimesh.Trimesh:
    return stage(name, centre=CENTRE, size=SIZE, seed=0, pose=lying).mesh()


def of_stage(name: str, lying: str, folder: Path) -> Scene:
    mesh = mesh_of(name, lying)
    return scene_of(name, lying, lambda views: silhouettes(views, mesh.vertices, mesh.faces), folder)


def of_solids(name: str, lying: str, folder: Path, *solids: np.ndarray, moved: np.ndarray | None = None) -> Scene:
    """An object of convex solids, given by (n, 3) corners about its middle."""
    moved = pose.rigid(np.eye(3), CENTRE) if moved is None else moved

    def drawn(views: list[View]) -> list[np.ndarray]:
        masks = []
        for view in views:
            mask = np.zeros((4 * CAMERA.height, 4 * CAMERA.width), np.uint8)
            for solid in solids:
                local = (solid @ moved[:3, :3].T + moved[:3, 3] - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
                pixels = CAMERA.project(local)
                corners = np.rint(16 * (4 * pixels[ConvexHull(pixels).vertices] - 0.5)).astype(np.int32)
                cv2.fillConvexPoly(mask, corners, 1, shift=4)
            masks.append(mask.reshape(CAMERA.height, 4, CAMERA.width, 4).mean((1, 3)))
        return masks

    return scene_of(name, lying, drawn, folder)


def block(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    return trimesh.creation.box(size).vertices + at


BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.06).vertices
BRICK = block((0.12, 0.08, 0.05))
ODD = (BRICK, block((0.03, 0.02, 0.06), (0.03, 0.01, 0.05)), block((0.02, 0.05, 0.02), (-0.06, -0.01, 0.01)))
OVER = pose.from_rotation_vector(np.deg2rad(170) * np.array([0.8, 0.55, 0.2]) / np.linalg.norm([0.8, 0.55, 0.2]), CENTRE + 0.02)


def errors(found: Registration, a_from_b: np.ndarray) -> tuple[float, float]:
    """How far the object's middle is off [mm], and the turn [deg]."""
    b_from_a = pose.inverse(a_from_b)
    back = found.a_from_b @ b_from_a
    off = back[:3, :3] @ found.middle + back[:3, 3] - found.middle
    return 1e3 * float(np.linalg.norm(off)), float(np.rad2deg(pose.rotation_angle(back)))


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("crystal_capture", "lidar_guts", "gold_head")]


@pytest.mark.parametrize("name", ["mug", *SLOW])
def test_the_laboratorys_objects_are_found(name: str, tmp_path: Path) -> None:
    """Wanted are 0.3 mm and 0.2 degrees; a pixel is 0.8 mm wide at the object. Deviations hold to three of them."""
    a, b = (of_stage(name, lying, tmp_path) for lying in ("upright", "under"))
    found = registered(a, b)
    true = between(mesh_of(name, "under").vertices, mesh_of(name, "upright").vertices)
    off_mm, off_deg = errors(found, pose.rigid(true.rotation, true.translation))
    assert off_mm < 0.3 and off_deg < 0.2, (off_mm, off_deg)
    shift, turn = found.deviations
    assert off_mm < 3 * 1e3 * shift + 0.03 and off_deg < 3 * np.rad2deg(turn) + 0.03, (off_mm, off_deg, found.deviations)


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Scene]:
    folder = tmp_path_factory.mktemp("odd")
    return of_solids("odd", "upright", folder, *ODD), of_solids("odd", "under", folder, *ODD, moved=OVER)


TRUE = pose.rigid(np.eye(3), CENTRE) @ pose.inverse(OVER)
DRAWS = 4


def test_stated_deviations_hold(tmp_path: Path) -> None:
    """Squares of errors over the stated covariance are 1 in the mean, but for what 24 of them vary: by 0.29.

    Other cameras and another motion each time."""
    squares = []
    for draw in range(DRAWS):
        rng = np.random.default_rng(draw)
        over = pose.from_rotation_vector(np.deg2rad(rng.uniform(160, 200)) * unit(rng.normal(size=3) * [1, 1, 0.2]), CENTRE)
        over[:3, 3] += rng.uniform(-0.02, 0.02, 3)
        a = of_solids("odd", f"upright {draw}", tmp_path, *ODD)
        b = of_solids("odd", f"under {draw}", tmp_path, *ODD, moved=over)
        true = pose.rigid(np.eye(3), CENTRE) @ pose.inverse(over)
        found = registered(a, b, true)
        by = found.error(true)
        np.testing.assert_allclose([1e3 * np.linalg.norm(by[:3]), np.rad2deg(np.linalg.norm(by[3:]))], errors(found, true))
        squares.append(by @ np.linalg.solve(found.covariance, by) / 6)
    assert 0.25 < np.mean(squares) < 1.7, squares


def test_shadows_on_the_table_do_not_pull(tmp_path: Path) -> None:
    """Masks that were found in pictures are of what lies around the object's foot as well, in each session around another end."""
    a, b = (with_shadow("lidar_guts", lying, tmp_path) for lying in ("upright", "under"))
    moved = between(mesh_of("lidar_guts", "under").vertices, mesh_of("lidar_guts", "upright").vertices)
    true = pose.rigid(moved.rotation, moved.translation)
    of_a, of_b = outlines_of(a), outlines_of(b)
    pulled = Pairs(of_a, of_b, low=True).refined(true, 30)
    assert errors(Registration(pulled.a_from_b, of_a.middle, np.eye(6), 0.0), true)[0] > 2
    found = registered(a, b, true[:3, :3])
    off_mm, off_deg = errors(found, true)
    assert off_mm < 0.7 and off_deg < 0.5, (off_mm, off_deg)
    assert off_mm < 2e3 * found.deviations[0] and off_deg < 2 * np.rad2deg(found.deviations[1])


def with_shadow(name: str, lying: str, folder: Path) -> Scene:
    """An object of the laboratory, whose masks are too large by 3 mm where it stands."""
    mesh = mesh_of(name, lying)
    lowest = mesh.bounds[0, 2]
    foot = mesh.vertices[mesh.vertices[:, 2] < lowest + 0.02, :2]
    outward = foot - foot.mean(0)
    foot = foot + 0.003 * outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    shadow = trimesh.convex.convex_hull(np.concatenate([np.insert(foot, 2, lowest + up, axis=1) for up in (0, 0.003)]))
    both = trimesh.util.concatenate([mesh, shadow])
    scene = scene_of(name, lying, lambda views: silhouettes(views, both.vertices, both.faces), folder)
    return replace(scene, box=np.array([[*scene.box[0, :2], lowest], scene.box[1]]))


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def test_a_person_may_say_how_it_was_turned(odd: tuple[Scene, Scene]) -> None:
    rough = pose.from_rotation_vector((0.2, -0.15, 0.1)) @ TRUE
    assert errors(registered(*odd, rough[:3, :3]), TRUE)[1] < 0.2
    points = np.array([[0.05, 0.03, 0.02], [-0.05, 0.03, 0.02], [0.05, -0.03, -0.02]])
    in_a, in_b = points + CENTRE, points @ OVER[:3, :3].T + OVER[:3, 3]
    by_hand = np.concatenate([in_a, in_b], 1) + np.random.default_rng(0).normal(0, 2e-3, (3, 6))
    off = by_points(by_hand) @ pose.inverse(TRUE)
    assert np.rad2deg(pose.rotation_angle(off)) < 6
    off_mm, off_deg = errors(registered(*odd, by_points(by_hand)), TRUE)
    assert off_mm < 0.3 and off_deg < 0.2
    np.testing.assert_allclose(by_points(np.concatenate([in_a, in_b], 1)), TRUE, atol=1e-12)
    for wrong, message in (
        (by_hand[:2], "three rows"),
        (by_hand[[0, 0, 1]], "on a line"),
        (by_hand * [1, 1, 1, 2, 2, 2], "same"),
    ):
        with pytest.raises(UsageError, match=message):
            by_points(wrong)


def test_both_sessions_are_one_scene(odd: tuple[Scene, Scene]) -> None:
    a, b = odd
    found = registered(a, b, TRUE[:3, :3])
    both = joined(a, b, found, "both")
    stated = Registration.from_json(json.loads(json.dumps(both.provenance[TURNED])))
    assert all((getattr(stated, name) == getattr(found, name)).all() for name in ("a_from_b", "middle", "covariance"))
    assert both.lamps == "room" and "turned over, by" in both.notes[-1] and "taken to stand in the room" in both.notes[0]
    assert both.provenance[TURNED]["views"] == [f"odd_under/{view.name}" for view in b.views]
    spot = np.array([0.03, 0.02, 0.05])
    for view, old, placed in zip(both.views[VIEWS:], b.views, [OVER] * VIEWS, strict=True):
        in_a, in_b = np.append(spot + CENTRE, 1), placed @ np.append(spot, 1)
        assert view.base_from_world is not None
        np.testing.assert_allclose(view.base_from_world @ in_a, in_b, atol=3e-4)  # where it was in the room
        seen, known = (pose.inverse(m.world_from_camera) @ x for m, x in ((view, in_a), (old, in_b)))
        np.testing.assert_allclose(seen, known, atol=3e-4)
    corners = np.concatenate(ODD) + CENTRE
    lower, upper = corners.min(0), corners.max(0)
    assert (both.box[0] < lower).all() and (both.box[1] > upper).all()
    assert (both.box[0] > lower - 0.03).all() and (both.box[1] < upper + 0.03).all()  # a hull bulges where cameras look along


def test_the_command_writes_one_scene(odd: tuple[Scene, Scene], run_inside: Callable[..., Any], tmp_path: Path) -> None:
    for scene, name in zip(odd, "ab", strict=True):
        koala.save(scene, tmp_path / name)
    points = np.array([[0.05, 0.03, 0.02], [-0.05, 0.03, 0.02], [0.05, -0.03, -0.02]])
    rows = np.concatenate([points + CENTRE, points @ OVER[:3, :3].T + OVER[:3, 3]], 1)
    (tmp_path / "points.txt").write_text("\n".join(", ".join(map(str, row)) for row in rows) + "\n\n")
    merge = partial(run_inside, main, "datasets", "merge", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "both")
    done = merge("--turned", "--points", tmp_path / "points.txt", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)[TURNED]
    assert said["deviations"]["shift"] < 3e-4 and said["misfit_px"] < 1
    both = load_scene(tmp_path / "both")
    assert len(both.views) == 2 * VIEWS and both.provenance[TURNED]["views"] == [f"odd_under/{i:02d}" for i in range(VIEWS)]
    assert turned_views(both) == set(both.provenance[TURNED]["views"]) and "<svg" in cameras(both)
    (tmp_path / "points.txt").write_text("0 0 zero")
    for code, words, message in (
        (1, ("--turned", "--points", tmp_path / "points.txt"), "points.txt: points cannot be read"),
        (2, ("--turned", "--rough", "180", "0", "0", "--points", tmp_path / "points.txt"), "says the same as --points"),
        (2, ("--rough", "180", "0", "0"), "add --turned"),
        (2, ("--turned", tmp_path / "a"), "3 scenes are given"),
    ):
        done = merge(*words, "--out", tmp_path / "other")
        assert done.returncode == code and message in done.stderr and done.stderr.count("\n") == 1, done.stderr


def test_a_motion_may_come_from_both_surfaces(odd: tuple[Scene, Scene], run_inside: Callable[..., Any], tmp_path: Path) -> None:
    """`compare-shape` places the surface of the second session on that of the first, and `merge` takes its word."""
    for scene, name, moved in zip(odd, "ab", (pose.rigid(np.eye(3), CENTRE), OVER), strict=True):
        koala.save(scene, tmp_path / name)
        solid = trimesh.util.concatenate([trimesh.convex.convex_hull(corners).subdivide_to_size(0.004) for corners in ODD])
        solid.apply_transform(moved).export(tmp_path / f"{name}.ply")

    def compared(out: str, *words: object) -> Path:
        done = run_inside(reconstruct, "reconstruct", "compare-shape", *words, "--out", tmp_path / out)
        assert done.returncode == 0, done.stderr
        return tmp_path / out / "shape.json"

    a, b = tmp_path / "a.ply", tmp_path / "b.ply"
    motion = compared("found", b, a, "--align", "features")
    merge = partial(run_inside, main, "datasets", "merge", tmp_path / "a", tmp_path / "b", "--turned", "--motion")
    done = merge(motion, "--out", tmp_path / "both", "--json")
    assert done.returncode == 0, done.stderr
    found = Registration.from_json(load_scene(tmp_path / "both").provenance[TURNED])
    off_mm, off_deg = errors(found, TRUE)
    assert off_mm < 0.05 and off_deg < 0.05 and found.misfit < 1, (off_mm, off_deg, found.misfit)
    (tmp_path / "nan.json").write_text(motion.read_text().replace('"middle": [', '"middle": [NaN,', 1))
    content = json.loads(motion.read_text())
    content["aligned"]["covariance"] = np.diag([1e-8] * 3 + [1e-4, 1e-4, 3e-4]).tolist()
    (tmp_path / "loose.json").write_text(json.dumps(content))
    (tmp_path / "twice.json").write_text(motion.read_text().replace('"ambiguous": false', '"ambiguous": true'))
    for file, message in (
        (compared("backwards", a, b, "--align", "features"), "the motion is not of these scenes"),
        (compared("still", a, a, "--align", "base"), "B was left where it stands"),
        (compared("sized", b, a, "--align", "features", "--scale"), "the difference in size was removed"),
        (tmp_path / "nan.json", "states no motion"),
        (tmp_path / "loose.json", "cannot be told (the turn is known to 1.3 degrees)"),
        (tmp_path / "twice.json", "another pose of the surfaces fits as well"),
        (tmp_path / "both" / "cameras.json", "is not a koala-shape file"),
    ):
        done = merge(file, "--out", tmp_path / "other")
        assert done.returncode and message in done.stderr and done.stderr.count("\n") == 1, done.stderr
        assert not (tmp_path / "other").exists()


def test_how_a_ball_was_turned_is_not_told(tmp_path: Path) -> None:
    balls = [of_solids("ball", lying, tmp_path, BALL, moved=m) for lying, m in (("upright", None), ("under", OVER))]
    with pytest.raises(
        UsageError, match=r"ball_upright, ball_under: how the object was turned cannot be told .*same in \d+ poses"
    ):
        registered(*balls)
    with pytest.raises(UsageError, match=r"cannot be told"):  # nor with help, which says nothing of a ball
        registered(*balls, TRUE[:3, :3])


def test_a_brick_may_lie_in_four_ways(tmp_path: Path) -> None:
    bricks = [of_solids("brick", lying, tmp_path, BRICK, moved=m) for lying, m in (("upright", None), ("under", OVER))]
    with pytest.raises(UsageError, match=r"same in 4 poses.*by 180, 180, 180 degrees.*--points or --rough"):
        registered(*bricks)
    assert errors(registered(*bricks, TRUE[:3, :3]), TRUE)[1] < 0.2  # a person knows which


def test_scenes_that_do_not_belong_together_are_refused(odd: tuple[Scene, Scene], tmp_path: Path) -> None:
    a, b = odd
    other = of_solids("other", "under", tmp_path, block((0.15, 0.03, 0.03)), block((0.03, 0.1, 0.03)), moved=OVER)
    with pytest.raises(UsageError, match=r"odd_upright, other_under: .* fit in no pose \(in the best pose they miss .* px\)"):
        registered(a, other)
    with pytest.raises(UsageError, match=r"of the same pose .*'under'.*--pose under"):
        registered(b, b)
    again = replace(of_solids("odd", "again", tmp_path, *ODD))
    with pytest.raises(UsageError, match="lies in both scenes as it did"):
        registered(a, again, np.eye(3))
    summed = [replace(s, provenance={**s.provenance, "calibration_sha256": s.name}) for s in odd]
    with pytest.raises(UsageError, match=r"different calibrations.*build both"):
        registered(*summed)
    with pytest.raises(UsageError, match="only odd_upright is in metres"):
        registered(a, replace(b, metric=False))
    with pytest.raises(UsageError, match=r"odd_under: scene has no masks of the object.*'datasets mask'"):
        registered(a, replace(b, background="scene"))
    with pytest.raises(UsageError, match=r"5 of 5 masks have room.*at least 6"):
        registered(a, b.with_views(b.views[:5]))
