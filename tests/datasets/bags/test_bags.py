"""What is read of a bag: encodings of pictures, frames, URDF, clocks; and what is refused."""

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from koala3d.datasets import kinematics, pose
from koala3d.datasets.bags import choosing, reading
from koala3d.datasets.bags.pictures import CameraInfo
from koala3d.datasets.bags.recorded import recording_of
from koala3d.datasets.bags.urdf import tree_of
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import MOVING, Recording
from koala3d.datasets.track import Track, exponential, logarithm
from tests import bags
from tests.fuzz import bombs

SIZE = 48, 64
TIMES = np.arange(0.0, 4.0, 0.02)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KOALA_CACHE", str(tmp_path / "cache"))


def way(times: np.ndarray) -> np.ndarray:
    """(n, 4, 4) poses of a flange that never halts."""
    twist = np.stack(
        [0.3 * np.sin(times), 0.2 * times, 0.1 * np.cos(times), 0.4 * times, 0.3 * np.sin(2 * times), 0.1 * times], 1
    )
    return exponential(twist)


def colours() -> np.ndarray:
    """(height, width, 3) smooth picture whose channels differ."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([3 * x + 20, 4 * y + 10, 200 - 2 * x - y], -1).astype(np.uint8)


def mosaic(picture: np.ndarray, pattern: str) -> np.ndarray:
    """(height, width) values of the sensor behind a colour filter; `pattern` is that of the upper left four pixels by rows."""
    found = np.zeros(picture.shape[:2], picture.dtype)
    for k, colour in enumerate(pattern):
        found[k // 2 :: 2, k % 2 :: 2] = picture[k // 2 :: 2, k % 2 :: 2, "rgb".index(colour)]
    return found


def stored(path: Path, **pictures) -> Recording:
    """The recording of a bag with the same picture, as it lies in the messages, every half second."""
    with bags.writing(path, pictures.pop("kind", "sqlite")) as bag:
        for t, one in zip(TIMES, way(TIMES), strict=True):
            bag.transform("/tf", bags.START_NS + round(1e9 * t), "base_link", "tool0", one)
        for t in np.arange(0.5, 3.6, 0.5):
            stamp = bags.START_NS + round(1e9 * t)
            if "data" in pictures:
                bag.compressed("/camera/image_raw/compressed", stamp, pictures["data"], pictures["format"])
            else:
                bag.picture("/camera/image_raw", stamp, pictures["picture"], pictures["encoding"])
    return Recording.open(recording_of(path))


@pytest.mark.parametrize("kind", bags.KINDS)
@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "mono8", "mono16", "rgb16"])
def test_plain_pictures_are_kept_to_the_bit(tmp_path, kind, encoding) -> None:
    wide, grey = encoding.endswith("16"), encoding.startswith("mono")
    wanted = colours()[..., :1] if grey else colours()
    wanted = wanted.astype(np.uint16) * 257 if wide else wanted
    if "a8" in encoding:
        wanted = np.dstack([wanted, np.full(SIZE, 255, np.uint8)])
    lies = wanted[..., [2, 1, 0, 3][: wanted.shape[-1]]] if encoding.startswith("bgr") else wanted
    name = "bag.bag" if kind == "ros1" else "bag"
    recording = stored(tmp_path / name, kind=kind, picture=lies, encoding=encoding)
    assert len(recording.frames) == 7
    assert np.array_equal(images.read_stored(recording.image_path(recording.frames[3])), wanted)
    assert np.allclose(recording.frames[3].base_from_flange, way(np.array([2.0]))[0], atol=1e-12)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_mosaics_are_developed_in_the_right_colours(tmp_path, pattern, bits) -> None:
    truth = colours() if bits == 8 else colours().astype(np.uint16) * 257
    recording = stored(tmp_path / "bag", picture=mosaic(truth, pattern)[..., None], encoding=f"bayer_{pattern}{bits}")
    found = images.read(recording.image_path(recording.frames[0]))
    inner = (slice(2, -2), slice(2, -2))
    assert np.abs(found[inner] - colours()[inner] / 255).max() < 2.5 / 255  # linear picture: interpolated exactly, then rounded


def test_compressed_pictures_are_kept_as_they_are(tmp_path) -> None:
    data = bags.jpeg(colours())
    recording = stored(tmp_path / "bag", data=data, format="rgb8; jpeg compressed bgr8")
    path = recording.image_path(recording.frames[0])
    assert path.suffix == ".jpg" and path.read_bytes() == data
    assert np.abs(images.read(path) - colours() / 255).mean() < 0.02


def test_a_compressed_mosaic_is_developed(tmp_path) -> None:
    data = cv2.imencode(".png", mosaic(colours(), "grbg"))[1].tobytes()
    recording = stored(tmp_path / "bag", data=data, format="bayer_grbg8; png compressed ")
    found = images.read(recording.image_path(recording.frames[0]))[2:-2, 2:-2]
    assert np.abs(found - colours()[2:-2, 2:-2] / 255).max() < 2.5 / 255


def test_an_unknown_encoding_is_named(tmp_path) -> None:
    with pytest.raises(DatasetError, match=r"picture 0 of /camera/image_raw: .*unknown encoding \(encoding 'rgba32'"):
        stored(tmp_path / "bag", picture=colours(), encoding="rgba32")


def test_screws_are_interpolated_exactly() -> None:
    twist, start = np.array([[0.3, -0.2, 0.5, 0.4, 1.1, -0.7]]), pose.from_rotation_vector([1.0, 0.2, 0.1], [0.1, 0.2, 0.3])
    track = Track(np.array([0, 10**9]), np.stack([start, start @ exponential(twist)[0]]))
    for share in (0.0, 0.25, 0.9, 1.0):
        assert np.allclose(track.at([share])[0], start @ exponential(share * twist)[0], atol=1e-14)
    assert np.allclose(track.speed([0.5])[0], twist[0], atol=1e-12)
    assert np.allclose(logarithm(exponential(twist)), twist, atol=1e-14)
    assert track.gap([0.5, 1.5]).tolist() == [1.0, np.inf]


URDF = """<robot name="arm"><link name="base_link"/>
  <joint name="one" type="revolute"><parent link="base_link"/><child link="a"/>
    <origin xyz="0 0 0.2" rpy="0 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="two" type="continuous"><parent link="a"/><child link="b"/>
    <origin xyz="0.1 0 0" rpy="1.5708 0 0.3"/><axis xyz="0 1 0"/></joint>
  <joint name="three" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 0 2"/></joint>
  <joint name="end" type="fixed"><parent link="c"/><child link="tool0"/><origin xyz="0 0 0.05"/></joint>
