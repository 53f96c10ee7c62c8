"""Moves a rig along a trajectory and writes a recording frame by frame, so that it can be stopped and resumed anywhere."""

import errno
import hashlib
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import CaptureError, ConnectionLapse, MotionError, NotSettled, naming
from koala3d.capture.drivers.events import event
from koala3d.capture.drivers.measurements import Image, Pixels, RobotState
from koala3d.capture.model.trajectory import CameraSettings, Motion, Trajectory
from koala3d.capture.planning import Obstacles, PlannedView, connect, plan
from koala3d.capture.recording.incidents import Incidents
from koala3d.capture.recording.manifest import manifest_of, require_same_session
from koala3d.capture.recording.session_log import wall_time
from koala3d.capture.recording.writer import Advance, TakenView, Writer
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core import arrays, files, locks
from koala3d.datasets.core.budgets import require_room
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.incidents import IGNORED
from koala3d.datasets.radiometry.response import Response
from koala3d.datasets.recording import IMAGES, MANIFEST, RADIOMETRY, TRUTH, Frame, Recording

BYTES = {"rgb8": (3, 3), "bayer8": (3, 3), "bayer12": (6, 2), "mono8": (1, 1), "mono12": (2, 2)}
"""Bytes of a pixel: of the developed picture, and of each exposure beside it."""
FRAME_BYTES = 16_384  # room for the line of a frame, and for what a file takes beyond its pixels
TRUTH_BYTES = 4 * 11  # room per pixel for the maps of a simulated test view: normals, depth, opacity, two parts of the light


def record(
    trajectory: Trajectory,
    rig: Rig,
    out: Path,
    *,
    resume: bool = False,
    planned: list[PlannedView] | None = None,
    advance: Advance = lambda name: None,
) -> Recording:
    """Take every view of `trajectory` that is missing in `out`.

    With several cameras, `out` holds a recording for each, in a folder with the camera's name. All cameras take a view at one
    stop of the arm, with one pose before and after, and a view counts as taken once all have it on the disk.

    Pictures are written while the arm moves on. A frame counts once its image and its truth are on the disk and its line is
    written. A kill at any moment loses only the frames in flight; a fault of the rig loses no exposed frame.

    A view at which the arm does not come to rest is tried twice, then left out. If the connection fails while the arm is safe,
    the session connects again, once, and goes on with a slow move. `Recording.manifest` keeps both.

    Args:
        out: the recording, or the folder of those of several cameras. New or empty, unless `resume`.
        resume: continue the recording in `out`, which must have the same trajectory and rig.
        advance: called from any thread with the name of each finished view, including those of an earlier run.

    Returns:
        The recording, with several cameras that of the first one.

    Raises:
        UsageError: `out` contains something other than this session, or another process records there.
        KoalaError: the disk has no room for the views; nothing has moved.
        CaptureError: an error of the rig or the plan, or a full disk; the arm stands still, and `out` can be resumed. It names
            the camera where there are several.
    """
    planned = plan(trajectory, rig.carrier) if planned is None else planned
    out = Path(out)
    try:
        with locks.beside(out, "recording"):
            return _record(trajectory, rig, _open(trajectory, rig, out, resume, planned), planned, advance)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        remedy = "free some space; the same command with --resume continues"
        raise CaptureError("the disk is full", where=out, why="complete views are kept", remedy=remedy) from error


def _record(
    trajectory: Trajectory, rig: Rig, recordings: list[Recording], planned: list[PlannedView], advance: Advance
) -> Recording:
    obstacles = Obstacles.of(trajectory, rig.carrier)
    taken = _taken(recordings)
    event("recording", views=len(planned), taken=len(taken))
    numbers = {view.name: number for number, view in enumerate(trajectory.viewpoints())}
    visits = _Visits(trajectory, rig, recordings, obstacles, Incidents(recordings, rig))
    previous: str | None = None  # the view at which the arm stands
    with Writer(recordings, advance) as writer:
        for index, view in enumerate(planned):
            name = view.viewpoint.name
            if name in taken:
                advance(name)
                continue
            event("view", name=name)
            follows = index > 0 and previous == planned[index - 1].viewpoint.name
            stays = follows and np.array_equal(view.joints, planned[index - 1].joints)
            shown = visits.taken(view, numbers[name], [] if stays else view.path if follows else None)
            previous = None if shown is None else name
            if shown is not None:
                writer.put(shown)
    return recordings[0]


