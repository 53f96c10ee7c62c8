"""Sessions that other programs recorded: a folder of images with the arm's poses in CSV, YAML or JSON.

A description states the conventions. By default it is `import.yaml` in the folder:

    format: koala-import
    version: 1
    images: "image-*.png"            # the part matched by * is the name of the view
    poses: "pose-*.yaml"             # a file for each image, or one file for all
    key: data                        # where in a YAML or JSON file; a.b for b inside a
    layout: x y z rx ry rz           # or: x y z qw qx qy qz; x y z qx qy qz qw; matrix; matrix by columns
    board: {type: chessboard, squares_x: 10, squares_y: 7, square_length_m: 0.0236}

One file for all views is a CSV with a column `image` and a column for each word of the layout (m00 m01 ... for a matrix), a
YAML or JSON list of entries {image: NAME, pose: NUMBERS}, or a mapping of image names to numbers.
"""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field, model_validator

import configs
from calib.errors import CalibrationError
from calib.sessions.session import TargetSession, observe, observe_recording
from calib.targets.detection import check_markers
from datasets import conventions, pose
from datasets.board import Board
from datasets.camera_model import Camera
from datasets.core import files
from datasets.core.errors import DatasetError, UsageError
from datasets.core.schema import Schema, load_yaml
from datasets.recording import MANIFEST, Recording

Array = NDArray[np.float64]
DESCRIPTION = "import.yaml"
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
LAYOUTS = {"x y z rx ry rz": 6, "x y z qw qx qy qz": 7, "x y z qx qy qz qw": 7, "matrix": 16, "matrix by columns": 16}
"""How many numbers each layout has; a matrix may also be given by its upper three rows."""


class CameraNumbers(Schema):
    """A camera calibrated elsewhere; it is kept as it is."""

    width: int = Field(ge=16, description="of the images [px]")
    height: int = Field(ge=16, description="of the images [px]")
    fx: float = Field(gt=0, description="focal length [px]")
    fy: float = Field(gt=0, description="focal length [px]")
    cx: float = Field(description="principal point [px]")
    cy: float = Field(description="principal point [px]")
    distortion: list[float] = Field(
        default_factory=list, max_length=8, description="k1 k2 p1 p2 k3 k4 k5 k6, as many as there are"
    )
    first_pixel: float = Field(
        default=0.0,
        ge=0,
        le=0.5,
        multiple_of=0.5,
        description="where the centre of the first pixel is: 0 for OpenCV and ViSP [px]",
    )

    def camera(self) -> Camera:
        """In our pixel coordinates."""
        centre = np.array([self.cx, self.cy]) + conventions.OPENCV_PIXEL_SHIFT - self.first_pixel
        bent = dict(zip(DISTORTION, self.distortion, strict=False))
        return Camera(self.width, self.height, self.fx, self.fy, float(centre[0]), float(centre[1]), **bent)


class Description(Schema):
    """How a folder of images and poses is to be read."""

    format: Literal["koala-import"] = Field(default="koala-import", description="what this file is")
    version: Literal[1] = Field(default=1, description="version of this format")
    images: str = Field(description="pattern of the images in the folder, with one *, which names the view")
    poses: str = Field(
        description="pattern of the pose files, with one *, or the one file that holds all poses (.csv .yaml .json)"
    )
    key: str = Field(default="", description="where the numbers are in a YAML or JSON file; a.b for b inside a")
    layout: Literal["x y z rx ry rz", "x y z qw qx qy qz", "x y z qx qy qz qw", "matrix", "matrix by columns"] = Field(
        description="meaning and order of the numbers of a pose"
    )
    length: Literal["m", "mm"] = Field(default="m", description="unit of lengths")
    angle: Literal["rad", "deg"] = Field(default="rad", description="unit of rotation vectors")
    inverse: bool = Field(default=False, description="true where the poses are flange_from_base; else base_from_flange")
    eye_to_hand: bool = Field(default=False, description="true where the camera stands beside the arm and holds still")
    board: Board = Field(description="the target: type, squares_x, squares_y, square_length_m, ...")
    camera: CameraNumbers | None = Field(default=None, description="a camera calibrated elsewhere; null: estimated along")

    @model_validator(mode="after")
    def _one_star(self) -> Self:
        if self.images.count("*") != 1 or self.poses.count("*") > 1:
            raise ValueError("images needs exactly one * in its pattern, poses at most one")
        return self


def describes(folder: Path, description: Path | None) -> bool:
    """Whether `folder` is to be imported rather than opened as a recording."""
    return description is not None or (Path(folder) / DESCRIPTION).is_file()