</robot>"""


def by_urdf(one: float, two: float, three: float) -> np.ndarray:
    """The flange of `URDF`, written out by hand."""
    first = pose.from_rotation_vector([0, 0, one], [0, 0, 0.2])
    turned = pose.from_rotation_vector([0, 0, 0.3], [0.1, 0, 0]) @ pose.from_rotation_vector([1.5708, 0, 0])
    return (
        first
        @ turned
        @ pose.from_rotation_vector([0, two, 0], [0, 0, 0])
        @ pose.from_rotation_vector([0, 0, 0], [0, 0, three + 0.05])
    )


@pytest.mark.parametrize("beside", [False, True])
def test_poses_follow_from_joint_angles_and_a_urdf(tmp_path, beside) -> None:
    with bags.writing(tmp_path / "bag", "mcap") as bag:
        if not beside:
            bag.write("/robot_description", bags.START_NS, bag.message("std_msgs/String", data=URDF))
        for t in TIMES:
            bag.joints(bags.START_NS + round(1e9 * t), ["three", "one", "two"], [0.1 * t, 0.3 * t, -0.2 * t])
        for t in np.arange(0.5, 3.6, 0.5):
            bag.picture("/image", bags.START_NS + round(1e9 * (t + 0.007)), colours(), "rgb8")
    if beside:
        (tmp_path / "bag" / "arm.urdf").write_text(URDF)
    recording = Recording.open(recording_of(tmp_path / "bag"))
    for frame, t in zip(recording.frames, np.arange(0.5, 3.6, 0.5), strict=True):
        wanted = by_urdf(0.3 * (t + 0.007), -0.2 * (t + 0.007), 0.1 * (t + 0.007))
        assert np.allclose(frame.base_from_flange, wanted, atol=2e-6)  # joints turn evenly, the flange between reports as a screw
    assert recording.manifest["bag"]["flange"] == "tool0" and recording.manifest["bag"]["base"] == "base_link"


def test_a_urdf_with_entities_is_refused() -> None:
    with pytest.raises(DatasetError, match="it declares entities"):
        tree_of('<!DOCTYPE robot [<!ENTITY a "b">]><robot/>', [], where="arm.urdf")


def test_the_shipped_arm_moves_as_its_urdf_says() -> None:
    """Frames of a chain of many joints are those of the arm's own kinematics."""
    frames = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="x{k}"/><axis xyz="0 0 1"/></joint>'
        f'<joint name="f{k}" type="fixed"><parent link="x{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{a} 0 {d}" rpy="{alpha} 0 0"/></joint>'
        for k, (a, d, alpha) in enumerate(zip(kinematics.UR5E.a, kinematics.UR5E.d, kinematics.UR5E.alpha, strict=True))
    )
    angles = np.random.default_rng(0).uniform(-2, 2, (5, 6))

    class State:
        def __init__(self, values):
            self.name, self.position = [f"j{k}" for k in range(6)], values

    tree = tree_of(f"<robot>{frames}</robot>", [(k, State(one)) for k, one in enumerate(angles)], where="arm")
    from koala3d.datasets.bags.frames import track_of

    assert np.allclose(track_of(tree, "l0", "l6", where="arm").poses, kinematics.forward(angles), atol=1e-12)