@dataclass(frozen=True)
class _Visits:
    """Goes to views and takes them."""

    trajectory: Trajectory
    rig: Rig
    recordings: list[Recording]
    obstacles: Obstacles
    incidents: Incidents

    def taken(self, view: PlannedView, number: int, path: list[NDArray[np.float64]] | None) -> TakenView | None:
        """The pictures of a view; None: it is left out.

        After whatever went wrong, `Moves` begins slowly.

        Args:
            path: joint angles on the way [rad], the view's own at the end; None: it is planned from where the arm is.
        """
        name, is_second = view.viewpoint.name, False
        while True:
            try:
                self._go(view, path)
                _turn(self.rig, view)
                return _expose(self.recordings, self.rig, number, view, time.monotonic_ns(), self.trajectory)
            except NotSettled as error:
                if is_second:
                    self.incidents.leave_out(name, error)
                    return None
                is_second = True
            except ConnectionLapse as lapse:
                self.incidents.connect_again(name, lapse)
            path = None

    def _go(self, view: PlannedView, path: list[NDArray[np.float64]] | None) -> None:
        where, rig = f"view {view.viewpoint.name}", self.rig
        if path is None:
            path = connect(rig.robot.state().joints, view.joints, self.obstacles, where=where)
        if path:
            rig.moves.along(rig.robot, path, self.trajectory.motion, self.obstacles, view=where)


def _taken(recordings: Sequence[Recording | None]) -> set[str]:
    """Names of the views that the recordings of all cameras hold; one that is not begun is None."""
    return set.intersection(*({frame.name for frame in recording.frames} if recording else set() for recording in recordings))


def _turn(rig: Rig, view: PlannedView) -> None:
    """Turn the table to the angle of a view, where it has one."""
    if view.viewpoint.turntable is None:
        return
    if rig.turntable is None:  # a plan is refused before
        raise UsageError("the rig has no turntable", where=f"view {view.viewpoint.name}")
    rig.turntable.turn_to(view.viewpoint.turntable)


def _light(rig: Rig, view: PlannedView) -> None:
    """Switch on the lamps of a view, and the others off, where it states them."""
    if view.viewpoint.lamps is None:
        return
    if rig.lamps is None:  # a rig without them is refused before
        raise UsageError("the rig switches no lamps", where=f"view {view.viewpoint.name}")
    rig.lamps.switch(view.viewpoint.lamps)


def _expose(
    recordings: list[Recording], rig: Rig, index: int, view: PlannedView, arrived_ns: int, trajectory: Trajectory
) -> TakenView:
    """Take the pictures of one view with every camera, with the pose before and after them all."""
    name, split, motion = view.viewpoint.name, view.viewpoint.split, trajectory.motion
    _light(rig, view)
    for one in rig.each.values():
        if one.ground_truth is not None:
            one.ground_truth.prepare(index)
    table = None if view.viewpoint.turntable is None else rig.turntable
    state, angle = rig.robot.state(), None if table is None else table.angle()
    pictures: list[list[Image]] = []
    for camera_name, one in rig.each.items():
        with naming(camera_name):
            image = one.camera.grab()
            if motion.settle_difference is not None and not pictures:  # the first camera waits until everything is at rest
                image, state = _still(one, image, motion, name)
            pictures.append([image, *_shorter(one, trajectory.camera, image.exposure_us)])
    after, angle_after = rig.robot.state(newer_than_ns=time.monotonic_ns()), None if table is None else table.angle()
    for recording, one in zip(recordings, rig.each.values(), strict=True):
        if one.ground_truth is not None:
            one.ground_truth.save_truth(recording.path / TRUTH, name, split)
    return [
        (
            Frame(
                index=index,
                name=name,
                split=split,
                image=f"{IMAGES}/{name}.png",
                base_from_flange=state.base_from_flange,
                joints=state.joints,
                robot_time_s=state.robot_time_s,
                host_time_ns=taken[0].host_time_ns,
                device_ticks=taken[0].device_ticks,
                exposure_us=taken[0].exposure_us,
                settle_s=motion.settle_time_s + (taken[0].host_time_ns - arrived_ns) * 1e-9,
                sha256="",  # known once the writer has the file
                base_from_flange_after=after.base_from_flange,
                joints_after=after.joints,
                robot_time_after_s=after.robot_time_s,
                turntable_angle=angle,
                turntable_angle_after=angle_after,
                wall_time=wall_time(taken[0].host_time_ns),
                joint_temperatures=state.joint_temperatures,
                lights=rig.description.lights_at(trajectory.lights, view.viewpoint.lamps),
            ),
            taken,
        )
        for taken in pictures
    ]


def _shorter(rig: Rig, camera: CameraSettings, first_us: float) -> list[Image]:
    """The shorter exposures of a bracket, longest first; none without one."""
    taken = []
    for exposure_us in camera.shorter_us(first_us):
        rig.camera.set_exposure(exposure_us)
        taken.append(rig.camera.grab())
    if taken:
        rig.camera.set_exposure(first_us)
    return taken


