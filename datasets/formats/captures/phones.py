"""Captures of phones with ARKit: raw exports of Polycam, of Record3D (EXR_RGBD) and of 3D Scanner App. Read only, in metres.

All state camera-to-world with ARKit's camera axes, which are OpenGL's (x right, y up, z back), for pictures as the sensor holds
them, wider than high; the world's y axis points up. Principal points count from the picture's corner.

    Polycam   keyframes/images/TIME.jpg, keyframes/cameras/TIME.json with fx, fy, cx, cy, width, height and t_00 to t_23; if the
              program improved them, corrected_images and corrected_cameras
    Record3D  EXR_RGBD/rgb/NUMBER.jpg (or rgb/ itself), metadata.json with w, h, K column by column, and poses: a quaternion
              x y z w and a position for each picture
    Scanner   frame_NUMBER.json with cameraPoseARFrame and intrinsics, row by row; frame_NUMBER.jpg beside some of them
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_FROM_OPENGL
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.formats import assemble
from koala3d.datasets.formats.finding.pictures import Listing
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View, with_test_views

POLYCAM = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
"""Folders of cameras and images below `keyframes`, the better ones first."""
RECORD3D = ("EXR_RGBD", "")
"""Folders of an export of Record3D, with its metadata and the folder `rgb`."""
METADATA = "metadata.json"
Posed = tuple[str, Path | None, dict[str, float], NDArray[np.float64]]
"""What is said of a picture: its name, its file, intrinsics as `Camera` names them, and (4, 4) ARKit's world_from_camera."""


def polycam(folder: Path) -> tuple[Path, Path] | None:
    """Folders of cameras and images of an export of Polycam, as improved as there are; None where it is none."""
    below = folder / "keyframes" if (folder / "keyframes").is_dir() else folder
    pairs = [(below / cameras, below / pictures) for cameras, pictures in POLYCAM]
    return next((pair for pair in pairs if pair[1].is_dir() and any(pair[0].glob("*.json"))), None)


def record3d(folder: Path) -> Path | None:
    """Folder with metadata and pictures of an export of Record3D; None where it is none."""
    return next((at for name in RECORD3D if ((at := folder / name) / METADATA).is_file() and (at / "rgb").is_dir()), None)


def scanner(folder: Path) -> list[Path]:
    """The frames of an export of 3D Scanner App, most of them without a picture; none where it is none."""
    frames = [path for path in sorted(folder.glob("frame_*.json")) if path.stem.removeprefix("frame_").isdigit()]
    return frames if any(path.with_suffix(".jpg").is_file() for path in frames) else []


def detect(folder: Path) -> bool:
    """True for a raw export of Polycam, an EXR_RGBD export of Record3D, or one of 3D Scanner App with all data."""
    return polycam(folder) is not None or record3d(folder) is not None or bool(scanner(folder))


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None, problems: list[KoalaError] | None = None) -> Scene:
    """Read the capture of a phone; every `hold_out`-th view by sorted name is a test view. `images_folder` replaces the images'.

    Raises:
        DatasetError: a file is damaged, or there are fewer poses than pictures.
    """
    gathering = assemble.Gathering(folder, problems)
    pair = polycam(folder)
    if pair is not None:
        listed, said = "cameras", _of_polycam(gathering, *pair, images_folder)
    elif record3d(folder) is not None:
        listed, said = METADATA, _of_record3d(gathering, folder, images_folder)
    else:
        listed, said = "frame_*.json", _of_scanner(gathering, folder, images_folder)
    for name, image, numbers, matrix in said:
        with gathering.collecting():
            if image is None:
                gathering.missing.append(name)
                continue
            where = f"{folder}, {name}"
            camera = gathering.fitted(Camera.from_json(numbers, where=where), image, where=where)
            world_from_camera = pose.checked(matrix, where=where) @ OPENCV_FROM_OPENGL
            gathering.views.append(View(name, camera, world_from_camera, "train", image))
    gathering.notes.append("poses are a phone's own: training may have to refine them (--set poses.enabled=true)")
    views = gathering.finished(listed_in=listed)
    return replace(assemble.scene(gathering, with_test_views(views, hold_out), "phone"), metric=True)


