"""What is written so that a crash must not harm it: a recording, a calibration, a scene, the checkpoints of a training.

Each artefact has `make`, which writes it into a folder and reports what is done; `repeat`, what a person does after a
crash; `result`, which must equal that of an undisturbed run; and `kept`, the reported parts present before the repetition.

    python artefacts.py NAME SOURCES FOLDER MARKS
"""

import json
import shutil
import sys
import time
from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from unittest import mock

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.building.build import build
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording

Report = Callable[[str], None]
CAMERA = Camera(16, 12, 20.0, 20.0, 8.0, 6.0)
STEPS, EVERY = 4, 2


@dataclass(frozen=True)
class Artefact:
    """See the module."""

    make: Callable[[Path, Path, Report], None]
    """Sources, folder, report."""
    repeat: Callable[[Path, Path], None]
    result: Callable[[Path], Any]
    kept: Callable[[Path], set[str]]


# -- a recording of three frames, with stand-ins for arm and camera

THREE = ["views.0.count=3", "views.0.rings=1", "split.train=2", "split.test=1"]
_planned: list[Any] = []
"""The views; planning takes longer than everything else."""


class Rigged:
    """An arm and a camera in one; its pictures follow from where it stands."""

    def __init__(self) -> None:
        from koala3d.capture.model.arm import load_arm

        self.joints = load_arm("ur5e").home.copy()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def move_to(self, joints: np.ndarray, *, speed: float, acceleration: float) -> None:
        self.joints = np.array(joints)

    def state(self, *, newer_than_ns: int = 0) -> Any:
        from koala3d.capture.drivers.protocols import RobotState
        from koala3d.capture.model import kinematics

        return RobotState(kinematics.forward(self.joints), self.joints.copy(), np.zeros(6), time.monotonic(), time.monotonic_ns())

    def stop(self) -> None: ...

    def grab(self) -> Any:
        from koala3d.capture.drivers.protocols import Image

        seed = int(abs(self.joints).sum() * 1e6)
        return Image(
            np.random.default_rng(seed).integers(0, 255, (6, 8, 3)).astype(np.uint8), 2000.0, 0.0, 0, time.monotonic_ns()
        )

    def description(self) -> dict[str, Any]:
        return {"model": "stand-in"}


def _record(sources: Path, folder: Path, report: Report = lambda name: None) -> None:
    from koala3d.capture.model.rig import RigDescription
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.planning import plan
    from koala3d.capture.recording.recorder import record
    from koala3d.capture.rig.rig import Rig

    trajectory = load_trajectory("koala_demo", overrides=THREE)
    both = Rigged()
    rig = Rig(both, both, RigDescription(), "lab", None, {})
    if not _planned:
        _planned.extend(plan(trajectory, rig.carrier))
    record(trajectory, rig, folder / "recording", planned=_planned, resume=True, advance=report)


def _recorded(folder: Path) -> Any:
    recording = Recording.open(folder / "recording")
    assert all(files.sha256(recording.image_path(frame)) == frame.sha256 for frame in recording.frames)
    manifest = {key: value for key, value in recording.manifest.items() if key != "started"}
    return [(frame.name, frame.sha256, frame.joints.tolist()) for frame in recording.frames], manifest


def _frames_kept(folder: Path) -> set[str]:
    return (
        {frame.name for frame in Recording.open(folder / "recording").frames}
        if (folder / "recording" / "manifest.json").exists()
        else set()
    )


# -- a calibration over an older one


def _calibration(focal: float) -> Calibration:
    known = UncertainPose(pose.from_rotation_vector([0.1, 0.2, 0.3], [0.0, 0.06, 0.08]), 1e-8 * np.eye(6))
    return Calibration(Camera(16, 12, focal, focal, 8.0, 6.0), {"fx": 0.1}, known, known)


def _calibrate(sources: Path, folder: Path, report: Report = lambda name: None) -> None:
    for name, focal in (("older", 20.0), ("newer", 21.0)):
        _calibration(focal).save(folder / "calibration.json")
        report(name)


def _calibrated(folder: Path) -> Any:
    return json.loads((folder / "calibration.json").read_text())


def _calibrations_kept(folder: Path) -> set[str]:
    if not (folder / "calibration.json").exists():
        return set()
    return {20.0: {"older"}, 21.0: {"older", "newer"}}[Calibration.load(folder / "calibration.json").camera.fx]


# -- a scene of four views


def sources_of_scene(folder: Path) -> None:
    """The recording and the calibration that a scene is built from."""
    volume = {"centre": [0.0, 0.0, 0.0], "size": [0.1, 0.1, 0.1]}
    recording = Recording.create(folder / "recording", {"trajectory": {}, "object": volume})
    for number in range(4):
        path = recording.path / "images" / f"{number}.png"
        images.write(path, np.random.default_rng(number).integers(0, 255, (12, 16, 3)).astype(np.uint8))
        matrix = pose.look_at((np.cos(number), np.sin(number), 0.5), (0, 0, 0))
        recording.append(
            Frame(
                index=number,
                name=f"{number}",
                split="train",
                image=f"images/{number}.png",
                base_from_flange=matrix,
                joints=np.zeros(6),
                robot_time_s=0.0,
                host_time_ns=0,
                device_ticks=0,
                exposure_us=1e4,
                settle_s=0.1,
                sha256=files.sha256(path),
            )
        )
    known = UncertainPose(np.eye(4), 1e-8 * np.eye(6))
    Calibration(CAMERA, {}, known, known).save(folder / "calibration.json")