def _still(rig: Rig, image: Image, motion: Motion, name: str) -> tuple[Image, RobotState]:
    """The first picture that equals the previous one, and the arm's state before it: nothing moves, whatever encoders report.

    Raises MotionError: the pictures still differ after the settling timeout.
    """
    deadline = time.monotonic() + motion.settle_timeout_s
    while True:
        state = rig.robot.state()
        before, image = image, rig.camera.grab()
        difference = picture_difference(before.pixels, image.pixels)
        if difference < (motion.settle_difference or 0.0):
            return image, state
        if time.monotonic() > deadline:
            why = f"two in a row differ by {difference:.4f}, limit {motion.settle_difference:g}"
            remedy = "look for something that moves or flickers, or raise motion.settle_difference"
            raise MotionError("the picture does not come to rest", where=f"view {name}", why=why, remedy=remedy)


def picture_difference(first: Pixels, second: Pixels) -> float:
    """Root mean square difference of two pictures, as a share of white."""
    white = float(np.iinfo(first.dtype).max)
    return float(np.sqrt(np.mean((first.astype(np.float32) - second.astype(np.float32)) ** 2))) / white


def _open(trajectory: Trajectory, rig: Rig, out: Path, resume: bool, planned: list[PlannedView]) -> list[Recording]:
    """The recordings to write, new or resumed, on a disk with room for every view that is missing in one of them."""
    if not resume:
        files.refuse_existing(out)
    if rig.cameras and (out / MANIFEST).exists():
        remedy = "resume with the original arguments, or choose another --out"
        raise UsageError("is the recording of one camera", where=out, why=f"the rig has {len(rig.cameras)}", remedy=remedy)
    old = {name: _resumed(trajectory, one, out / name) if resume else None for name, one in rig.each.items()}
    taken = _taken(list(old.values()))
    missing = [view.viewpoint.split for view in planned if view.viewpoint.name not in taken]
    require_room(out, sum(_size(trajectory, missing, one) for one in rig.each.values()), "the pictures")
    return [old[name] or _created(out / name, manifest_of(trajectory, one), one) for name, one in rig.each.items()]


def _resumed(trajectory: Trajectory, rig: Rig, out: Path) -> Recording | None:
    """A camera's recording as an earlier run left it, without frames whose images are missing; None where it is not begun."""
    _sweep(out)
    if not out.exists():
        return None
    old = Recording.open(out)
    require_same_session(old, trajectory, rig)
    lost = [frame.name for frame in old.frames if not old.image_path(frame).is_file()]
    if len(lost) == len(old.frames) > 1:
        remedy = f"bring {IMAGES} back (an unmounted disk?), or choose another --out"
        raise UsageError("all its images are missing", where=out, why=f"{len(lost)} views", remedy=remedy)
    old.discard(lost)
    if not (ignored := rig.extra.get(IGNORED, {})).items() <= old.part(IGNORED).items():
        old.manifest[IGNORED] = {**old.part(IGNORED), **ignored}
        files.write_json(out / MANIFEST, old.manifest)
    return old


def _created(out: Path, manifest: dict[str, Any], rig: Rig) -> Recording:
    """A new recording with a copy of the measured response of the rig's camera. Raises UsageError: it is another camera's."""
    source = rig.description.camera.radiometry
    if not source:
        return Recording.create(out, manifest)
    Response.load(Path(source)).of_camera(manifest["camera"], where=source)
    data = files.read_regular(Path(source), arrays.MAX_BYTES)
    recording = Recording.create(out, {**manifest, "radiometry": {"file": source, "sha256": hashlib.sha256(data).hexdigest()}})
    files.write_bytes(out / RADIOMETRY, data)
    return recording


def _size(trajectory: Trajectory, splits: list[str], rig: Rig) -> int:
    """Largest number of bytes that pictures take, with depth where the camera measures it, and in a simulation with truth."""
    camera, depth = trajectory.camera, rig.description.camera.depth
    developed, read = BYTES[camera.pixel_format]
    beside = camera.brackets if camera.keeps_raw else camera.brackets - 1  # else the image is the first exposure
    picture = camera.width * camera.height * (developed + read * beside) + FRAME_BYTES
    picture += 0 if depth is None else 2 * depth.width * depth.height
    maps = 0 if rig.ground_truth is None else camera.width * camera.height * TRUTH_BYTES
    return len(splits) * picture + splits.count("test") * maps


def _sweep(out: Path) -> None:
    """Remove the incomplete files that a kill left: temporary files, and a folder without manifest and pictures."""
    if not out.is_dir():
        return
    names = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    if MANIFEST not in names and not names <= {IMAGES}:
        return  # not a recording: `Recording.open` reports it
    for path in [path for path in out.rglob(".*.*") if path.is_file()]:
        path.unlink()
    if MANIFEST not in names and not any((out / IMAGES).glob("*")):
        shutil.rmtree(out)