def test_only_halts_are_views_and_dropped_and_unposed_pictures_are_named(tmp_path) -> None:
    places = way(np.arange(0.0, 4.0, 0.5))
    times, poses = bags.way(places, 1.0, 1.0, 100)
    moments = [t for k, t in enumerate(np.arange(0.0, 17.0, 0.1)) if k not in (33, 34)]
    with bags.writing(tmp_path / "bag.bag", "ros1") as bag:
        for t, one in zip(times, poses, strict=True):
            bag.transform("/tf", bags.START_NS + round(1e9 * t), "base_link", "tool0", one)
        for t in moments:
            bag.picture("/image", bags.START_NS + round(1e9 * t), colours(), "rgb8")
    recording = Recording.open(recording_of(tmp_path / "bag.bag"))
    views = [frame for frame in recording.frames if frame.split != MOVING]
    moving = [frame for frame in recording.frames if frame.split == MOVING]
    assert len(views) == 8 and len(moving) > 20
    assert np.allclose([frame.base_from_flange for frame in views], places, atol=1e-9)
    seconds = np.array([1e-9 * (frame.host_time_ns - bags.START_NS) for frame in views])
    assert np.allclose(seconds, [0.5, 2.5, 4.5, 6.5, 8.5, 10.5, 12.5, 15.0])  # in the middle; the last halt is longer
    said = " ".join(recording.manifest["bag"]["notes"])
    assert "2 pictures are missing after 3.200 s" in said
    assert "10 of 168 pictures have no pose" in said and "16.000" in said


def test_a_camera_that_is_triggered_drops_nothing() -> None:
    stamps = np.cumsum(np.random.default_rng(0).uniform(0.5, 5, 30) * 1e9).astype(np.int64)
    assert choosing.dropped(stamps) == []


def test_the_sharpest_of_neighbours_is_taken(tmp_path) -> None:
    random = np.random.default_rng(0)
    sharp = random.integers(0, 255, (*SIZE, 1), np.uint8)
    soft = cv2.GaussianBlur(sharp, (0, 0), 1.5)[..., None]
    times = np.arange(0.0, 30.0, 0.02)
    with bags.writing(tmp_path / "bag", "mcap") as bag:
        for t, one in zip(times, way(times), strict=True):
            bag.transform("/tf", bags.START_NS + round(1e9 * t), "base_link", "tool0", one)
        for k, t in enumerate(np.arange(0.1, 29.9, 0.05)):
            bag.picture("/image", bags.START_NS + round(1e9 * t), soft if k % 3 else sharp, "mono8")
    recording = Recording.open(recording_of(tmp_path / "bag"))
    found = [np.array_equal(images.read_stored(recording.image_path(frame)), sharp) for frame in recording.frames]
    assert len(found) > 100 and np.mean(found) > 0.9


