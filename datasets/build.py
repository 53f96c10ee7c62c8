"""From a recording and a calibration to a scene: world is the robot's base, unit the metre.

world_from_camera = base_from_flange @ flange_from_camera, the flange where the calibration says that it truly is
"""

from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.calibration import Calibration
from datasets.camera_model import Camera
from datasets.core import files
from datasets.core.errors import DatasetError, UsageError
from datasets.formats import koala
from datasets.formats.assemble import CAMERAS_ALONE
from datasets.imaging import images
from datasets.imaging.region import Region
from datasets.recording import MANIFEST, TRUTH, Frame, Recording
from datasets.scene import SPLITS, STATED, Scene, View
from datasets.structure import bounds
from datasets.structure.measure import measured

NEAR_SHARE = 0.25
"""Where the pictures do not show it, near is this share of the depth at which a camera first meets the object's box: the
table may come closer than the object."""


def build(
    recording_path: Path,
    calibration_path: Path,
    out: Path,
    *,
    sizes: tuple[int, ...] = (),
    done: Callable[[], None] = lambda: None,
) -> Scene:
    """Write the Koala scene of a recording to `out`, all or nothing. `done` is called after each frame.

    For each N of `sizes`, `images_N` holds the images at 1/N of their size.

    Raises:
        UsageError: a calibration session, a calibration without a hand-eye pose, or an `out` that holds something.
        DatasetError: an image is missing, damaged, altered or of another size than the calibrated camera's.
    """
    files.refuse_existing(out)
    recording = Recording.open(recording_path)
    calibration = Calibration.load(calibration_path)
    if calibration.flange_from_camera is None:
        raise UsageError(
            "calibration holds no hand-eye pose", where=calibration_path, remedy="run 'calib handeye' on the target's recording"
        )
    frames = [frame for frame in recording.frames if frame.split in SPLITS]
    if not frames:
        why = f"all {len(recording.frames)} frames are of a calibration session" if recording.frames else "it holds no frames"
        raise UsageError(
            "recording has no views of an object", where=recording_path, why=why, remedy="record a trajectory with an object"
        )
    camera, notes = camera_for(recording, calibration)
    views = []
    for frame in frames:
        views.append(_view(recording, frame, camera, calibration.camera_pose(frame.base_from_flange, frame.joints)))
        done()
    box, evidence = object_box(recording, tuple(views))
    provenance = {
        "format": koala.FORMAT,
        "recording": str(recording.path.absolute()),
        "calibration": str(Path(calibration_path).absolute()),
        "calibration_sha256": files.sha256(calibration_path),
        "manifest_sha256": files.sha256(recording.path / MANIFEST),
        "frames_sha256": {f.name: f.sha256 for f in frames},
        "flange_from_camera": calibration.flange_from_camera.to_json(),
        "software": {"koala-capture": version("koala-capture")},
    }
    scene = Scene(
        Path(out).resolve().name,
        tuple(views),
        NEAR_SHARE * bounds.depth_range(views, box)[0],
        np.inf,
        box,
        "scene",
        metric=True,
        notes=tuple(notes),
        provenance=provenance,
        bounds_from=evidence,
    )
    if evidence != CAMERAS_ALONE:  # else all of it is measured where the scene is used
        scene = with_measured_near(scene)
    koala.save(scene, out, extra=extra_truth(recording.path), sizes=sizes)
    return scene


def with_measured_near(scene: Scene) -> Scene:
    """The scene with near as its pictures show it; where too little can be triangulated it stays as it is, and a note says so.

    What lies before everything that was ever seen is empty, and a reconstruction that knows so does not fill it with clouds.
    """
    seen = measured(scene)
    if seen.points is None:
        why = seen.bounds_from.removeprefix(f"{scene.bounds_from}; ")
        note = f"near is a guess: {why}; something with texture beside the object keeps reconstructions free of fog before the lenses"
        return replace(scene, notes=(*scene.notes, note))
    return replace(scene, near=seen.near, bounds_from=f"box {scene.bounds_from}; near from {seen.bounds_from}")


