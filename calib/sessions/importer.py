"""Sessions that other programs recorded: a folder of images with the arm's poses.

A description (`description`) states the conventions. It is used only where a person names it, and leads to nothing outside the
folder.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from koala3d.calib.sessions import pose_files
from koala3d.calib.sessions.description import Description, load_description
from koala3d.calib.sessions.layouts import as_pose, other_readings
from koala3d.calib.sessions.session import TargetSession, observe, observe_recording
from koala3d.calib.targets.detection import check_markers, read_board
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import MANIFEST, Recording
from koala3d.datasets.targets.board import Board

DESCRIPTION = "import.yaml"
Seen = Callable[[str], None]
"""Called after each image with a few words."""


def observe_folder(
    folder: Path,
    description: Path | None = None,
    *,
    board: Board | None = None,
    seen: Seen = lambda words: None,
    leave_out: bool = False,
    calibration: Calibration | None = None,
) -> tuple[TargetSession, Camera | None]:
    """Find the target in a recording or, as `description` says, in a folder to import; and the camera that the import brings.

    `board` is looked for instead of the target that the recording or the description names. A recording that was made of a ROS
    bag names none and does not know how late its pictures are: target and latency are those of `calibration`. With `leave_out`,
    images without a pose are left out instead of refusing the session.

    Raises UsageError where the folder is no recording and no description is given, and what the two functions for them raise.
    """
    imported = _imported(folder, description)
    if imported is None:
        session = observe_recording(folder, board or _known_board(folder, calibration), seen=seen)
        return session.at_exposure((calibration and calibration.residuals.latency_s) or 0.0), None
    imported = imported.model_copy(update={"board": board or imported.board})
    session = import_session(folder, imported, seen=seen, leave_out=leave_out)
    return session, imported.camera.camera() if imported.camera else None


def _known_board(folder: Path, calibration: Calibration | None) -> Board | None:
    """The target of a calibration, for a recording that was made of a ROS bag; None for others, which name their own."""
    known = None if calibration is None else calibration.provenance.get("board")
    return read_board(known, where="calibration, board") if known and Recording.open(folder).is_of_a_bag else None


def count_views(folder: Path, description: Path | None = None) -> int:
    """Number of images that `observe_folder` searches."""
    imported = _imported(folder, description)
    return len(Recording.open(folder).frames) if imported is None else len(pose_files.matching(folder, imported.images))


def _imported(folder: Path, description: Path | None) -> Description | None:
    """How to read a folder to import; None for a recording."""
    if description is not None:
        return load_description(description)
    if folder.is_dir() and not (folder / MANIFEST).is_file():
        own = folder / DESCRIPTION
        remedy = "describe images and poses in a file, see docs/calibration_import.md, and give it as --import"
        remedy = f"to import it as its own description says, give --import {own}" if own.is_file() else remedy
        raise UsageError("is not a recording", where=folder, why=f"it has no {MANIFEST}", remedy=remedy)
    return None


def import_session(
    folder: Path, description: Description, *, seen: Seen = lambda words: None, leave_out: bool = False
) -> TargetSession:
    """Find the target in the images of a folder, and read the arm's pose of each.

    Raises:
        UsageError: no image is there; or no pose of an image, unless these are left out; or more poses than images.
        DatasetError, CalibrationError: a pose cannot be what the description says, or a path leaves the folder.
        TargetError: the target is in no image.
    """
    folder = Path(folder)
    board = check_markers(description.board, where="description, board")
    images = pose_files.matching(folder, description.images)
    if not images:
        why = f"nothing matches {description.images!r}"
        raise UsageError("no images found", where=folder, why=why, remedy="correct 'images'")
    known = pose_files.numbers(folder, description, images)
    without = {name: f"it has no pose; there are {len(known)} for {len(images)} pictures" for name in images if name not in known}
    if without and (not leave_out or not known):
        why = ", ".join(list(without)[:5]) + (", ..." if len(without) > 5 else "")
        remedy = f"correct 'poses' ({description.poses}), or leave them out with --leave-out"
        raise UsageError("images without a pose", where=folder, why=why, remedy=remedy)
    views = [(name, images[name], as_pose(n, description, where=f"{folder}, pose of view {name}")) for name, n in known.items()]
    hashes = "+".join(files.sha256(path)[:12] for path in images.values())
    provenance = {"folder": str(folder.resolve()), "board": board.to_json(), "frames_sha256": hashes}
    provenance |= {"leave_out": True} if without else {}
    found = observe(board, views, provenance=provenance, seen=seen, eye_to_hand=description.eye_to_hand)
    readings = other_readings([known[observation.name] for observation in found.observations], description)
    return replace(found, left_out=without, readings=readings)
