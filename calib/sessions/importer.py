"""Sessions that other programs recorded: a folder of images with the arm's poses in CSV, YAML or JSON.

A description states the conventions. It is used only where a person names it, and leads to nothing outside the folder:

    format: koala-import
    version: 1
    images: "image-*.png"            # the part matched by * is the name of the view
    poses: "pose-*.yaml"             # a file for each image, or one file for all
    key: data                        # where in a YAML or JSON file; a.b for b inside a
    layout: x y z rx ry rz           # or: x y z qw qx qy qz; x y z qx qy qz qw; matrix; matrix by columns
    board: {type: chessboard, squares_x: 10, squares_y: 7, square_length_m: 0.0236}

One file for all views is a CSV with a column `image` and a column for each word of the layout (m00 m01 ... for a matrix), a
YAML or JSON list of entries {image: NAME, pose: NUMBERS}, or a mapping of image names to numbers. A CSV without that column, and
a list of nothing but numbers, are in the order of the images.
"""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from koala3d import configs
from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.sessions.session import TargetSession, observe, observe_recording
from koala3d.calib.targets.detection import check_markers
from koala3d.datasets import conventions, pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files, plain_yaml
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.core.schema import Schema, load_yaml
from koala3d.datasets.recording import MANIFEST, Recording
from koala3d.datasets.targets.board import Board, load_board

DESCRIPTION = "import.yaml"
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
Layout = Literal["x y z rx ry rz", "x y z qw qx qy qz", "x y z qx qy qz qw", "matrix", "matrix by columns"]
LAYOUTS = {"x y z rx ry rz": 6, "x y z qw qx qy qz": 7, "x y z qx qy qz qw": 7, "matrix": 16, "matrix by columns": 16}
"""How many numbers each layout has; a matrix may also be given by its upper three rows."""
MAX_CSV_BYTES = 2**24
Seen = Callable[[str], None]
"""Called after each image with a few words."""


def _named(board: Any) -> Any:
    """A board that is given by its name or its file; anything else as it is."""
    return load_board(configs.find("boards", board)) if isinstance(board, str) else board


NamedBoard = Annotated[Board, BeforeValidator(_named)]


class CameraNumbers(Schema):
    """A camera calibrated elsewhere; it is kept as it is."""

    width: int = Field(ge=16, description="of the images [px]")
    height: int = Field(ge=16, description="of the images [px]")
    fx: float = Field(gt=0, description="focal length [px]")
    fy: float = Field(gt=0, description="focal length [px]")
    cx: float = Field(description="principal point [px]")
    cy: float = Field(description="principal point [px]")
    distortion: list[float] = Field(default=[], max_length=8, description="k1 k2 p1 p2 k3 k4 k5 k6, as many as there are")
    first_pixel: float = Field(0, ge=0, le=0.5, multiple_of=0.5, description="centre of the first pixel; 0 for OpenCV, ViSP [px]")

    def camera(self) -> Camera:
        """In our pixel coordinates."""
        shift, bent = conventions.OPENCV_PIXEL_SHIFT - self.first_pixel, dict(zip(DISTORTION, self.distortion, strict=False))
        return Camera(self.width, self.height, self.fx, self.fy, self.cx + shift, self.cy + shift, **bent)


class Description(Schema):
    """How a folder of images and poses is to be read."""

    format: Literal["koala-import"] = Field(default="koala-import", description="what this file is")
    version: Literal[1] = Field(default=1, description="version of this format")
    images: str = Field(description="pattern of the images in the folder, with one *, which names the view")
    poses: str = Field(description="pattern of the pose files, with one *, or the one file of all poses (.csv .yaml .json)")
    key: str = Field(default="", description="where the numbers are in a YAML or JSON file; a.b for b inside a")
    layout: Layout = Field(description="meaning and order of the numbers of a pose")
    length: Literal["m", "mm"] = Field(default="m", description="unit of lengths")
    angle: Literal["rad", "deg"] = Field(default="rad", description="unit of rotation vectors")
    inverse: bool = Field(default=False, description="true where the poses are flange_from_base; else base_from_flange")
    eye_to_hand: bool = Field(default=False, description="true where the camera stands beside the arm and holds still")
    board: NamedBoard = Field(description="the target: name of a shipped board, a board file, or type, squares_x, ...")
    camera: CameraNumbers | None = Field(default=None, description="a camera calibrated elsewhere; null: estimated along")

    @model_validator(mode="after")
    def _one_star(self) -> Self:
        if self.images.count("*") != 1 or self.poses.count("*") > 1:
            raise ValueError("images needs exactly one * in its pattern, poses at most one")
        return self


def load_description(description: Path) -> Description:
    """A shipped description by its name, or one in a file. Raises UsageError where it is missing or wrong."""
    return load_yaml(configs.find("imports", description), Description)


