"""From a recording and a calibration to a scene. The world is the robot's base, the unit the metre.

world_from_camera = base_from_flange @ flange_from_camera, with errors of the arm's links corrected where the calibration has them

Where the object turned on a table, the world is the object's frame of `datasets.turntable`: the base at the table's angle zero.
"""

from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.building.clocked import at_exposure, speeds
from koala3d.datasets.building.develop import developing
from koala3d.datasets.building.lamps import lamp_sets, light_of
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import koala
from koala3d.datasets.formats.assemble import CAMERAS_ALONE
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.incidents import left_out
from koala3d.datasets.recording import BAG, DEPTH, MANIFEST, TRUTH, Frame, Recording
from koala3d.datasets.scene import CHANNELS, SPLITS, STATED, Scene, View
from koala3d.datasets.structure import bounds
from koala3d.datasets.structure.measure import measured

SENSOR = "sensor"
"""Folder of a scene for what devices have measured beside the pictures."""
NEAR_SHARE = 0.25
"""Where the images do not show what is nearest, near is this share of the nearest depth of the object's box: the table may be
closer than the object."""
BACKGROUND_STANDS = (
    "the object turned before a background that stood still: give the images masks of the object; near is not measured"
)


def build(
    recording_path: Path,
    calibration_path: Path,
    out: Path,
    *,
    sizes: tuple[int, ...] = (),
    radiometry: Path | None = None,
    white: float | None = None,
    done: Step = ignore,
    lamps: str | None = None,
) -> Scene:
    """Write the Koala scene of a recording to `out`, all or nothing. `done` is called after each frame.

    Args:
        lamps: of a recording under several sets of lamps, the one whose views the scene has: a key of `lamp_sets`.
        sizes: for each N, `images_N` holds the images at 1/N of their size.
        radiometry: file of 'capture flat' to use in place of the recording's own.
        white: of brackets, the light that is read as white, 1 for that of the longest exposure; None: so that 0.1 % of the
            pixels of the brightest view exceed it.

    Raises:
        UsageError: a calibration session, a calibration without a hand-eye pose, an `out` that holds something, or a measured
            response of another camera.
        DatasetError: the object turned on a table whose axis the calibration does not hold.
        DatasetError: an image is missing, damaged, altered or of another size than the calibrated camera's.
    """
    files.refuse_existing(out)
    recording = _under(Recording.open(recording_path), lamps)
    calibration = Calibration.load(calibration_path)
    if calibration.flange_from_camera is None:
        remedy = "run 'calib handeye' on the target's recording"
        raise UsageError("calibration holds no hand-eye pose", where=calibration_path, remedy=remedy)
    frames = [frame for frame in recording.frames if frame.split in SPLITS]
    if not frames:
        why = f"all {len(recording.frames)} frames are of a calibration session" if recording.frames else "it holds no frames"
        remedy = "record a trajectory with an object"
        raise UsageError("recording has no views of an object", where=recording_path, why=why, remedy=remedy)
    frames, clock_notes = at_exposure(recording, frames, calibration)
    camera, notes = camera_for(recording, calibration)
    notes += clock_notes
    notes += incomplete_notes(recording, len(frames)) + depth_notes(frames)
    views, maps, response = [], truth_maps(recording.path), recording.response(radiometry)
    with developing(recording, response, out) as developed:
        placed = calibration.object_poses(frames)
        for frame, world_from_camera, base_from_world in zip(frames, calibration.camera_poses(frames), placed, strict=True):
            view = replace(_view(recording, frame, camera, world_from_camera), base_from_world=base_from_world)
            truth = {channel: found[frame.name] for channel, found in maps.items() if frame.name in found}
            views.append(developed.picture(replace(view, truth=truth), frame))
            done()
        views, notes = [developed.finished(view, white) for view in views], notes + developed.notes
        scene = _scene(recording, calibration, calibration_path, tuple(views), tuple(notes), Path(out).resolve().name)
        scene = replace(scene, provenance=scene.provenance | speeds(recording, frames, calibration))
        koala.save(scene, out, extra=extra_truth(recording.path) | measured_depth(recording, frames), sizes=sizes)
    return koala.load(Path(out)) if developed.is_needed else scene


def build_under_lamps(recording_path: Path, calibration_path: Path, out: Path, **options: Any) -> dict[str, Scene]:
    """The scene of a recording, by the empty name; of one under several sets of lamps one for each, in a folder with its name.

    Arguments and errors as in `build`; nothing that holds something is written to.
    """
    files.refuse_existing(out)
    sets = lamp_sets(Recording.open(recording_path))
    if len(sets) < 2:
        return {"": build(recording_path, calibration_path, out, **options)}
    return {name: build(recording_path, calibration_path, Path(out) / name, lamps=name, **options) for name in sets}


