"""Takes a rig along a trajectory and leaves a recording, frame by frame, so that it can be stopped and resumed anywhere."""

import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from capture.planning import Obstacles, PlannedView, connect, plan
from capture.rigs import Rig
from capture.trajectory import Trajectory
from datasets import files, images
from datasets.errors import Misuse
from datasets.recording import IMAGES, TRUTH, Frame, Recording

Advance = Callable[[str], None]


def record(trajectory: Trajectory, rig: Rig, out: Path, *, resume: bool = False, planned: list[PlannedView] | None = None,
           advance: Advance = lambda name: None) -> Recording:  # fmt: skip
    """Take every view of `trajectory` that `out` does not hold yet.

    Each frame counts once its image and its truth are on the disk and its line is written; a kill at any moment costs at
    most the frame that was under way.

    Args:
        trajectory: what to take.
        rig: with what; connected.
        out: the recording. New or empty, unless `resume`.
        resume: go on with the recording in `out`, which must be of the same trajectory and rig.
        planned: the plan, where it has been made already.
        advance: called with the name of each frame that is there, those of before too.

    Raises:
        Misuse: `out` holds something else than this session.
        CaptureError: an error of rig or plan; the arm stands still, `out` can be resumed.
    """
    planned = plan(trajectory, rig.flange_from_camera) if planned is None else planned
    recording = _open(trajectory, rig, Path(out), resume)
    obstacles = Obstacles.of(trajectory, rig.flange_from_camera)
    taken = {frame.name for frame in recording.frames}
    previous: str | None = None  # the view where the arm stands now
    for index, view in enumerate(planned):
        name = view.viewpoint.name
        if name in taken:
            advance(name)
            continue
        follows = index > 0 and previous == planned[index - 1].viewpoint.name
        way = view.way if follows else connect(rig.robot.state().joints, view.joints, obstacles, where=f"view {name}")
        motion = trajectory.motion
        for joints in way:
            rig.robot.move_to(joints, speed=motion.speed, acceleration=motion.acceleration)
        arrived = time.monotonic()
        previous = name
        recording.append(_expose(recording, rig, index, view, arrived, motion.settle_time_s))
        advance(name)
    return recording


def _expose(recording: Recording, rig: Rig, index: int, view: PlannedView, arrived: float, settle_time_s: float) -> Frame:
    """Take the picture of one view from where the arm stands, and put it on the disk."""
    name, split = view.viewpoint.name, view.viewpoint.split
    if rig.witness is not None:
        rig.witness.prepare(index)
    state = rig.robot.state()
    settle_s = settle_time_s + time.monotonic() - arrived
    image = rig.camera.grab()
    path = f"{IMAGES}/{name}.png"
    images.write(recording.path / path, image.pixels)
    if rig.witness is not None:
        rig.witness.keep_truth(recording.path / TRUTH, name, split)
    return Frame(
        index=index, name=name, split=split, image=path, base_from_flange=state.base_from_flange, joints=state.joints,
        robot_time_s=state.robot_time_s, host_time_ns=image.host_time_ns, device_ticks=image.device_ticks,
        exposure_us=image.exposure_us, settle_s=settle_s, sha256=files.sha256(recording.path / path),
    )  # fmt: skip


def _open(trajectory: Trajectory, rig: Rig, out: Path, resume: bool) -> Recording:
    manifest = _manifest(trajectory, rig)
    if not resume or not out.exists():
        return Recording.create(out, manifest)
    recording = Recording.open(out)
    for key in ("trajectory", "rig", "scene", "seed"):
        if _comparable(recording.manifest.get(key)) != _comparable(manifest.get(key)):
            raise Misuse(f"was taken with another {key.replace('_', ' ')}", where=out, why="a recording has one session",
                         remedy="resume with what it was started with, or choose another --out")  # fmt: skip
    return recording


def _manifest(trajectory: Trajectory, rig: Rig) -> dict[str, Any]:
    """Everything that `calib` and `datasets build` need to know beside the frames."""
    camera, volume = rig.camera.description(), trajectory.object
    return {
        "name": trajectory.name, "software": f"koala-capture {version('koala-capture')}", "scene": None, "seed": None, **rig.extra,
        "trajectory": trajectory.model_dump(mode="json"), "rig": {"name": rig.name, **rig.description.model_dump(mode="json")},
        "camera": camera, "robot": rig.robot.description(),
        "nominal_flange_from_camera": rig.flange_from_camera.tolist(),
        "board": _board(trajectory), "object": None if volume is None else
        {"centre": list(volume.centre), "size": list(volume.size), "box": volume.corners.tolist()},
    }  # fmt: skip


def _board(trajectory: Trajectory) -> dict[str, Any] | None:
    if trajectory.target is None:
        return None
    described = trajectory.target.model_dump(mode="json")
    return {"type": described.pop("kind"), **described}


def _comparable(value: Any) -> Any:
    """As it reads after a round trip through JSON."""
    import json

    return json.loads(json.dumps(value, default=lambda array: np.asarray(array).tolist()))