def _build(sources: Path, folder: Path, report: Report = lambda name: None) -> None:
    build(sources / "recording", sources / "calibration.json", folder / "scene", sizes=(2,))
    report("scene")


def _build_by_copy(sources: Path, folder: Path, report: Report = lambda name: None) -> None:
    """Where recording and scene are on two disks, files are copied instead of linked."""
    with mock.patch("os.link", side_effect=OSError("another disk")):
        _build(sources, folder, report)


def _build_again(sources: Path, folder: Path) -> None:
    """A person builds it where it is not there; where it is, it is used."""
    if not (folder / "scene").exists():
        _build(sources, folder)


def _built(folder: Path) -> Any:
    scene = load_scene(folder / "scene")
    pictures = [view.read().tobytes() for view in scene.views]
    smaller = [images.read(path).tobytes() for path in sorted((folder / "scene" / "images_2").iterdir())]
    return (
        [view.name for view in scene.views],
        pictures,
        smaller,
        scene.box.tolist(),
        scene.near,
        scene.provenance["frames_sha256"],
    )


def _scenes_kept(folder: Path) -> set[str]:
    return {"scene"} if (folder / "scene").exists() and _built(folder) else set()


# -- a training of four steps, checkpointed after every second one

State = namedtuple("State", ["step", "weights"])


def _run_of(folder: Path) -> Any:
    from koala3d.reconstruct.config import Config
    from koala3d.reconstruct.run import Run
    from koala3d.reconstruct.scene.facts import SceneFacts
    from koala3d.reconstruct.scene.rays import Normalisation

    if (folder / "run" / "run.json").exists():
        return Run.open(folder / "run")
    shutil.rmtree(folder / "run", ignore_errors=True)
    return Run.create(folder / "run", Config(), folder, SceneFacts(Normalisation((0.0, 0.0, 0.0), 1.0, True, 0.1, 2.0)), {})


def _train(sources: Path, folder: Path, report: Report = lambda name: None) -> None:
    """As `reconstruct.training.loop` does it, with steps that cost nothing; `--resume` where there is a checkpoint."""
    from koala3d.reconstruct import checkpoint

    run = _run_of(folder)
    state = State(np.int32(0), np.arange(300, dtype=np.float32))
    if checkpoint.steps(run.path / "checkpoints"):
        state, _ = checkpoint.load(run.path / "checkpoints", state)
        state = State(np.int32(state.step), np.asarray(state.weights))
    while state.step < STEPS:
        state = State(np.int32(state.step + 1), np.sin(state.weights) + np.float32(state.step))
        run.append_log({"step": int(state.step)})
        if state.step % EVERY == 0:
            checkpoint.save(run.path / "checkpoints", state, {"seconds": float(state.step)})
            report(f"{int(state.step)}")


def _trained(folder: Path) -> Any:
    from koala3d.reconstruct import checkpoint
    from koala3d.reconstruct.run import Run

    run = Run.open(folder / "run")
    state, clock = checkpoint.load(run.path / "checkpoints", State(np.int32(0), np.zeros(300, np.float32)))
    assert run.log()[-1] == {"step": STEPS}
    return int(state.step), np.asarray(state.weights).tobytes(), clock


def _checkpoints_kept(folder: Path) -> set[str]:
    from koala3d.reconstruct import checkpoint

    if not checkpoint.steps(folder / "run" / "checkpoints"):
        return set()
    try:
        state, _ = checkpoint.load(folder / "run" / "checkpoints", State(np.int32(0), np.zeros(300, np.float32)))
    except (KoalaError, ValueError, KeyError, OSError):
        return set()
    return {f"{step}" for step in range(EVERY, int(state.step) + 1, EVERY)}


ARTEFACTS = {
    "recording": Artefact(_record, _record, _recorded, _frames_kept),
    "calibration": Artefact(_calibrate, _calibrate, _calibrated, _calibrations_kept),
    "scene": Artefact(_build, _build_again, _built, _scenes_kept),
    "copied scene": Artefact(_build_by_copy, _build_again, _built, _scenes_kept),
    "checkpoints": Artefact(_train, _train, _trained, _checkpoints_kept),
}


def main(name: str, sources: Path, folder: Path, marks: Path) -> None:
    """Write an artefact, as a program that strace watches."""
    ARTEFACTS[name].make(sources, folder, lambda done: (marks / done).mkdir())


if __name__ == "__main__":
    main(sys.argv[1], *map(Path, sys.argv[2:5]))