def _under(recording: Recording, lamps: str | None) -> Recording:
    """The recording as if it had only the frames under one set of lamps. Raises UsageError: it has several, and none is named."""
    sets = lamp_sets(recording)
    if lamps is None and len(sets) < 2:
        return recording
    if lamps not in sets:
        why, remedy = f"it was lit by {', '.join(sets)}", "build a scene for each of them"
        raise UsageError("a scene has views under one set of lamps", where=recording.path, why=why, remedy=remedy)
    return replace(recording, frames=[frame for frame in recording.frames if frame.lights == sets[lamps]])


def _scene(
    recording: Recording,
    calibration: Calibration,
    calibration_path: Path,
    views: tuple[View, ...],
    notes: tuple[str, ...],
    name: str,
) -> Scene:
    """The scene of finished views, its bounds measured."""
    box, evidence = object_box(recording, views)
    provenance = {
        "format": koala.FORMAT,
        "recording": recording.part(BAG).get("path") or str(recording.path.absolute()),
        "pose": recording.pose,
        "calibration": str(Path(calibration_path).absolute()),
        "calibration_sha256": files.sha256(calibration_path),
        "manifest_sha256": files.sha256(recording.path / MANIFEST),
        "frames_sha256": {f.name: f.sha256 for f in recording.frames if f.split in SPLITS},
        "radiometry": recording.part("radiometry") or None,
        "flange_from_camera": calibration.flange_from_camera and calibration.flange_from_camera.to_json(),
        "software": {"koala-capture": version("koala-capture")},
    }
    near = NEAR_SHARE * bounds.depth_range(views, box)[0]
    light = light_of(recording)
    scene = Scene(name, views, near, np.inf, box, "scene", True, provenance=provenance, bounds_from=evidence)
    scene = replace(scene, lamps=light.lamps, notes=(*notes, *light.notes))
    if recording.turns:
        return replace(scene, notes=(*scene.notes, BACKGROUND_STANDS))
    return scene if evidence == CAMERAS_ALONE else with_measured_near(scene)  # `load_scene(..., measure=True)` measures all


def with_measured_near(scene: Scene) -> Scene:
    """The scene with near measured in its images, and with the points that were triangulated for that. Where these are too few,
    near stays and a note says so.

    Space nearer than anything visible is empty; a reconstruction that knows this does not fill it with fog.
    """
    found = measured(scene)
    if found.points is None:
        why = found.bounds_from.removeprefix(f"{scene.bounds_from}; ")
        advice = "put something textured beside the object to keep reconstructions free of fog near the cameras"
        return replace(scene, notes=(*scene.notes, f"near is a guess: {why}; {advice}"))
    evidence = f"box {scene.bounds_from}; near from {found.bounds_from}"
    kept: dict[str, Any] = {"points": found.points, "colours": found.colours, "sightings": found.sightings}
    return replace(scene, near=found.near, bounds_from=evidence, **kept)


def camera_for(recording: Recording, calibration: Calibration) -> tuple[Camera, list[str]]:
    """The calibrated camera for this recording's images, and a note where it had to be converted.

    The two sessions may differ in sensor region or binning. Where both record their region, the conversion is exact. Where one of
    them does not, the camera is used as it is, and the note says so.

    Raises:
        DatasetError: the sizes differ and one session does not record its region, or the images have another size.
    """
    actual = images.size(recording.image_path(recording.frames[0]))
    calibrated, notes = calibration.camera, []
    ours, theirs = Region.of_recording(recording.manifest, where=recording.path / MANIFEST), calibration.region
    if ours is not None and theirs is not None:
        if ours != theirs:
            calibrated = theirs.converted(calibrated, ours)
            notes.append(f"intrinsics converted from {_words(theirs)} to {_words(ours)}")
    elif known := ours or theirs:
        silent = "recording" if ours is None else "calibration"
        notes.append(f"{silent} does not state its sensor region; intrinsics are right only if it is {_words(known)}")
    if (calibrated.width, calibrated.height) != actual:
        why = f"images are {actual[0]}x{actual[1]}, the calibrated camera is {calibrated.width}x{calibrated.height}"
        remedy = "calibrate with the same region of interest and binning"
        raise DatasetError("calibration is for another image size", where=recording.path, why=why, remedy=remedy)
    return calibrated, notes