def observe_folder(
    folder: Path,
    description: Path | None = None,
    *,
    board: Board | None = None,
    seen: Seen = lambda words: None,
    leave_out: bool = False,
) -> tuple[TargetSession, Camera | None]:
    """Find the target in a recording or, as `description` says, in a folder to import; and the camera that the import brings.

    `board` is looked for instead of the target that the recording or the description names. With `leave_out`, images without a
    pose are left out instead of refusing the session.

    Raises UsageError where the folder is no recording and no description is given, and what the two functions for them raise.
    """
    imported = _imported(folder, description)
    if imported is None:
        return observe_recording(folder, board, seen=seen), None
    imported = imported.model_copy(update={"board": board or imported.board})
    session = import_session(folder, imported, seen=seen, leave_out=leave_out)
    return session, imported.camera.camera() if imported.camera else None


def count_views(folder: Path, description: Path | None = None) -> int:
    """Number of images that `observe_folder` searches."""
    imported = _imported(folder, description)
    return len(Recording.open(folder).frames) if imported is None else len(matching(folder, imported.images))


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
    images = matching(folder, description.images)
    if not images:
        why = f"nothing matches {description.images!r}"
        raise UsageError("no images found", where=folder, why=why, remedy="correct 'images'")
    known = _numbers(folder, description, images)
    numbers = {name: known[name] for name in images if name in known}.items()
    without = {name: f"it has no pose; there are {len(known)} for {len(images)} pictures" for name in images if name not in known}
    if without and (not leave_out or not known):
        why = ", ".join(list(without)[:5]) + (", ..." if len(without) > 5 else "")
        remedy = f"correct 'poses' ({description.poses}), or leave them out with --leave-out"
        raise UsageError("images without a pose", where=folder, why=why, remedy=remedy)
    views = [(name, images[name], as_pose(n, description, where=f"{folder}, pose of view {name}")) for name, n in numbers]
    hashes = "+".join(files.sha256(path)[:12] for path in images.values())
    provenance = {"folder": str(folder.resolve()), "board": board.to_json(), "frames_sha256": hashes}
    provenance |= {"leave_out": True} if without else {}
    found = observe(board, views, provenance=provenance, seen=seen, eye_to_hand=description.eye_to_hand)
    return replace(found, left_out=without)


def matching(folder: Path, pattern: str) -> dict[str, Path]:
    """Files by what the * of the pattern stands for; numbers sort as numbers. Raises DatasetError where it leaves the folder."""
    pattern = str(PurePosixPath(pattern))
    files.inside(folder, pattern, where=f"description, {pattern}")
    before, after = pattern.split("*")
    names = {path.relative_to(folder).as_posix(): path for path in folder.glob(pattern)}
    found = {name[len(before) : len(name) - len(after)]: path for name, path in names.items()}
    return dict(sorted(found.items(), key=lambda item: (len(item[0]), item[0]) if item[0].isdigit() else (0, item[0])))


def _numbers(folder: Path, description: Description, images: dict[str, Path]) -> dict[str, list[float]]:
    """The numbers of the poses by name of the view; those of other names are left out."""
    if "*" in description.poses:
        paths = matching(folder, description.poses)
        found = {name: _at(description.key, path) for name, path in paths.items() if name in images}
    else:
        path = files.inside(folder, description.poses, where="description, poses")
        poses = _csv(path, description) if path.suffix.lower() == ".csv" else _table(_at(description.key, path), path)
        found = _in_order(poses, images, path) if isinstance(poses, list) else _by_name(poses, images)
    result = {}
    for name in found:
        try:
            result[name] = np.asarray(found[name], np.float64).ravel().tolist()
        except (TypeError, ValueError, OverflowError):
            why = str(found[name])[:80]
            raise DatasetError("pose is not made of numbers", where=f"{folder}, view {name}", why=why) from None
    return result


def _by_name(poses: dict[str, Any], images: dict[str, Path]) -> dict[str, Any]:
    """Poses by name of the view, out of poses by name of the image or of the view."""
    views = {file.name: name for name, file in images.items()}
    found = {views.get(Path(image).name, image): numbers for image, numbers in poses.items()}
    return {name: found[name] for name in images if name in found}


def _in_order(poses: list[Any], images: dict[str, Path], path: Path) -> dict[str, Any]:
    """Poses by name of the view, out of a list in the order of the images. The last images may have none."""
    if len(poses) > len(images):
        why, remedy = f"{len(poses)} for {len(images)} pictures", "remove those whose pictures are missing, or name the images"
        raise UsageError("there are more poses than pictures", where=path, why=why, remedy=remedy)
    return dict(zip(images, poses, strict=False))


