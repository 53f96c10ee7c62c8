"""Every format of `calib export`, read back by the foreign program's own reader, or by its description written out here.

What is compared is the pixel at which a point is seen: in the base or on the flange by way of the pose, and in the camera by way
of the lens. cv2 does the projection, so that only numbers of the file take part.
"""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from koala3d.calib.cli import main
from koala3d.calib.export.formats import FORMATS
from koala3d.calib.export.lens import FURTHEST_PX, RATIONAL, Model, held
from koala3d.calib.sessions.description import load_description
from koala3d.calib.sessions.pose_table import read
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, LinkErrors, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.recording import Recording
from koala3d.datasets.spline import Grid, Spline

PINHOLE = Camera(960, 600, 850.0, 848.0, 484.25, 296.5)
MILD = replace(PINHOLE, k1=-0.08, k2=0.05, p1=0.0006, p2=-0.0004)
BROWN = replace(MILD, k3=0.002)
BENT = replace(MILD, k3=2.0)
RATIONAL_LENS = replace(BROWN, k4=0.02, k5=-0.01, k6=0.003)
WIDE = Camera(960, 600, 420.0, 421.0, 481.0, 299.0, k1=0.02, k2=-0.006, k3=0.002, k4=-0.0004, fisheye=True)
MOUNT = pose.from_rotation_vector([0.4, -0.9, 1.55], [0.06, -0.013, 0.081])
UPRIGHT = pose.rigid(
    Rotation.from_euler("xyz", [0.3, np.pi / 2, -0.5]).as_matrix(), [0.1, 0.2, 0.3]
)  # only roll - yaw is defined
POINTS = np.array([[0.05, -0.11, 0.52, 1], [-0.21, 0.08, 0.61, 1]])  # in the camera [m]
SAME_PX = 1e-6  # files hold all digits; what is left is the roundoff of the projection


def calibration(camera=BROWN, mount=MOUNT, beside=False, **more):
    place = UncertainPose(mount, np.zeros((6, 6)))
    board = UncertainPose(pose.from_rotation_vector([3.0, 0.2, 0.1], [0.35, 0.1, 0.02]), np.zeros((6, 6)))
    poses = {"base_from_camera": place, "flange_from_board": board}
    return Calibration(camera, {}, **(poses if beside else {"flange_from_camera": place, "base_from_board": board}), **more)


@pytest.fixture
def export(run_inside, tmp_path):
    """Function that exports a calibration with the command and returns the file."""

    def exported(source, to, suffix=None, expect=0, extra=()):
        source.save(tmp_path / "calibration.json")
        out = tmp_path / f"arm{suffix or FORMATS[to].suffixes[0]}"
        result = run_inside(main, "calib", "export", tmp_path / "calibration.json", "--to", to, "--out", out, *extra)
        assert result.returncode == expect, result.stderr
        return out if expect == 0 else result.stderr

    return exported


def pixels(points, matrix, distortion, fisheye=False):
    """(n, 2) where cv2 sees (n, 4) points of the camera, in its own pixels."""
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    arguments = (np.zeros(3), np.zeros(3), np.asarray(matrix, float), np.asarray(distortion, float))
    return project(points[:, None, :3].copy(), *arguments)[0][:, 0]


def assert_same_pixels(camera, found, tolerance=SAME_PX):
    assert np.abs(camera.project(POINTS[:, :3]) - 0.5 - found).max() < tolerance


def assert_same_place(matrix, mount=MOUNT, camera=BROWN):
    """The points, which the true pose puts on the carrier, are seen by the file's pose where the camera sees them."""
    in_camera = POINTS @ mount.T @ pose.inverse(matrix).T
    assert np.abs(camera.project(in_camera[:, :3]) - camera.project(POINTS[:, :3])).max() < SAME_PX