def load_description(folder: Path, description: Path | None = None) -> Description:
    """The description in `description`, or in the folder itself. Raises UsageError where it is missing or wrong."""
    return load_yaml(Path(folder) / DESCRIPTION if description is None else configs.find("imports", description), Description)


def observe_folder(
    folder: Path, description: Path | None = None, *, seen: Callable[[str], None] = lambda words: None
) -> tuple[TargetSession, Camera | None]:
    """Find the target in a recording or in a folder to import, and the camera that the import brings.

    Raises:
        UsageError: the folder is neither.
        KoalaError: what `observe_recording` and `import_session` raise.
    """
    imported = _imported(folder, description)
    if imported is None:
        return observe_recording(folder, seen=seen), None
    return import_session(folder, imported, seen=seen), imported.camera.camera() if imported.camera else None


def count_views(folder: Path, description: Path | None = None) -> int:
    """Number of images that `observe_folder` searches."""
    imported = _imported(folder, description)
    return len(Recording.open(folder).frames) if imported is None else len(matching(folder, imported.images))


def _imported(folder: Path, description: Path | None) -> Description | None:
    """How to read a folder to import; None for a recording."""
    if describes(folder, description):
        return load_description(folder, description)
    if folder.is_dir() and not (folder / MANIFEST).is_file():
        why = f"it has neither {MANIFEST} nor {DESCRIPTION}"
        remedy = "describe images and poses in a file, see docs/calibration.md, and give it as --import"
        raise UsageError("is neither a recording nor a folder to import", where=folder, why=why, remedy=remedy)
    return None


def import_session(folder: Path, description: Description, *, seen: Callable[[str], None] = lambda words: None) -> TargetSession:
    """Find the target in the images of a folder, and read the arm's pose of each.

    Raises:
        UsageError: no image or no pose of an image is there.
        DatasetError, CalibrationError: a pose cannot be what the description says.
        TargetError: the target is in no image.
    """
    folder = Path(folder)
    board = check_markers(description.board, where="description, board")
    images = matching(folder, description.images)
    if not images:
        raise UsageError(
            "no images found", where=folder, why=f"nothing matches {description.images!r}", remedy="correct 'images'"
        )
    numbers = _numbers(folder, description, images)
    views = [
        (name, path, as_pose(numbers[name], description, where=f"{folder}, pose of view {name}")) for name, path in images.items()
    ]
    provenance = {
        "folder": str(folder.resolve()),
        "board": board.to_json(),
        "frames_sha256": "+".join(files.sha256(path)[:12] for path in images.values()),
    }
    return observe(board, views, provenance=provenance, seen=seen, eye_to_hand=description.eye_to_hand)


def matching(folder: Path, pattern: str) -> dict[str, Path]:
    """Files by what the * of the pattern stands for; numbers sort as numbers."""
    before, after = pattern.split("*")
    found = {}
    for path in folder.glob(pattern):
        name = path.relative_to(folder).as_posix()
        found[name[len(before) : len(name) - len(after)]] = path
    return dict(sorted(found.items(), key=lambda item: (len(item[0]), item[0]) if item[0].isdigit() else (0, item[0])))


def _numbers(folder: Path, description: Description, images: dict[str, Path]) -> dict[str, list[float]]:
    """The numbers of each view's pose."""
    if "*" in description.poses:
        paths = matching(folder, description.poses)
        found = {name: _inside(_read(path), description.key, path) for name, path in paths.items()}
    else:
        path = folder / description.poses
        found = (
            _csv(path, description)
            if path.suffix.lower() == ".csv"
            else _table(_inside(_read(path), description.key, path), path)
        )
        by_file = {file.name: name for name, file in images.items()}
        found = {by_file.get(Path(name).name, name): values for name, values in found.items()}
    missing = [name for name in images if name not in found]
    if missing:
        raise UsageError(
            "images without a pose",
            where=folder,
            why=", ".join(missing[:5]) + (", ..." if len(missing) > 5 else ""),
            remedy=f"correct 'poses' ({description.poses})",
        )
    result = {}
    for name in images:
        try:
            result[name] = np.asarray(found[name], np.float64).ravel().tolist()
        except (TypeError, ValueError):
            raise DatasetError("pose is not made of numbers", where=f"{folder}, view {name}", why=str(found[name])[:80]) from None
    return result


def _read(path: Path) -> Any:
    """Content of a YAML or JSON file."""
    if path.suffix.lower() == ".json":
        return files.read_json(path)
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError("no such file", where=path, remedy="correct 'poses'") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise DatasetError("is not valid YAML", where=path, why=str(error)) from None