def _of_polycam(gathering: assemble.Gathering, cameras: Path, pictures: Path, wanted: str | None) -> Iterator[Posed]:
    """The pictures of Polycam by the names of their files, which are times."""
    home, listing = pictures if wanted is None else files.inside(pictures.parent, wanted), Listing()
    if not cameras.name.startswith("corrected"):
        gathering.notes.append("Polycam has not improved these poses: the ones that the phone tracked are used")
    for path in sorted(cameras.glob("*.json")):
        with gathering.collecting():
            content = files.read_json(files.within(gathering.folder, path))
            try:
                numbers = {key: float(content[key]) for key in ("fx", "fy", "cx", "cy", "width", "height")}
                rows = [[float(content[f"t_{row}{column}"]) for column in range(4)] for row in range(3)]
            except (KeyError, TypeError, ValueError) as error:
                raise DatasetError("camera is not complete", where=path, why=str(error)) from None
            yield path.stem, listing.like(home, path.stem), _whole(numbers), np.array([*rows, [0, 0, 0, 1]])


def _of_record3d(gathering: assemble.Gathering, folder: Path, wanted: str | None) -> Iterator[Posed]:
    """The pictures of Record3D by their numbers."""
    home = record3d(folder)
    assert home is not None, "the folder was detected"
    content, listing = files.read_json(files.within(folder, home / METADATA)), Listing()
    among = home / "rgb" if wanted is None else files.inside(folder, wanted)
    try:
        matrix = np.asarray(content["K"], np.float64).reshape(3, 3).T
        poses = np.asarray(content["poses"], np.float64).reshape(-1, 7)
        size = {"width": float(content["w"]), "height": float(content["h"])}
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError("metadata is not complete", where=home / METADATA, why=str(error)) from None
    numbers = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2], **size}
    if not np.isfinite(poses).all() or not np.allclose(np.linalg.norm(poses[:, :4], axis=1), 1, atol=1e-2):
        raise DatasetError("pose is not a unit quaternion and a position", where=home / METADATA)
    if extra := [path.name for path in listing.files(among) if not path.stem.isdigit() or int(path.stem) >= len(poses)]:
        why = f"{len(poses)} poses, {', '.join(extra[:3])} among the pictures"
        raise DatasetError("pictures and poses do not belong together", where=among, why=why)
    digits = len(str(max(len(poses) - 1, 0)))
    for number, one in enumerate(poses):
        found = pose.from_quaternion(np.roll(one[:4], 1), one[4:])
        yield f"{number:0{digits}d}", listing.like(among, str(number)), _whole(numbers), found


def _of_scanner(gathering: assemble.Gathering, folder: Path, wanted: str | None) -> Iterator[Posed]:
    """The frames of 3D Scanner App that have a picture: depth is recorded more often than colour."""
    among, listing = folder if wanted is None else files.inside(folder, wanted), Listing()
    for path in scanner(folder):
        image = listing.like(among, path.stem)
        if image is None:
            continue
        with gathering.collecting():
            content = files.read_json(files.within(folder, path))
            try:
                (fx, _, cx), (_, fy, cy), _ = np.asarray(content["intrinsics"], np.float64).reshape(3, 3).tolist()
                matrix = np.asarray(content["cameraPoseARFrame"], np.float64).reshape(4, 4)
            except (KeyError, TypeError, ValueError) as error:
                raise DatasetError("frame is not complete", where=path, why=str(error)) from None
            width, height = images.size(image)
            yield path.stem, image, {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": width, "height": height}, matrix


def _whole(numbers: dict[str, Any]) -> dict[str, Any]:
    """Intrinsics with a size in whole pixels."""
    return {**numbers, "width": int(numbers["width"]), "height": int(numbers["height"])}