@pytest.mark.parametrize("camera", [PINHOLE, BROWN, RATIONAL_LENS, WIDE])
def test_opencv_reads_the_camera_and_its_pose(export, camera):
    storage = cv2.FileStorage(str(export(calibration(camera), "opencv")), cv2.FILE_STORAGE_READ)
    matrix, distortion = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == (960, 600)
    assert bool(storage.getNode("fisheye_model").real()) == camera.fisheye
    assert_same_pixels(camera, pixels(POINTS, matrix, distortion, camera.fisheye))
    assert_same_place(storage.getNode("flange_from_camera").mat(), camera=camera)


ROS_MODELS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""Of sensor_msgs/distortion_models.hpp, with the number of coefficients that image_geometry takes."""


@pytest.mark.parametrize("camera", [PINHOLE, BROWN, RATIONAL_LENS, WIDE])
def test_ros_reads_the_camera(export, camera):
    """camera_calibration_parsers: every key of the file, matrices with rows, cols and data of that length."""
    content = yaml.safe_load(export(calibration(camera), "ros").read_text())
    matrices = {key: np.reshape(one["data"], (one["rows"], one["cols"])) for key, one in content.items() if isinstance(one, dict)}
    shapes = {"camera_matrix": (3, 3), "rectification_matrix": (3, 3), "projection_matrix": (3, 4)}
    count = ROS_MODELS[content["distortion_model"]]
    assert {key: one.shape for key, one in matrices.items()} == {**shapes, "distortion_coefficients": (1, count)}
    assert (content["image_width"], content["image_height"], content["camera_name"]) == (960, 600, "camera")
    fisheye = content["distortion_model"] == "equidistant"
    assert fisheye == camera.fisheye
    assert_same_pixels(camera, pixels(POINTS, matrices["camera_matrix"], matrices["distortion_coefficients"], fisheye))
    ideal = (matrices["projection_matrix"] @ POINTS.T).T  # of the rectified picture, as image_geometry projects
    assert_same_pixels(camera.undistorted(), ideal[:, :2] / ideal[:, 2:])


KALIBR_MODELS = {"none": 0, "radtan": 4, "equidistant": 4}


@pytest.mark.parametrize(("camera", "tolerance"), [(PINHOLE, SAME_PX), (MILD, SAME_PX), (WIDE, SAME_PX), (BROWN, FURTHEST_PX)])
def test_kalibr_reads_the_camera(export, camera, tolerance):
    """kalibr_common/ConfigReader: intrinsics fu fv pu pv, a list of coefficients as long as the model has."""
    path = export(calibration(camera), "kalibr")
    found = yaml.safe_load(path.read_text())["cam0"]
    assert found["camera_model"] == "pinhole" and found["resolution"] == [960, 600] and found["rostopic"]
    assert len(found["distortion_coeffs"]) == KALIBR_MODELS[found["distortion_model"]]
    fu, fv, pu, pv = found["intrinsics"]
    coefficients = found["distortion_coeffs"] or np.zeros(4)
    seen = pixels(POINTS, [[fu, 0, pu], [0, fv, pv], [0, 0, 1]], coefficients, found["distortion_model"] == "equidistant")
    assert_same_pixels(camera, seen, tolerance)
    assert ("px off" in path.read_text()) == (tolerance > SAME_PX)


def test_a_lens_that_a_format_cannot_hold_is_refused(export):
    message = export(calibration(BENT), "kalibr", expect=1)
    assert "Kalibr cannot hold this lens" in message and "px off" in message and len(message.strip().splitlines()) == 1


@pytest.mark.parametrize(("height", "held_by_ros"), [(1e-4, True), (2e-2, False)])
def test_a_spline_is_held_as_far_as_a_formula_follows_it(height, held_by_ros):
    grid = Grid(-0.6, -0.4, 0.3, 0.2, 5, 5)
    knots = np.zeros((5, 5, 2))
    knots[2, 2] = height
    camera = replace(BROWN, spline=Spline(grid, knots))
    if not held_by_ros:
        with pytest.raises(DatasetError, match="cannot hold this lens"):
            held(camera, [Model("rational", RATIONAL)], "ROS")
        return
    found = held(camera, [Model("rational", RATIONAL)], "ROS")
    rays = camera.directions(camera.pixel_centres()[::40, ::40])
    off = np.linalg.norm(found.camera.project(rays) - camera.project(rays), axis=-1)
    assert 0 < found.most_px < FURTHEST_PX and off.max() < 1.1 * found.most_px  # the grids differ


@pytest.mark.parametrize("beside", [False, True])
def test_easy_handeye2_reads_the_pose(export, beside):
    """`HandeyeCalibration.msg`: parameters and a geometry_msgs/Transform, filled field by field; no other may be there."""
    found = yaml.full_load(export(calibration(beside=beside), "easy_handeye2").read_text())
    frames = {f"{one}_frame" for one in ("robot_base", "robot_effector", "tracking_base", "tracking_marker")}
    assert set(found) == {"parameters", "transform"} and set(found["transform"]) == {"translation", "rotation"}
    assert set(found["parameters"]) == frames | {"name", "calibration_type", "freehand_robot_movement"}
    assert found["parameters"]["name"] == "arm"  # by which the file is found
    parent = {"eye_in_hand": "robot_effector_frame", "eye_on_base": "robot_base_frame"}[found["parameters"]["calibration_type"]]
    assert found["parameters"][parent] == ("base" if beside else "tool0")
    turn = Rotation.from_quat([found["transform"]["rotation"][axis] for axis in "xyzw"]).as_matrix()
    assert_same_place(pose.rigid(turn, [found["transform"]["translation"][axis] for axis in "xyz"]))


@pytest.mark.parametrize("mount", [MOUNT, UPRIGHT])
def test_yourdfpy_reads_the_urdf(export, mount):
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(export(calibration(mount=mount), "urdf")), load_meshes=False)
    assert robot.base_link == "tool0"
    assert_same_place(robot.get_transform("camera_optical_frame", "tool0"), mount)
    forward = robot.get_transform("camera_link", "camera_optical_frame")[:3, :3]  # REP 103: x forward, y left, z up
    assert np.allclose(forward, np.transpose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), atol=1e-12)


def test_xacro_puts_the_camera_on_any_link(export, tmp_path):
    xacro, yourdfpy = pytest.importorskip("xacro"), pytest.importorskip("yourdfpy")
    path = export(calibration(), "xacro")
    robot = tmp_path / "robot.urdf.xacro"
    robot.write_text(
        f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="{path}"/>'
        '<link name="hand"/><xacro:koala_camera parent="hand"/></robot>'
    )
    expanded = tmp_path / "robot.urdf"
    expanded.write_text(xacro.process_file(str(robot)).toxml())
    found = yourdfpy.URDF.load(str(expanded), load_meshes=False).get_transform("camera_optical_frame", "hand")
    assert_same_place(found)


@pytest.mark.parametrize("beside", [False, True])
def test_a_launch_file_publishes_camera_and_board(export, beside):
    """`static_transform_publisher`: translation, quaternion, parent (frame-id) and child, as options with two hyphens."""
    source = calibration(beside=beside)
    nodes = ElementTree.parse(export(source, "moveit")).getroot().findall("node")
    found = {}
    for node in nodes:
        assert (node.get("pkg"), node.get("exec")) == ("tf2_ros", "static_transform_publisher")
        words = node.get("args").split()
        given = dict(zip(words[::2], words[1::2], strict=True))
        turn = Rotation.from_quat([float(given.pop(f"--q{axis}")) for axis in "xyzw"]).as_matrix()
        place = pose.rigid(turn, [float(given.pop(f"--{axis}")) for axis in "xyz"])
        found[given.pop("--frame-id"), given.pop("--child-frame-id")] = place
        assert not given
    carrier, stand = ("base", "tool0") if beside else ("tool0", "base")
    assert set(found) == {(carrier, "camera_optical_frame"), (stand, "board")}
    assert_same_place(found[carrier, "camera_optical_frame"])
    board = source.flange_from_board if beside else source.base_from_board
    assert np.allclose(found[stand, "board"], board.matrix, atol=1e-12)


@pytest.fixture(scope="module")
def with_recording(recorded):
    frames = Recording.open(recorded[0]).frames
    return calibration(provenance={"recording": str(recorded[0])}), frames


def test_evo_reads_the_trajectory(export, with_recording):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    source, frames = with_recording
    found = file_interface.read_tum_trajectory_file(str(export(source, "tum")))
    assert found.num_poses == len(frames) == 12
    assert np.allclose(found.timestamps, [1e-9 * frame.host_time_ns for frame in frames], rtol=0, atol=1e-9)
    for matrix, frame in zip(found.poses_se3, frames, strict=True):
        assert_same_place(pose.inverse(frame.base_from_flange) @ matrix)


def test_our_own_import_reads_the_table(export, with_recording, tmp_path):
    source, frames = with_recording
    path = export(source, "csv")
    description = tmp_path / "import.yaml"
    description.write_text(
        "format: koala-import\nversion: 1\nimages: '*.png'\nposes: p.csv\nlayout: x y z qw qx qy qz\nboard: charuco\n"
    )
    table = read(path, load_description(description))
    for frame in frames:
        x, y, z, *wxyz = map(float, table[Path(frame.image).name])
        assert_same_place(pose.inverse(frame.base_from_flange) @ pose.from_quaternion(wxyz, [x, y, z]))


def test_errors_of_the_links_are_in_the_trajectory_and_noted_elsewhere(export, with_recording):
    source, _ = with_recording
    errors = LinkErrors(np.full(24, 1e-3), np.full(24, 1e-4))
    bent = replace(source, link_errors=errors)
    assert "errors of the arm's links" in export(bent, "urdf").read_text()
    assert export(bent, "tum").read_text() != export(source, "tum", ".tum").read_text()


@pytest.mark.parametrize("to", sorted(FORMATS))
def test_every_file_says_where_it_is_from(export, with_recording, to):
    assert "Written by Koala from calibration.json" in export(with_recording[0], to).read_text()


@pytest.mark.parametrize(
    ("to", "suffix", "source", "words", "code"),
    [
        ("urfd", ".urdf", calibration(), "did you mean 'urdf'", 2),
        ("urdf", ".yaml", calibration(), "urdf ends with .urdf", 2),
        ("urdf", ".urdf", Calibration(BROWN, {}), "is of the camera alone", 2),
        ("tum", ".txt", Calibration(BROWN, {}), "is of the camera alone", 2),
        ("tum", ".txt", calibration(beside=True), "stands beside the arm", 2),
        ("csv", ".csv", calibration(), "the recording is missing", 2),
    ],
)
def test_misuse_is_one_line(export, tmp_path, to, suffix, source, words, code):
    message = export(source, to, suffix, expect=code)
    assert words in message and len(message.strip().splitlines()) == 1
    assert [one.name for one in tmp_path.iterdir()] == ["calibration.json"]


def test_a_camera_alone_has_the_formats_of_cameras(export):
    for to in ("opencv", "ros", "kalibr"):
        suffix = ".yaml" if to == "opencv" else ".yml"
        path = export(Calibration(MILD, {}), to, suffix)
        assert "camera" in path.read_text() or "cam0" in path.read_text()
        path.unlink()


def test_the_command_says_what_it_wrote(run_inside, tmp_path):
    calibration().save(tmp_path / "c.json")
    result = run_inside(main, "calib", "export", tmp_path / "c.json", "--to", "ros", "--out", tmp_path / "c.yaml", "--json")
    assert json.loads(result.stdout) == {"out": str(tmp_path / "c.yaml"), "format": "ros"}
    again = run_inside(main, "calib", "export", tmp_path / "c.json", "--to", "ros", "--out", tmp_path / "c.yaml")
    assert again.returncode == 2 and "already exists" in again.stderr