def _words(region: Region) -> str:
    return f"{region.width}x{region.height} at ({region.offset_x}, {region.offset_y}) with binning {region.binning}"


def _view(recording: Recording, frame: Frame, camera: Camera, world_from_camera: NDArray[np.float64]) -> View:
    """One frame as a view; its image must be the one that was recorded."""
    where = f"{recording.path}, frame {frame.name}"
    path = files.inside(recording.path, frame.image, where=where)
    if images.size(path) != (camera.width, camera.height):
        why = "it is {}x{}".format(*images.size(path)) + f", the others are {camera.width}x{camera.height}"
        raise DatasetError("image has the wrong size", where=path, why=why, remedy="record the frame again")
    if frame.sha256 and files.sha256(path) != frame.sha256:
        why, remedy = "its SHA-256 differs from frames.jsonl", "restore it, or record the frame again"
        raise DatasetError("image is not the one that was recorded", where=path, why=why, remedy=remedy)
    return View(frame.name, camera, world_from_camera, frame.split, path)


def truth_maps(recording: Path) -> dict[str, dict[str, Path]]:
    """Truth maps of a recording by channel and frame. Links inside the truth folder are not followed."""
    homes = [recording / TRUTH / channel for channel in CHANNELS]
    return {home.name: {path.stem: path for path in regular_files(home, "*")} for home in homes if not home.is_symlink()}


def extra_truth(folder: Path) -> dict[str, Path]:
    """Ground-truth meshes of a recording or scene, by their relative path in a scene; links are left out."""
    return {f"{TRUTH}/{path.name}": path for path in regular_files(folder / TRUTH, "*.ply")}


def measured_depth(recording: Recording, frames: list[Frame]) -> dict[str, Path]:
    """Depth that the camera measured, by its path in the scene, with the manifest that says how to read it; empty without any.

    Raises DatasetError: a file is missing or altered.
    """
    found = {}
    for frame in frames:
        if frame.depth is None:
            continue
        where = f"{recording.path}, frame {frame.name}"
        path = files.inside(recording.path, frame.depth.file, where=where)
        if not path.is_file() or files.sha256(path) != frame.depth.sha256:
            why = "its SHA-256 differs from frames.jsonl" if path.is_file() else "it is missing"
            raise DatasetError(
                "depth is not what was recorded", where=path, why=why, remedy="restore it, or record the frame again"
            )
        found[f"{SENSOR}/{DEPTH}/{frame.name}.png"] = path
    return {**found, f"{SENSOR}/{MANIFEST}": recording.path / MANIFEST} if found else {}


def incomplete_notes(recording: Recording, taken: int) -> list[str]:
    """What to say of a recording in which only some of the views were taken."""
    planned = recording.planned_views
    if planned is None or taken >= planned:
        return []
    note = f"the recording is incomplete, {taken} of {planned} views: 'capture run --resume' takes the others"
    given_up = left_out(recording)
    return [f"{note}; the arm did not come to rest at {', '.join(given_up)}" if given_up else note]


def depth_notes(frames: list[Frame]) -> list[str]:
    """What a scene says about measured depth."""
    count = sum(frame.depth is not None for frame in frames)
    if not count:
        return []
    return [f"{SENSOR}/{DEPTH} holds what the camera measured of {count} views; it is no truth, and nothing uses it"]


def regular_files(folder: Path, pattern: str) -> list[Path]:
    """Sorted files of a folder whose names match, without links."""
    return sorted(path for path in folder.glob(pattern) if path.is_file() and not path.is_symlink())


def object_box(recording: Recording, views: tuple[View, ...]) -> tuple[NDArray[np.float64], str]:
    """(2, 3) the object's volume [m] as the trajectory states it, else where the cameras look; and the evidence for it."""
    where = f"{recording.path / MANIFEST}, object"
    stated = recording.manifest.get("object") or recording.manifest.get("trajectory", {}).get("object")
    if stated is None:
        return bounds.surroundings(views)[0], CAMERAS_ALONE
    try:
        centre, size = (np.asarray(stated[key], np.float64).reshape(3) for key in ("centre", "size"))
    except (KeyError, TypeError, ValueError) as error:
        remedy = "state centre and size"
        raise DatasetError("object's volume is not complete", where=where, why=str(error), remedy=remedy) from None
    if not np.isfinite(centre).all() or not (size > 0).all() or not np.isfinite(size).all():
        raise DatasetError("object's volume is impossible", where=where, why=f"centre {centre}, size {size}")
    return np.stack([centre - size / 2, centre + size / 2]), STATED
