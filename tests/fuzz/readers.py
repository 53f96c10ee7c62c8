"""Reads everything that an input holds, as the commands do; what can be read as a scene is written again."""

import random
from pathlib import Path

import numpy as np
from sound import example_state

from koala3d.calib.errors import TargetError
from koala3d.calib.sessions import importer
from koala3d.calib.sessions.description import load_description
from koala3d.capture.model.rig import load_rig
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.recording.check import check as check_recording
from koala3d.datasets.bags.recorded import recording_of
from koala3d.datasets.building.build import build, extra_truth
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.checks.check import check
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.formats import WRITERS, load_scene, ply, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.process.pictures import videos
from koala3d.datasets.recording import Recording
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.output import camera_path
from koala3d.reconstruct.output.mesh import reading
from koala3d.reconstruct.run import Run
from tests.fuzz import captured

SCENES = ("koala", "blender", "nerfstudio", "llff", "dtu", "colmap", "metashape", "realityscan", "bop", "phone")


def layout_of(kind: str) -> str | None:
    """Name of the layout of a kind of scene; None for other kinds."""
    layout = kind.removesuffix("-bare").removesuffix("-text").partition("-")[0]
    return layout if layout in SCENES else None


def read_all(kind: str, folder: Path, out: Path, seed: int) -> None:
    """Read an input completely. Scenes and recordings are written to `out`.

    Raises:
        KoalaError: something is wrong with it, in one line. Anything else that is raised is a fault of Koala.
    """
    layout = layout_of(kind)
    if layout is not None:
        _scene(layout, folder, out, random.Random(seed))
    else:
        READERS[kind](folder, out)


def _scene(layout: str, folder: Path, out: Path, choice: random.Random) -> None:
    problem: KoalaError | None = None
    try:
        scene = load_scene(folder, format=layout)
        _look(scene)
    except KoalaError as error:
        problem = error
    found = check(folder, format=layout, matches=False)
    if problem is not None:
        assert any(finding.level == "error" for finding in found), f"check says nothing of: {problem}"
        raise problem
    save_scene(scene, out, choice.choice(sorted(set(WRITERS) - {"mipnerf360"})), extra=extra_truth(folder))


def _look(scene: Scene) -> None:
    for view in scene.views:
        assert view.read().shape[:2] == (view.camera.height, view.camera.width)
        for channel in view.truth:
            view.read_truth(channel)
    assert np.isfinite(scene.box).all() and scene.near < scene.far
    assert all(np.isfinite(view.world_from_camera).all() for view in scene.views)


def _recording(folder: Path, out: Path) -> None:
    assert Recording.open(folder).frames is not None
    check_recording(folder)
    build(folder, folder / "calibration.json", out)


def _bag(folder: Path, out: Path) -> None:
    recording = Recording.open(recording_of(folder))
    assert recording.track is not None
    for frame in recording.frames:
        images.read(recording.image_path(frame))


def _calibration(folder: Path, out: Path) -> None:
    calibration = Calibration.load(folder / "calibration.json")
    calibration.camera.directions(calibration.camera.pixel_centres()[::4, ::4])
    if calibration.flange_from_camera is not None:
        assert np.isfinite(calibration.camera_pose(np.eye(4), np.zeros(6))).all()
        str(calibration.flange_from_camera.translation_std_mm)
    calibration.save(out / "calibration.json")


def _points(folder: Path, out: Path) -> None:
    for path in sorted(folder.iterdir()):
        assert ply.read_points(path).shape[1] == 3


def _pictures(folder: Path, out: Path) -> None:
    for path in sorted(folder.iterdir()):
        images.metadata(path)
        assert images.size(path) == images.read(path).shape[1::-1]
        images.read_stored(path)


def _session(folder: Path, out: Path) -> None:
    for name in ("import", "by_txt", "by_npy", "by_yaml", "by_json", "by_yml", "by_xml"):
        try:
            importer.import_session(folder, load_description(folder / f"{name}.yaml"))
        except TargetError:
            pass  # a picture this small may not show its board


def _run(folder: Path, out: Path) -> None:
    run = Run.open(folder)
    run.log()
    state, clock = checkpoint.load(run.path / "checkpoints", example_state())
    expected = example_state()
    same = np.array_equal(state.weights, expected.weights) and np.array_equal(state.moments, expected.moments)
    assert same and clock["step"] == int(state.step) in (1, 2), "numbers that nobody has stored"


READERS = {
    "recording": _recording,
    **dict.fromkeys(captured.BAGS, _bag),
    "calibration": _calibration,
    "points": _points,
    "picture": _pictures,
    "trajectory": lambda folder, out: [load_trajectory(path).viewpoints() for path in sorted(folder.iterdir())],
    "rig": lambda folder, out: [load_rig(path) for path in sorted(folder.iterdir())],
    "path": lambda folder, out: camera_path.from_file(folder / "path.yaml"),
    "session": _session,
    "run": _run,
    "video": lambda folder, out: [videos.picture(frame) for path in sorted(folder.iterdir()) for frame in videos.decoded(path)],
    "mesh": lambda folder, out: [reading.read(path) for path in sorted(folder.iterdir())],
}
"""How each kind that is no scene is read."""