def camera_for(recording: Recording, calibration: Calibration) -> tuple[Camera, list[str]]:
    """The calibrated camera for this recording's pictures, and a note where it had to be converted.

    Both sessions may have read out different regions of the sensor or binned it differently: where both say which, the
    conversion is exact.

    Raises:
        DatasetError: the sizes differ and one of the two does not say its region, or the images have another size.
    """
    actual = images.size(recording.image_path(recording.frames[0]))
    calibrated, notes = calibration.camera, []
    ours, theirs = _region(recording.manifest, where=recording.path / MANIFEST), _calibrated_region(calibration)
    if ours is not None and theirs is not None and ours != theirs:
        calibrated = theirs.converted(calibrated, ours)
        notes.append(f"intrinsics converted from {_words(theirs)} to {_words(ours)}")
    if (calibrated.width, calibrated.height) != actual:
        raise DatasetError(
            "calibration is for another image size",
            where=recording.path,
            why=f"images are {actual[0]}x{actual[1]}, the calibrated camera is {calibrated.width}x{calibrated.height}",
            remedy="calibrate with the same region of interest and binning",
        )
    return calibrated, notes


def _calibrated_region(calibration: Calibration) -> Region | None:
    """Region of the calibration's pictures: as it says itself, else as the recording that it was made from says."""
    said = calibration.provenance
    if said.get("region") is not None:
        return Region.from_json(said["region"], where="calibration, provenance, region")
    manifest = Path(said.get("recording", "")) / MANIFEST
    return _region(files.read_json(manifest), where=manifest) if manifest.is_file() else None


def _region(manifest: dict[str, Any], *, where: object) -> Region | None:
    camera = manifest.get("camera")
    content = camera.get("region") if isinstance(camera, dict) else None
    return None if content is None else Region.from_json(content, where=f"{where}, camera, region")


def _words(region: Region) -> str:
    return f"{region.width}x{region.height} at ({region.offset_x}, {region.offset_y}) with binning {region.binning}"


def _view(recording: Recording, frame: Frame, camera: Camera, world_from_camera: NDArray[np.float64]) -> View:
    """One frame as a view; its image must be the one that was recorded."""
    where = f"{recording.path}, frame {frame.name}"
    path = files.inside(recording.path, frame.image, where=where)
    if images.size(path) != (camera.width, camera.height):
        raise DatasetError(
            "image has the wrong size",
            where=path,
            remedy="record the frame again",
            why="it is {}x{}".format(*images.size(path)) + f", the others are {camera.width}x{camera.height}",
        )
    if frame.sha256 and files.sha256(path) != frame.sha256:
        raise DatasetError(
            "image is not the one that was recorded",
            where=path,
            why="its SHA-256 differs from frames.jsonl",
            remedy="restore it, or record the frame again",
        )
    return View(frame.name, camera, world_from_camera, frame.split, path, truth=_truth(recording.path, frame.name))


def _truth(recording: Path, name: str) -> dict[str, Path]:
    """Truth maps of one frame by channel."""
    channels = sorted(path for path in (recording / TRUTH).glob("*") if path.is_dir())
    found = {channel.name: sorted(channel.glob(f"{name}.*")) for channel in channels}
    return {channel: paths[0] for channel, paths in found.items() if paths}


def extra_truth(folder: Path) -> dict[str, Path]:
    """True meshes of a recording or scene by the name under which a scene keeps them."""
    return {f"{TRUTH}/{path.name}": path for path in sorted((folder / TRUTH).glob("*.ply"))}


def object_box(recording: Recording, views: tuple[View, ...]) -> tuple[NDArray[np.float64], str]:
    """(2, 3) the object's volume as the trajectory states it [m]; without one, where the cameras look; and which it is."""
    where = f"{recording.path / MANIFEST}, object"
    stated = recording.manifest.get("object") or recording.manifest.get("trajectory", {}).get("object")
    if stated is None:
        return bounds.surroundings(views)[0], CAMERAS_ALONE
    try:
        centre, size = (np.asarray(stated[key], np.float64).reshape(3) for key in ("centre", "size"))
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            "object's volume is not complete", where=where, why=str(error), remedy="state centre and size"
        ) from None
    if not np.isfinite(centre).all() or not (size > 0).all() or not np.isfinite(size).all():
        raise DatasetError("object's volume is impossible", where=where, why=f"centre {centre}, size {size}")
    return np.stack([centre - size / 2, centre + size / 2]), STATED
