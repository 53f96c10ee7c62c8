"""nerfstudio and instant-ngp folders: one `transforms.json`, OpenGL camera axes, OpenCV distortion.

The world is that of the file: `applied_transform` and instant-ngp's `scale`, `offset` and `aabb_scale` are left alone.
"""

from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from datasets import files
from datasets.errors import DatasetError, KoalaError
from datasets.formats import assemble, opengl
from datasets.scene import SPLITS, Scene, View

FILE = "transforms.json"


def detect(folder: Path) -> bool:
    """True for a folder with `transforms.json`."""
    return (folder / FILE).is_file()


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None,
         problems: list[KoalaError] | None = None) -> Scene:  # fmt: skip
    """Read a nerfstudio folder; images that are listed and missing are left out and named in the notes.

    Views are sorted by file name. Without `train_filenames` and the like, every `hold_out`-th view is a test view.
    """
    source = folder / FILE
    content = files.read_json(source)
    gathering = assemble.Gathering(folder, problems)
    splits = _splits(content, where=source)
    for frame in sorted(opengl.frames_of(content, where=source), key=lambda frame: frame["file_path"]):
        try:
            _gather(gathering, content, frame, splits, images_folder)
        except KoalaError as error:
            gathering.complain(error)
    if any("depth_file_path" in frame for frame in content["frames"]):
        gathering.notes.append("the file's depth maps are not used")
    views = gathering.finished(listed_in=FILE)
    if not splits:
        views = assemble.hold_out(views, hold_out)
    if len({view.mask is None for view in views}) > 1:
        gathering.complain(DatasetError("only some frames have a mask_path", where=source, remedy="give all frames one, or none"))
        views = tuple(replace(view, mask=None) for view in views)
    return assemble.scene(gathering, views, provenance={"format": "nerfstudio", "source": str(folder.absolute())})


def _gather(gathering: assemble.Gathering, content: dict[str, Any], frame: dict[str, Any],
            splits: dict[str, str], images_folder: str | None) -> None:  # fmt: skip
    folder, listed = gathering.folder, frame["file_path"]
    where = f"{folder / FILE}, {listed}"
    file_path = listed if images_folder is None else f"{images_folder}/{PurePosixPath(listed).name}"
    files.inside(folder, file_path, where=where)
    image = opengl.image_path(folder, file_path)
    if image is None:
        gathering.missing.append(file_path)
        return
    camera = opengl.camera(content, frame, image, where=where)
    mask = files.inside(folder, frame["mask_path"], where=where) if frame.get("mask_path") else None
    name = PurePosixPath(listed).with_suffix("").as_posix().removeprefix("./")
    split = splits.get(listed, "train")
    gathering.views.append(View(name, camera, opengl.world_from_camera(frame, where=where), split, image, mask=mask))


def _splits(content: Any, *, where: object) -> dict[str, str]:
    """Split of each file path, where the file has such lists; empty where it has none."""
    if not isinstance(content, dict):
        raise DatasetError("holds no list of frames", where=where)
    listed = {split: content[f"{split}_filenames"] for split in SPLITS if f"{split}_filenames" in content}
    frames = {frame["file_path"] for frame in opengl.frames_of(content, where=where)}
    for split, names in listed.items():
        stray = sorted(set(names) - frames)
        if stray:
            raise DatasetError(f"{split}_filenames lists what is not among the frames", where=where, why=", ".join(stray[:5]))
    return {name: split for split, names in listed.items() for name in names}
