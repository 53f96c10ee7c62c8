"""Rendered scenes as folders that every command reads: images, cameras, and the true shape and light.

SCENE/images/ cameras.json               as any Koala scene: RGBA, straight alpha
SCENE/truth/normals|depth|alpha|diffuse|specular/    float maps of the test views; light is linear and premultiplied with alpha
SCENE/truth/object.ply                   the surface as a mesh [m]
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.formats import load_scene, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds
from koala3d.reconstruct.rendered.shiny import EDITION, RADIUS_M
from koala3d.reconstruct.rendered.stages import STAGES
from koala3d.reconstruct.rendered.surfaces import MESH_CELLS, surface_of
from koala3d.reconstruct.rendered.tracer import Tracer
from koala3d.reconstruct.rendered.views import camera_of

SIZE, TRAIN, TEST = 200, 60, 20
"""Width and height of the images in pixels, and numbers of training and test views."""
MARGIN = 0.04  # margin of the object's box on each side, as a share of its size


def provide(
    name: str,
    out: Path,
    *,
    size: int = SIZE,
    train: int = TRAIN,
    test: int = TEST,
    done: Callable[[], None] = lambda: None,
) -> bool:
    """`write` a scene (seed 0) into `out` unless it exists. Returns whether it was written.

    Raises UsageError: `out` holds something else.
    """
    found = load_scene(out.absolute()) if out.is_dir() and any(out.iterdir()) else None
    if found is not None and found.provenance == _provenance(name, size, 0):
        counts = tuple(sum(view.split == split for view in found.views) for split in ("train", "test"))
        if counts == (train, test):
            return False
    write(name, out, size=size, train=train, test=test, done=done)
    return True


def _provenance(name: str, size: int, seed: int) -> dict[str, Any]:
    return {"format": "bench", "scene": name, "edition": EDITION, "size": size, "seed": seed}


def write(
    name: str,
    out: Path,
    *,
    size: int = SIZE,
    train: int = TRAIN,
    test: int = TEST,
    seed: int = 0,
    done: Callable[[], None] = lambda: None,
) -> Scene:
    """Render one of `STAGES` into the new folder `out`.

    Args:
        size: width and height of the images in pixels.
        seed: of the camera positions. The scene itself does not change.
        done: called after each view.

    Raises UsageError: unknown scene, or `out` is not empty.
    """
    if name not in STAGES:
        raise UsageError(f"there is no scene '{name}'", remedy=nearest(name, STAGES))
    stage = STAGES[name]
    tracer, camera = stage.tracer(), camera_of(size)
    looked = stage.views(tracer)
    with tempfile.TemporaryDirectory() as folder:
        views = []
        for index, (world_from_camera, split) in enumerate(stage.shots(train, test, seed)):
            view = View(f"{index:03d}", camera, world_from_camera, split, Path())
            maps = looked.maps(camera, world_from_camera, stage.lamps_from_scene(world_from_camera))
            views.append(_written(view, maps, Path(folder)))
            done()
        box = write_mesh(tracer, Path(folder) / "object.ply")
        box = box + MARGIN * (box[1] - box[0]) * [[-1.0], [1.0]]
        about = _provenance(name, size, seed)
        scene = Scene(name, tuple(views), *bounds.depth_range(views, box), box, "white", metric=True, provenance=about)
        save_scene(scene, out, "koala", extra={"truth/object.ply": Path(folder) / "object.ply"})
    return scene


def _written(view: View, maps: dict[str, NDArray[np.float32]], folder: Path) -> View:
    """The view with its image and, for a test view, its true maps in files."""
    light = (maps["diffuse"] + maps["specular"]) / np.maximum(maps["alpha"], 1e-6)
    image = folder / f"{view.name}.png"
    images.write(image, np.concatenate([images.srgb_from_linear(light), maps["alpha"]], -1))
    truth = {}
    for channel, values in maps.items() if view.split == "test" else ():
        truth[channel] = folder / f"{view.name}_{channel}.exr"
        images.write(truth[channel], values)
    return View(view.name, view.camera, view.world_from_camera, view.split, image, truth=truth)


def write_mesh(tracer: Tracer, path: Path, *, cells: int = MESH_CELLS) -> NDArray[np.float64]:
    """The surface as a mesh [m]. Returns: (2, 3) lower and upper corner of its box."""
    import trimesh

    vertices, _, faces = surface_of(tracer, cells)
    mesh = trimesh.Trimesh(RADIUS_M * vertices, faces, process=False)
    mesh.export(path)
    return np.asarray(mesh.bounds, np.float64)
