"""Scenes of an object that turned on a table: poses in its frame, and where the lamps stand still."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.building.build import BACKGROUND_STANDS, build
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.edit.edit import merge
from koala3d.datasets.formats import load_scene, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.process.world.similarity import Similarity
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.turntable import Axis

CAMERA = Camera(24, 18, 30.0, 30.0, 12.0, 9.0)
MOUNT = pose.from_rotation_vector((0.7, 0.02, -0.01), (0.001, 0.06, 0.08))
AXIS = Axis.of(pose.from_rotation_vector((0.01, -0.02, 0.0), (0.41, 0.003, 0.0)))
ANGLES = np.radians([0.0, 90.0, 180.0, 270.0])
ROOM = [{"name": "key", "stands": "room"}]


def recorded(path: Path, lamps, lights, *, angles=ANGLES, azimuths=(0.0, 0.0, 0.0, 0.0)) -> Recording:
    """Frames of a camera that stands still, or at other azimuths about the object, while the table turns."""
    box = {"centre": [0.41, 0.0, 0.1], "size": [0.2, 0.2, 0.2]}
    manifest = {"trajectory": {"object": box}, "rig": {"lights": lamps}, "camera": {"region": Region(24, 18).to_json()}}
    recording = Recording.create(path, manifest)
    for index, (angle, azimuth) in enumerate(zip(angles, azimuths, strict=True)):
        eye = (0.41 + 0.4 * np.cos(azimuth), 0.4 * np.sin(azimuth), 0.3)
        flange = pose.look_at(eye, (0.41, 0, 0.1)) @ pose.inverse(MOUNT)
        picture = path / "images" / f"{index}.png"
        images.write(picture, np.full((18, 24, 3), 0.1 * index))
        recording.append(
            Frame(
                index=index,
                name=f"{index}",
                split="train",
                image=f"images/{index}.png",
                base_from_flange=flange,
                joints=np.zeros(6),
                robot_time_s=1.0,
                host_time_ns=1,
                device_ticks=1,
                exposure_us=1e4,
                settle_s=0.3,
                sha256=files.sha256(picture),
                turntable_angle=angle,
                turntable_angle_after=angle,
                lights=lights,
            )
        )
    return Recording.open(path)


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    found = Calibration(CAMERA, {}, UncertainPose(MOUNT, 1e-8 * np.eye(6)), region=Region(24, 18), turntable=AXIS)
    found.save(tmp_path / "cal.json")
    return tmp_path / "cal.json"


def test_a_turn_keeps_the_axis_and_composes() -> None:
    on_axis = AXIS.point + 0.3 * AXIS.direction
    for angle in (0.3, -2.0, 7.0):
        moved = AXIS.base_from_object(angle)
        np.testing.assert_allclose(moved[:3, :3] @ on_axis + moved[:3, 3], on_axis, atol=1e-15)
        np.testing.assert_allclose(moved @ AXIS.base_from_object(1.1), AXIS.base_from_object(angle + 1.1), atol=1e-14)
    upright = Axis.of(np.eye(4))
    np.testing.assert_allclose(upright.base_from_object(np.pi / 2) @ [1, 0, 0, 1], [0, 1, 0, 1], atol=1e-15)  # right-handed
    shifted = Axis(AXIS.point + [0, 0.002, 0] + 0.1 * AXIS.direction, AXIS.direction, np.zeros((6, 6)))
    assert AXIS.difference(shifted) == pytest.approx((0.002, 0.0), abs=1e-6)


def test_poses_are_in_the_objects_frame(tmp_path: Path, calibration: Path) -> None:
    recording = recorded(tmp_path / "rec", ROOM, ("key",))
    assert recording.turns and recording.frames[1].lights == ("key",)
    build(recording.path, calibration, tmp_path / "scene")
    scene = load_scene(tmp_path / "scene")
    spot = np.array([0.45, 0.02, 0.15, 1.0])  # on the object, with the table at zero
    for view, frame in zip(scene.views, recording.frames, strict=True):
        moved = AXIS.base_from_object(frame.turntable_angle) @ spot  # where it is in the base
        seen = pose.inverse(frame.base_from_flange @ MOUNT) @ moved
        np.testing.assert_allclose(pose.inverse(view.world_from_camera) @ spot, seen, atol=1e-12)
        np.testing.assert_allclose(view.base_from_world @ spot, moved, atol=1e-12)
    np.testing.assert_allclose(scene.views[0].world_from_camera, recording.frames[0].base_from_flange @ MOUNT, atol=1e-12)
    assert scene.lamps == "room"
    assert scene.notes == (BACKGROUND_STANDS,) and np.allclose(scene.box, [[0.31, -0.1, 0.0], [0.51, 0.1, 0.2]])
    save_scene(scene, tmp_path / "colmap", "colmap")
    again = load_scene(tmp_path / "colmap")
    assert again.lamps == "room" and merge([scene, scene], "both").lamps == "room"
    for view, known in zip(again.views, scene.views, strict=True):
        np.testing.assert_allclose(view.base_from_world, known.base_from_world, atol=1e-12)


def test_in_another_world_the_object_is_where_it_was(tmp_path: Path, calibration: Path) -> None:
    view = build(recorded(tmp_path / "rec", ROOM, ("key",)).path, calibration, tmp_path / "scene").views[1]
    moved = Similarity(2.0, pose.from_rotation_vector((0.3, -0.2, 1.0))[:3, :3], np.array([0.1, 0.2, 0.3]))
    after, spot = moved.view(view), np.array([0.45, 0.02, 0.15])
    new = after.base_from_world @ [*moved.points(spot), 1]
    np.testing.assert_allclose(new[:3], 2 * (view.base_from_world @ [*spot, 1])[:3], atol=1e-12)  # of the new unit


def test_a_calibration_without_axis_is_refused(tmp_path: Path) -> None:
    Calibration(CAMERA, {}, UncertainPose(MOUNT, np.eye(6)), region=Region(24, 18)).save(tmp_path / "cal.json")
    recording = recorded(tmp_path / "rec", ROOM, ("key",))
    with pytest.raises(DatasetError, match=r"no axis of the turntable \(the object turned\).*'calib turntable'"):
        build(recording.path, tmp_path / "cal.json", tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


RING, PLATE = {"name": "ring", "stands": "flange"}, {"name": "lid", "stands": "turntable"}


@pytest.mark.parametrize(
    ("lamps", "lights", "turned", "stand", "note"),
    [
        (ROOM, ("key",), True, "room", ""),
        (ROOM, ("key",), False, "room", ""),
        ([RING], ("ring",), True, "camera", ""),
        ([RING], ("ring",), False, "camera", ""),
        ([PLATE], ("lid",), True, "object", ""),
        ([*ROOM, PLATE], ("lid", "key"), False, "room", ""),
        ([*ROOM, RING], ("ring",), True, "camera", ""),
        ([*ROOM, RING], ("ring", "key"), True, None, "lamps stood on the camera and the room"),
        ([], None, True, "room", "taken to stand in the room"),
        ([], None, False, None, ""),
        (ROOM, (), True, None, "every lamp was off"),
    ],
)
def test_scenes_say_what_lamps_stand_on(lamps, lights, turned, stand, note, tmp_path: Path, calibration: Path) -> None:
    angles = ANGLES if turned else 0 * ANGLES
    azimuths = (0, 0, 0, 0) if turned else (0, 1.5, 3, 4.5)
    recording = recorded(tmp_path / "rec", lamps, lights, angles=angles, azimuths=azimuths)
    scene = build(recording.path, calibration, tmp_path / "scene")
    assert scene.lamps == stand
    assert note in " ".join(scene.notes) and ("lamp" in " ".join(scene.notes)) == bool(note)


def test_files_that_name_a_light_frame_are_read(tmp_path: Path, calibration: Path) -> None:
    """A camera that stands on one side: the poses are the turntable's, but for one turn of the room and the axis's place."""
    known = build(recorded(tmp_path / "rec", ROOM, ("key",)).path, calibration, tmp_path / "scene")
    path = tmp_path / "scene" / "cameras.json"
    content = files.read_json(path)
    del content["lamps"]
    for view in content["views"]:
        del view["base_from_world"]
    older = {"light_frame": "turntable", "light_axis": AXIS.direction.tolist()}
    files.write_json(path, {**content, **older})
    scene = load_scene(tmp_path / "scene")
    assert scene.lamps == "room"
    turned = [a.base_from_world[:3, :3] @ b.base_from_world[:3, :3].T for a, b in zip(scene.views, known.views, strict=True)]
    np.testing.assert_allclose(turned, np.broadcast_to(turned[0], (4, 3, 3)), atol=5e-3)  # the axis is not quite in the middle
    for frame, lamps in (("world", "object"), ("camera", "camera"), ("turntable", "room")):
        files.write_json(path, {**content, "light_frame": frame})
        scene = load_scene(tmp_path / "scene")
        assert scene.lamps == lamps and scene.views[0].base_from_world is None


def test_an_object_that_turns_before_an_arm_that_goes_around_it_is_placed(tmp_path: Path, calibration: Path) -> None:
    recording = recorded(tmp_path / "rec", ROOM, ("key",), azimuths=(0.0, 0.3, 0.6, 0.9))
    scene = build(recording.path, calibration, tmp_path / "scene")
    assert scene.lamps == "room" and scene.views[3].base_from_world is not None
    np.testing.assert_allclose(scene.views[3].base_from_world, AXIS.base_from_object(ANGLES[3]))


def test_an_unknown_lamp_is_an_error(tmp_path: Path, calibration: Path) -> None:
    recording = recorded(tmp_path / "rec", ROOM, ("sun",))
    with pytest.raises(DatasetError, match=r"unknown lamp.*sun; the rig file has key"):
        build(recording.path, calibration, tmp_path / "scene")


def test_calibrations_hold_the_axis_and_damage_is_named(calibration: Path, tmp_path: Path) -> None:
    found = Calibration.load(calibration).turntable
    assert found is not None and np.array_equal(found.point, AXIS.point) and np.allclose(found.direction, AXIS.direction)
    content = files.read_json(calibration)
    for key, value, message in (("direction", [0, 0, 2.0], "impossible"), ("point_m", [0, 0], "not complete")):
        files.write_json(tmp_path / "bad.json", {**content, "turntable": {**content["turntable"], key: value}})
        with pytest.raises(DatasetError, match=rf"turntable.*axis of the turntable is {message}"):
            Calibration.load(tmp_path / "bad.json")


@pytest.mark.parametrize("wrong", [{"turntable_angle": "much"}, {"turntable_angle": 1e9}, {"lights": "key"}, {"lights": [1]}])
def test_damaged_frames_are_named(wrong, tmp_path: Path) -> None:
    frame = recorded(tmp_path / "rec", ROOM, ("key",)).frames[0]
    with pytest.raises(DatasetError, match=rf"frame record is not complete \({next(iter(wrong))} is"):
        Frame.from_json({**frame.to_json(), **wrong}, where="line 1")
    old = {key: value for key, value in frame.to_json().items() if not key.startswith(("turntable", "lights"))}
    assert Frame.from_json(old, where="line 1").turntable_angle is None  # as recordings without a turntable have it


OLDER = {"light_frame": "turntable"}


@pytest.mark.parametrize(
    "wrong",
    [{"light_frame": "moon"}, {"lamps": "moon"}, OLDER | {"light_axis": [0, 0]}, OLDER | {"light_axis": [0, 0, 3]}],
)
def test_damaged_scenes_are_named(wrong, tmp_path: Path, calibration: Path) -> None:
    build(recorded(tmp_path / "rec", ROOM, ("key",)).path, calibration, tmp_path / "scene")
    path = tmp_path / "scene" / "cameras.json"
    content = files.read_json(path)
    files.write_json(path, {**content, **wrong})
    with pytest.raises(DatasetError, match=r"cameras.json: (no light frame called 'moon'|no lamps on 'moon'|light_axis is no)"):
        load_scene(tmp_path / "scene")
    content["views"][1]["base_from_world"] = np.diag([1.0, 2, 1, 1]).tolist()
    files.write_json(path, content)
    with pytest.raises(DatasetError, match=r"view 1 \(1\), base_from_world"):
        load_scene(tmp_path / "scene")
