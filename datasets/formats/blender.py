"""Blender / NeRF-synthetic folders: `transforms_{train,val,test}.json`, RGBA images, OpenGL camera axes.

`camera_angle_x` is the horizontal field of view; the principal point is the centre. Shiny Blender's `_normal.png` and
`_alpha.png` beside an image are its truth. `koala.json`, where it lies beside, says what this layout cannot.
"""

from pathlib import Path

from datasets import files
from datasets.errors import KoalaError
from datasets.formats import assemble, opengl, sidecar
from datasets.scene import SPLITS, Scene, View

TRUTH = {"normals": "_normal.png", "alpha": "_alpha.png"}
"""Suffix, after the image's name, of each truth map that the layout knows."""


def detect(folder: Path) -> bool:
    """True for a folder with `transforms_train.json`."""
    return (folder / "transforms_train.json").is_file()


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None,
         problems: list[KoalaError] | None = None) -> Scene:  # fmt: skip
    """Read a Blender folder. Without a test file every `hold_out`-th training view is a test view."""
    gathering = assemble.Gathering(folder, problems)
    present = [split for split in SPLITS if (folder / f"transforms_{split}.json").is_file()]
    for split in present:
        _gather(gathering, split)
    views = gathering.finished(listed_in="transforms_*.json")
    known = sidecar.read(folder)
    if known is not None:
        return sidecar.restore(known, views, folder, notes=tuple(gathering.notes))
    if not any(view.split == "test" for view in views):
        train = assemble.hold_out([view for view in views if view.split == "train"], hold_out)
        views = (*train, *(view for view in views if view.split != "train"))
    return assemble.scene(gathering, views, provenance={"format": "blender", "source": str(folder.absolute())})


def _gather(gathering: assemble.Gathering, split: str) -> None:
    source = gathering.folder / f"transforms_{split}.json"
    content = files.read_json(source)
    for frame in opengl.frames_of(content, where=source):
        where = f"{source}, {frame['file_path']}"
        try:
            files.inside(gathering.folder, frame["file_path"], where=where)
            image = opengl.image_path(gathering.folder, frame["file_path"])
            if image is None:
                gathering.missing.append(frame["file_path"])
                continue
            camera = opengl.camera(content, frame, image, where=where)
            truth = {key: image.with_name(image.stem + end) for key, end in TRUTH.items()}
            truth = {key: path for key, path in truth.items() if path.is_file()}
            name = image.relative_to(gathering.folder).with_suffix("").as_posix()
            gathering.views.append(View(name, camera, opengl.world_from_camera(frame, where=where), split, image, truth=truth))
        except KoalaError as error:
            gathering.complain(error)