def test_pictures_on_another_clock_are_refused(tmp_path) -> None:
    with bags.writing(tmp_path / "bag", "mcap") as bag:
        for t, one in zip(TIMES, way(TIMES), strict=True):
            bag.transform("/tf", bags.START_NS + round(1e9 * t), "base_link", "tool0", one)
            bag.picture("/image", bags.START_NS + round(1e9 * (t + 3600)), colours(), "rgb8")
    with pytest.raises(UsageError, match=r"too few pictures have a pose.*200 of 200 pictures.*clocks that agree"):
        recording_of(tmp_path / "bag")


def test_what_a_bag_lacks_is_named(tmp_path) -> None:
    camera = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)
    with bags.writing(tmp_path / "none", "mcap") as bag:
        bag.camera_info("/camera_info", bags.START_NS, camera)
    with pytest.raises(UsageError, match="holds no pictures"):
        recording_of(tmp_path / "none")
    with bags.writing(tmp_path / "two", "mcap") as bag:
        for topic in ("/left/image_raw", "/right/image_raw", "/right/image_raw/compressed", "/depth/image_raw"):
            bag.picture(topic, bags.START_NS, colours(), "rgb8")
    with pytest.raises(UsageError, match=r"several cameras \(/left/image_raw, /right/image_raw.*rosbags-convert"):
        recording_of(tmp_path / "two")
    with bags.writing(tmp_path / "still", "mcap") as bag:
        bag.picture("/image", bags.START_NS, colours(), "rgb8")
        bag.transform("/tf_static", bags.START_NS, "base_link", "tool0", np.eye(4))
    with pytest.raises(UsageError, match="no frame of an arm moves"):
        recording_of(tmp_path / "still")


@pytest.mark.parametrize("kind", bags.KINDS)
def test_a_damaged_bag_is_refused_and_leaves_nothing(tmp_path, kind) -> None:
    home = tmp_path / ("bag.bag" if kind == "ros1" else "bag")
    stored(home, picture=colours(), encoding="rgb8", kind=kind)
    (path,) = [home] if kind == "ros1" else [one for one in home.iterdir() if one.suffix in reading.SUFFIXES]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    with pytest.raises(DatasetError, match="cannot be read"):
        recording_of(home)
    assert len(list((tmp_path / "cache" / "bags").iterdir())) == 1  # that of the bag as it was


def test_a_pipe_in_a_bag_is_refused(tmp_path) -> None:
    stored(tmp_path / "bag", picture=colours(), encoding="rgb8")
    path = tmp_path / "bag" / "bag.db3"
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(UsageError, match=r"bag\.db3: is not a file \(it is a pipe or a device\)"):
        recording_of(tmp_path / "bag")


def test_a_bag_is_converted_once(tmp_path, monkeypatch) -> None:
    first = stored(tmp_path / "bag", picture=colours(), encoding="rgb8").path
    monkeypatch.setattr(reading, "opened", None)
    assert recording_of(tmp_path / "bag") == first