def _at(key: str, path: Path) -> Any:
    """What a YAML or JSON file holds at a key."""
    content = files.read_json(path) if path.suffix.lower() == ".json" else plain_yaml.load(path)
    for part in key.split(".") if key else []:
        if not isinstance(content, dict) or part not in content:
            keys = sorted(map(str, content)) if isinstance(content, dict) else "no mapping"
            raise DatasetError(f"no key {part!r}", where=path, why=f"it has {keys}", remedy="correct 'key'")
        content = content[part]
    return content


def _table(content: Any, path: Path) -> dict[str, Any] | list[Any]:
    """Numbers by image name from a list of entries or from a mapping; from a list of numbers alone, numbers in order."""
    if isinstance(content, dict):
        return {str(name): values for name, values in content.items()}
    if isinstance(content, list) and content and all(isinstance(entry, list) for entry in content):
        return content
    try:
        return {str(entry["image"]): entry["pose"] for entry in content}
    except (TypeError, KeyError) as error:
        why, remedy = f"{type(error).__name__} {error}", "write entries {image: NAME, pose: [...]}"
        raise DatasetError("is no list of poses", where=path, why=why, remedy=remedy) from None


def _csv(path: Path, description: Description) -> dict[str, Any] | list[Any]:
    """Numbers by image name from a CSV file with a header; in order where it has no column of images."""
    names = description.layout.split() if "matrix" not in description.layout else [f"m{r}{c}" for r in range(4) for c in range(4)]
    try:
        text = files.read_regular(path, MAX_CSV_BYTES, suffixes=(".csv",)).decode("utf-8")
        reader = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True)
        columns, rows = reader.fieldnames or [], list(reader)
    except (csv.Error, UnicodeDecodeError) as error:
        raise DatasetError("is not a CSV file", where=path, why=str(error)) from None
    if "m33" not in columns:
        names = [name for name in names if not name.startswith("m3")]
    if absent := [name for name in names if name not in columns]:
        raise DatasetError(f"no column {absent[0]!r}", where=path, why=f"it has {', '.join(columns) or 'none'}")
    if "image" not in columns:
        return [[row[name] for name in names] for row in rows]
    return {str(row["image"]): [row[name] for name in names] for row in rows}


def as_pose(numbers: Sequence[float], description: Description, *, where: object) -> Array:
    """(4, 4) base_from_flange [m] out of the numbers of a file.

    Raises DatasetError for numbers that are no pose in this layout, CalibrationError for those that betray another unit or order.
    """
    values, layout = np.asarray(numbers, np.float64), description.layout
    if len(values) != LAYOUTS[layout] and not ("matrix" in layout and len(values) == 12):
        raise DatasetError(f"pose has {len(values)} numbers", where=where, why=f"layout {layout!r} has {LAYOUTS[layout]}")
    if not np.isfinite(values).all():
        raise DatasetError("pose is not finite", where=where, why="it holds NaN or infinity", remedy="remove the view")
    matrix = (_from_matrix(values, layout, where) if "matrix" in layout else _from_vector(values, description, where)).copy()
    matrix[:3, 3] *= 1e-3 if description.length == "mm" else 1.0
    if (furthest := np.abs(matrix[:3, 3]).max()) > 20:
        why, remedy = f"{furthest:.4g} m from its base", "millimetres? then say length: mm"
        raise CalibrationError("arm's position is not credible", where=where, why=why, remedy=remedy)
    return pose.inverse(matrix) if description.inverse else matrix


def _from_vector(values: Array, description: Description, where: object) -> Array:
    if description.layout == "x y z rx ry rz":
        turn = np.deg2rad(values[3:]) if description.angle == "deg" else values[3:]
        if (length := np.linalg.norm(turn)) > 2 * np.pi + 1e-6:
            why, remedy = f"{length:.4g} rad", "degrees? then say angle: deg"
            raise CalibrationError("rotation vector is longer than a full turn", where=where, why=why, remedy=remedy)
        return pose.from_rotation_vector(turn, values[:3])
    quaternion = values[3:] if description.layout.endswith("qz") else np.roll(values[3:], 1)
    if abs((length := np.linalg.norm(quaternion)) - 1) > 1e-2:
        why, remedy = f"its length is {length:.4g}", "check layout and file"
        raise CalibrationError("quaternion is not of unit length", where=where, why=why, remedy=remedy)
    return pose.from_quaternion(quaternion, values[:3])


def _from_matrix(values: Array, layout: str, where: object) -> Array:
    rows = values.reshape(-1, 4) if layout == "matrix" else values.reshape(4, -1).T
    if len(rows) == 4 and not np.allclose(rows[3], [0, 0, 0, 1], atol=1e-6):
        other = "matrix by columns" if layout == "matrix" else "matrix"
        hint = f"it is stored the other way: say layout: {other}" if np.allclose(rows[:, 3], [0, 0, 0, 1], atol=1e-6) else ""
        raise CalibrationError("last row of the pose is not 0 0 0 1", where=where, why=str(rows[3].tolist()), remedy=hint)
    return pose.checked(rows, where=where)
