"""Takes a rig along a trajectory and leaves a recording, frame by frame, so that it can be stopped and resumed anywhere."""

import shutil
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from capture.errors import MotionError
from capture.planning import Obstacles, PlannedView, connect, plan
from capture.recording.writer import Advance, Pixels, Writer
from capture.rig.description import RigDescription
from capture.rig.opening import Rig
from capture.rig.protocols import Image
from capture.trajectory import Motion, Trajectory
from datasets.core.errors import UsageError
from datasets.recording import IMAGES, MANIFEST, TRUTH, Frame, Recording


def record(trajectory: Trajectory, rig: Rig, out: Path, *, resume: bool = False, planned: list[PlannedView] | None = None,
           advance: Advance = lambda name: None) -> Recording:  # fmt: skip
    """Take every view of `trajectory` that `out` does not hold yet.

    Pictures go to the disk while the arm moves on. Each frame counts once its image and its truth are on the disk and its
    line is written; a kill at any moment costs at most the frames that were under way, and a fault of the rig costs none
    that was exposed.

    Args:
        trajectory: what to take.
        rig: with what; connected.
        out: the recording. New or empty, unless `resume`.
        resume: go on with the recording in `out`, which must be of the same trajectory and rig.
        planned: the plan, where it has been made already.
        advance: called with the name of each frame that is there, those of before too; from any thread.

    Raises:
        UsageError: `out` holds something else than this session.
        CaptureError: an error of rig or plan; the arm stands still, `out` can be resumed.
    """
    planned = plan(trajectory, rig.flange_from_camera) if planned is None else planned
    recording = _open(trajectory, rig, Path(out), resume)
    obstacles = Obstacles.of(trajectory, rig.flange_from_camera)
    taken = {frame.name for frame in recording.frames}
    numbers = {view.name: number for number, view in enumerate(trajectory.viewpoints())}
    motion = trajectory.motion
    previous: str | None = None  # the view where the arm stands now
    with Writer(recording, advance) as writer:
        for index, view in enumerate(planned):
            name = view.viewpoint.name
            if name in taken:
                advance(name)
                continue
            follows = index > 0 and previous == planned[index - 1].viewpoint.name
            way = view.way if follows else connect(rig.robot.state().joints, view.joints, obstacles, where=f"view {name}")
            for joints in way:
                rig.robot.move_to(joints, speed=motion.speed, acceleration=motion.acceleration)
            arrived_ns = time.monotonic_ns()
            previous = name
            frame, pixels = _expose(recording, rig, numbers[name], view, arrived_ns, motion)
            writer.put(frame, pixels)
    return recording


def _expose(
    recording: Recording, rig: Rig, index: int, view: PlannedView, arrived_ns: int, motion: Motion
) -> tuple[Frame, Pixels]:
    """Take the picture of one view from where the arm stands; the frame still lacks the hash of its file."""
    name, split = view.viewpoint.name, view.viewpoint.split
    if rig.witness is not None:
        rig.witness.prepare(index)
    state = rig.robot.state()
    image = rig.camera.grab()
    if motion.settle_difference is not None:
        image = _still(rig, image, motion, name)
        state = rig.robot.state()
    settle_s = motion.settle_time_s + (image.host_time_ns - arrived_ns) * 1e-9
    if rig.witness is not None:
        rig.witness.keep_truth(recording.path / TRUTH, name, split)
    frame = Frame(
        index=index, name=name, split=split, image=f"{IMAGES}/{name}.png", base_from_flange=state.base_from_flange,
        joints=state.joints, robot_time_s=state.robot_time_s, host_time_ns=image.host_time_ns, device_ticks=image.device_ticks,
        exposure_us=image.exposure_us, settle_s=settle_s, sha256="",
    )  # fmt: skip
    return frame, image.pixels


def _still(rig: Rig, image: Image, motion: Motion, name: str) -> Image:
    """The first picture that shows the same as the one before it: nothing moves any more, whatever the encoders say.

    Raises:
        MotionError: that did not happen within the time that the arm has to settle.
    """
    deadline = time.monotonic() + motion.settle_timeout_s
    while True:
        before, image = image, rig.camera.grab()
        difference = picture_difference(before.pixels, image.pixels)
        if difference < (motion.settle_difference or 0.0):
            return image
        if time.monotonic() > deadline:
            raise MotionError("the picture does not come to rest", where=f"view {name}",
                              why=f"two in a row differ by {difference:.4f}, limit {motion.settle_difference:g}",
                              remedy="look for what moves or flickers, or raise motion.settle_difference")  # fmt: skip


def picture_difference(first: Pixels, second: Pixels) -> float:
    """Root mean square of the difference of two pictures, as a share of white."""
    white = float(np.iinfo(first.dtype).max)
    return float(np.sqrt(np.mean((first.astype(np.float32) - second.astype(np.float32)) ** 2))) / white


def _open(trajectory: Trajectory, rig: Rig, out: Path, resume: bool) -> Recording:
    manifest = _manifest(trajectory, rig)
    if resume:
        _sweep(out)
    if not resume or not out.exists():
        return Recording.create(out, manifest)
    recording = Recording.open(out)
    kept = _identity(recording.manifest)
    for key, value in _identity(_comparable(manifest)).items():
        if kept[key] != value:
            raise UsageError(f"was taken with another {key.replace('_', ' ')}", where=out, why="a recording has one session",
                         remedy="resume with what it was started with, or choose another --out")  # fmt: skip
    return recording


def _sweep(out: Path) -> None:
    """Remove what a kill left half-written: files under a temporary name, and a folder without a manifest and pictures."""
    if not out.is_dir():
        return
    names = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    if MANIFEST not in names and not names <= {IMAGES}:
        return  # something else than a recording: `Recording.open` says so
    for path in [path for path in out.rglob(".*.*") if path.is_file()]:
        path.unlink()
    if MANIFEST not in names and not any((out / IMAGES).glob("*")):
        shutil.rmtree(out)


def _identity(manifest: dict[str, Any]) -> dict[str, Any]:
    """What must be the same when a recording goes on; where the controller is on the network, and defaults that did not
    exist yet when it was begun, do not matter."""
    description = RigDescription.model_validate({key: value for key, value in manifest["rig"].items() if key != "name"})
    anywhere = description.robot.model_copy(update={"host": "anywhere"})
    return {
        "trajectory": Trajectory.model_validate(manifest["trajectory"]),
        "rig": description.model_copy(update={"robot": anywhere, "simulation": None}),
        "scene": manifest.get("scene"), "seed": manifest.get("seed"),
    }  # fmt: skip


def _manifest(trajectory: Trajectory, rig: Rig) -> dict[str, Any]:
    """Everything that `calib` and `datasets build` need to know beside the frames."""
    camera, volume = rig.camera.description(), trajectory.object
    return {
        "name": trajectory.name, "software": f"koala-capture {version('koala-capture')}", "scene": None, "seed": None, **rig.extra,
        "trajectory": trajectory.model_dump(mode="json"), "rig": {"name": rig.name, **rig.description.model_dump(mode="json")},
        "camera": camera, "robot": rig.robot.description(),
        "nominal_flange_from_camera": rig.flange_from_camera.tolist(),
        "board": trajectory.target.to_json() if trajectory.target else None, "object": None if volume is None else
        {"centre": list(volume.centre), "size": list(volume.size), "box": volume.corners.tolist()},
    }  # fmt: skip


def _comparable(value: Any) -> Any:
    """As it reads after a round trip through JSON."""
    import json

    return json.loads(json.dumps(value, default=lambda array: np.asarray(array).tolist()))
