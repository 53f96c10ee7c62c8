"""What to say of a folder in no known format: what is there, what is missing, and the command that mends it."""

import shlex
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats.finding import models, pictures
from koala3d.datasets.formats.finding.pictures import Listing, homes

MOST_FOLDERS = 200
"""Number of inner folders in which a scene is sought."""
MOST_NAMED = 8
"""Number of entries of a folder that a message names."""
VIDEOS = ("*.mp4", "*.mov", "*.MP4", "*.MOV", "*.m4v", "*.avi", "*.mkv")
KNOWN = "write its poses as the frames of a transforms.json, see docs/datasets.md"
"""Remedy for known poses in a file that is not read."""
MARKS = (
    (("frames.jsonl",), "it is a recording", "datasets build {folder} --calibration FILE --out {new}"),
    (("run.json",), "it is a run, which names its scene", "reconstruct view {folder}"),
    (("transform*.json", "*transforms*.json"), "{found} is there, {folder}/transforms.json is not",
     "cp {found} {folder}/transforms.json"),
    (("*pose*bound*.npy",), "{found} is there, {folder}/poses_bounds.npy is not", "cp {found} {folder}/poses_bounds.npy"),
    (("cameras_sphere.npz", "cameras.npz", "cameras_large.npz"), "{found} is there, a folder of images is not",
     "put the images into {folder}/image"),
    (("*camera*.npz",), "{found} is there, {folder}/cameras_sphere.npz is not", "cp {found} {folder}/cameras_sphere.npz"),
    (("sfm_data.json",), "{found} is of OpenMVG", "openMVG_main_openMVG2Colmap -i {found} -o {folder}/sparse"),
    (("cameras.sfm", "*.sfm"), "{found} is of Meshroom", "aliceVision_exportColmap --input {found} --output {folder}"),
    (("bundle.out", "bundle/bundle.out"), "{found} is of Bundler", KNOWN),
    (("groundtruth.txt", "*trajectory*.txt", "traj*.txt"), "{found} may hold poses", KNOWN),
    (("*.csv",), "{found} may hold poses, but is no camera export of RealityScan",
     "export its internal/external camera parameters; if it holds no poses: datasets process {images} --out {new}"),
    (("*.xml",), "{found} is no camera export of Metashape", "export there with File > Export > Export Cameras, as Agisoft XML"),
    (("*.db",), "{found} is there, a model is not", "mkdir -p {folder}/sparse && "
     "colmap mapper --database_path {found} --image_path {images} --output_path {folder}/sparse"),
    (VIDEOS, "{found} is a video without poses", "datasets process {found} --out {new}"),
)  # fmt: skip
"""Of each kind of folder: files of which one is there, what they tell, and the command that makes a scene of it."""


def explain(folder: Path, is_scene: Callable[[Path], bool]) -> UsageError:
    """The error of a folder that holds no scene. `is_scene` tells whether an inner folder is one.

    Raises:
        DatasetError: there is a part of a COLMAP model.
    """
    models.find(folder)
    why, command = _scene_within(folder, is_scene) or _mark(folder) or _photographs(folder) or ("", "")
    if not why:
        entries = sorted(path.name + "/" * path.is_dir() for path in islice(folder.iterdir(), MOST_FOLDERS))
        more = ", ..." if len(entries) > MOST_NAMED else ""
        why = f"it holds {', '.join(entries[:MOST_NAMED])}{more}" if entries else "it is empty"
        why += "; no cameras.json, transforms*.json, poses_bounds.npy, cameras_sphere.npz, meta_data.json or COLMAP model"
        command = "give the folder that holds one of these"
    return UsageError("holds no scene in a known format", where=folder, why=why, remedy=command)


def _scene_within(folder: Path, is_scene: Callable[[Path], bool]) -> tuple[str, str] | None:
    found = [path for path in islice(_inner(folder), MOST_FOLDERS) if is_scene(path)]
    if not found:
        return None
    names = ", ".join(str(path.relative_to(folder)) for path in found[:MOST_NAMED])
    return f"there is one in {names}", f"datasets info {shlex.quote(str(found[0]))}"


def _inner(folder: Path) -> Iterator[Path]:
    """Folders in a folder, and those in them; links are not followed."""
    level = [folder]
    for _ in range(2):
        level = [path for above in level for path in sorted(above.iterdir()) if path.is_dir() and not path.is_symlink()]
        level = level[:MOST_FOLDERS]
        yield from level


def _mark(folder: Path) -> tuple[str, str] | None:
    quoted = shlex.quote(str(folder))
    images = shlex.quote(str(next(iter(homes(folder)), folder)))
    for patterns, what, command in MARKS:
        found = next((path for pattern in patterns for path in sorted(folder.glob(pattern))), None)
        if found is not None:
            words = {"folder": quoted, "found": shlex.quote(str(found)), "images": images, "new": _new(folder)}
            return what.format(**words), command.format(**words)
    return None


def _photographs(folder: Path) -> tuple[str, str] | None:
    listing = Listing()
    for home in (*homes(folder), folder):
        if found := pictures.photographs(listing.files(home)):
            return f"it holds {len(found)} images and no poses", f"datasets process {shlex.quote(str(home))} --out {_new(folder)}"
    return None


def _new(folder: Path) -> str:
    return shlex.quote(f"{folder.resolve().name}_scene")