def _inside(content: Any, key: str, path: Path) -> Any:
    for part in key.split(".") if key else []:
        if not isinstance(content, dict) or part not in content:
            keys = sorted(map(str, content)) if isinstance(content, dict) else "no mapping"
            raise DatasetError(f"no key {part!r}", where=path, why=f"it has {keys}", remedy="correct 'key'")
        content = content[part]
    return content


def _table(content: Any, path: Path) -> dict[str, Any]:
    """Numbers by image name from a list of entries or from a mapping."""
    if isinstance(content, dict):
        return {str(name): values for name, values in content.items()}
    try:
        return {str(entry["image"]): entry["pose"] for entry in content}
    except (TypeError, KeyError) as error:
        raise DatasetError(
            "is no list of poses",
            where=path,
            why=f"{type(error).__name__} {error}",
            remedy="write entries {image: NAME, pose: [...]}",
        ) from None


def _csv(path: Path, description: Description) -> dict[str, list[str]]:
    """Numbers by image name from a CSV file with a header."""
    names = description.layout.split() if "matrix" not in description.layout else [f"m{r}{c}" for r in range(4) for c in range(4)]
    try:
        with open(path, newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            columns = reader.fieldnames or []
            if "m33" not in columns:
                names = [name for name in names if not name.startswith("m3")]
            absent = [name for name in ["image", *names] if name not in columns]
            if absent:
                raise DatasetError(f"no column {absent[0]!r}", where=path, why=f"it has {', '.join(columns) or 'none'}")
            return {row["image"]: [row[name] for name in names] for row in reader}
    except FileNotFoundError:
        raise UsageError("no such file", where=path, remedy="correct 'poses'") from None


def as_pose(numbers: Sequence[float], description: Description, *, where: object) -> Array:
    """(4, 4) base_from_flange [m] out of the numbers of a file.

    Raises:
        DatasetError: not as many numbers as the layout has, not finite, left-handed, no rotation.
        CalibrationError: numbers that betray another unit or order than the description says.
    """
    values, layout = np.asarray(numbers, np.float64), description.layout
    if len(values) != LAYOUTS[layout] and not ("matrix" in layout and len(values) == 12):
        raise DatasetError(f"pose has {len(values)} numbers", where=where, why=f"layout {layout!r} has {LAYOUTS[layout]}")
    if not np.isfinite(values).all():
        raise DatasetError("pose is not finite", where=where, why="it holds NaN or infinity", remedy="remove the view")
    unit = 1e-3 if description.length == "mm" else 1.0
    matrix = _from_matrix(values, layout, where) if "matrix" in layout else _from_vector(values, description, where)
    matrix = matrix.copy()
    matrix[:3, 3] *= unit
    if np.abs(matrix[:3, 3]).max() > 20:
        raise CalibrationError(
            "arm's position is not credible",
            where=where,
            why=f"{np.abs(matrix[:3, 3]).max():.4g} m from its base",
            remedy="millimetres? then say length: mm",
        )
    return pose.inverse(matrix) if description.inverse else matrix


def _from_vector(values: Array, description: Description, where: object) -> Array:
    if description.layout == "x y z rx ry rz":
        turn = np.deg2rad(values[3:]) if description.angle == "deg" else values[3:]
        if np.linalg.norm(turn) > 2 * np.pi + 1e-6:
            raise CalibrationError(
                "rotation vector is longer than a full turn",
                where=where,
                why=f"{np.linalg.norm(turn):.4g} rad",
                remedy="degrees? then say angle: deg",
            )
        return pose.from_rotation_vector(turn, values[:3])
    quaternion = values[3:] if description.layout.endswith("qz") else np.roll(values[3:], 1)
    if abs(np.linalg.norm(quaternion) - 1) > 1e-2:
        raise CalibrationError(
            "quaternion is not of unit length",
            where=where,
            why=f"its length is {np.linalg.norm(quaternion):.4g}",
            remedy="check layout and file",
        )
    return pose.from_quaternion(quaternion, values[:3])


def _from_matrix(values: Array, layout: str, where: object) -> Array:
    rows = values.reshape(-1, 4) if layout == "matrix" or len(values) == 12 else values.reshape(4, 4).T
    if len(values) == 12 and layout != "matrix":
        rows = values.reshape(4, 3).T
    if len(rows) == 4 and not np.allclose(rows[3], [0, 0, 0, 1], atol=1e-6):
        other = "matrix by columns" if layout == "matrix" else "matrix"
        hint = f"it is stored the other way: say layout: {other}" if np.allclose(rows[:, 3], [0, 0, 0, 1], atol=1e-6) else ""
        raise CalibrationError("last row of the pose is not 0 0 0 1", where=where, why=str(rows[3].tolist()), remedy=hint)
    return pose.checked(rows, where=where)