@pytest.mark.parametrize("model", [("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4)])
def test_a_camera_info_is_the_camera_of_the_binned_region(model) -> None:
    """A point in space lands where OpenCV puts it on the whole sensor, less the region's corner, over the binning."""
    name, count = model
    d = [0.05, -0.02, 0.001, -0.0007, 0.01, 0.02, -0.01, 0.003][:count]
    k = np.array([[500.0, 0, 331.2], [0, 510.0, 236.7], [0, 0, 1]])
    info = CameraInfo(640, 480, name, k.ravel().tolist(), d, (100, 60), (2, 2))
    camera = info.camera(200, 150, where="test")
    point = np.array([[[0.1, -0.07, 0.8]]])
    project = cv2.fisheye.projectPoints if name == "equidistant" else cv2.projectPoints
    whole = project(point, np.zeros(3), np.zeros(3), k, np.array(d))[0].ravel()
    assert np.allclose(camera.project(point[0])[0], (whole + 0.5 - [100, 60]) / 2, atol=1e-6)
    assert CameraInfo.from_json(vars(info), where="test") == info
    assert info.camera(320, 240, where="test") is None, "larger than what is left of the sensor"
    assert replace(info, k=[0.0] * 9).camera(200, 150, where="test") is None, "a driver without a calibration sends zeros"
    assert replace(info, model="spherical").camera(200, 150, where="test") is None
    assert replace(info, offset=(0, 0)).camera(200, 150, where="test") is None, "of another size"


def test_transforms_that_are_no_poses_are_left_out_and_counted(tmp_path) -> None:
    """Drivers send zeros and NaN before they know better."""
    with bags.writing(tmp_path / "bag", "mcap") as bag:
        zero = bag.message("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
        none = bag.message("geometry_msgs/Vector3", x=float("nan"), y=0.0, z=0.0)
        for number, (t, one) in enumerate(zip(TIMES, way(TIMES), strict=True)):
            stamp = bags.START_NS + round(1e9 * t)
            if number % 20 == 7:
                moved = bag.message("geometry_msgs/Transform", translation=none, rotation=zero)
                header = bag.header(stamp, "base_link")
                sent = bag.message("geometry_msgs/TransformStamped", header=header, child_frame_id="tool0", transform=moved)
                bag.write("/tf", stamp, bag.message("tf2_msgs/TFMessage", transforms=[sent]))
            else:
                bag.transform("/tf", stamp, "base_link", "tool0", one)
            if number % 25 == 3:
                bag.picture("/image", stamp, colours(), "rgb8")
    recording = Recording.open(recording_of(tmp_path / "bag"))
    assert recording.manifest["bag"]["notes"] == ["10 transforms of tool0 are no poses and are left out, as tf2 does"]
    assert len(recording.track.times_ns) == len(TIMES) - 10


def test_a_joint_without_a_number_is_named(tmp_path) -> None:
    text = '<robot name="a"><joint name="turn" type="revolute"><parent link="base"/><child link="tool0"/></joint></robot>'
    for values, words in (([0.1, np.nan, 0.3], None), ([np.nan] * 3, "no position of joint 'turn' is a number")):
        states = [(k, SimpleNamespace(name=["turn"], position=[value])) for k, value in enumerate(values)]
        if words is None:
            assert tree_of(text, states, where="test")["tool0"].times_ns.tolist() == [0, 2]
        else:
            with pytest.raises(DatasetError, match=words):
                tree_of(text, states, where="test")


def test_a_clock_that_jumps_is_refused(tmp_path) -> None:
    with bags.writing(tmp_path / "bag", "mcap") as bag:
        bag.transform("/tf", 10**9, "base_link", "tool0", np.eye(4))
        for t, one in zip(TIMES, way(TIMES), strict=True):
            bag.transform("/tf", bags.START_NS + round(1e9 * t), "base_link", "tool0", one)
            bag.picture("/image", bags.START_NS + round(1e9 * t), colours(), "rgb8")
    with pytest.raises(UsageError, match=r"clock of the poses jumped \(they span 2.07e\+04 days\)"):
        recording_of(tmp_path / "bag")


@pytest.mark.parametrize(
    ("pictures", "words"),
    [
        ({"data": b"", "format": "jpeg"}, "the file is empty; its format says 'jpeg'"),
        ({"data": b"BM" + b"\0" * 200, "format": "bmp"}, "it is a BMP"),
        ({"data": bombs.png_header(65000), "format": "png"}, "header"),
        ({"data": bags.jpeg(colours())[:600], "format": "jpeg"}, "cannot be decoded"),
        ({"picture": np.zeros((4, 3, 2), np.uint8), "encoding": "yuv422"}, "cannot be converted"),
    ],
)
def test_pictures_that_are_none_are_refused_in_one_line(tmp_path, pictures, words) -> None:
    with pytest.raises(DatasetError, match=rf"bag, picture \d of /camera/image_raw.*{words}"):
        stored(tmp_path / "bag", **pictures)
