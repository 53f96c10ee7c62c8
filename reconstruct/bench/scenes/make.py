"""Shiny scenes as folders that every command reads: images, cameras, and the true shape and light.

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

from datasets.camera_model import Camera
from datasets.core.errors import UsageError, nearest
from datasets.formats import detect, load_scene, save_scene
from datasets.imaging import images
from datasets.scene import Scene, View
from datasets.structure import bounds
from reconstruct.bench.scenes.shiny import EDITION, RADIUS_M
from reconstruct.bench.scenes.stages import DISTANCE_M, STAGES
from reconstruct.bench.scenes.tracer import Tracer

SIZE, TRAIN, TEST = 200, 60, 20
"""Width and height of the images in pixels, and numbers of training and test views."""
HALF_FIELD = 0.118
"""Half the width of the field of view at the centre [m]."""
SAMPLES = 3  # rays per pixel along each axis
MARGIN = 0.04  # margin of the object's box on each side, as a share of its size
MESH_CELLS = 160  # cells per axis of the grid for marching cubes


def provide(
    name: str,
    out: Path,
    *,
    size: int = SIZE,
    train: int = TRAIN,
    test: int = TEST,
    format: str = "koala",
    done: Callable[[], None] = lambda: None,
) -> bool:
    """`write` a scene (seed 0) into `out` unless it exists. Returns whether it was written.

    Raises UsageError: `out` holds something else.
    """
    found = load_scene(out.absolute()) if out.is_dir() and any(out.iterdir()) else None
    if found is not None and found.provenance == _provenance(name, size, 0):
        counts = tuple(sum(view.split == split for view in found.views) for split in ("train", "test"))
        if counts == (train, test) and detect(out) == format:
            return False
    write(name, out, size=size, train=train, test=test, format=format, done=done)
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
    format: str = "koala",
    done: Callable[[], None] = lambda: None,
) -> Scene:
    """Render one of `STAGES` into the new folder `out`.

    Args:
        size: width and height of the images in pixels.
        seed: of the camera positions. The scene itself does not change.
        format: of the folder, one of `datasets.formats.WRITERS`.
        done: called after each view.

    Raises UsageError: unknown scene, or `out` is not empty.
    """
    if name not in STAGES:
        raise UsageError(f"there is no scene '{name}'", remedy=nearest(name, STAGES))
    stage = STAGES[name]
    tracer, camera = stage.tracer(), camera_of(size)
    with tempfile.TemporaryDirectory() as folder:
        views = []
        for index, (world_from_camera, split) in enumerate(stage.shots(train, test, seed)):
            view = View(f"{index:03d}", camera, world_from_camera, split, Path())
            maps = render_view(tracer, camera, world_from_camera, stage.lamps_from_scene(world_from_camera))
            views.append(_written(view, maps, Path(folder)))
            done()
        box = write_mesh(tracer, Path(folder) / "object.ply")
        box = box + MARGIN * (box[1] - box[0]) * [[-1.0], [1.0]]
        about = _provenance(name, size, seed)
        scene = Scene(name, tuple(views), *bounds.depth_range(views, box), box, "white", metric=True, provenance=about)
        save_scene(scene, out, format, extra={"truth/object.ply": Path(folder) / "object.ply"})
    return scene


def camera_of(size: int) -> Camera:
    """A pinhole camera whose field of view is `HALF_FIELD` to each side at `DISTANCE_M`."""
    focal = 0.5 * size * DISTANCE_M / HALF_FIELD
    return Camera(size, size, focal, focal, size / 2, size / 2)


def render_view(
    tracer: Tracer,
    camera: Camera,
    world_from_camera: NDArray[np.float64],
    lamps_from_scene: NDArray[np.float64] | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Maps (size, size, channels) of one view, each pixel the mean of `SAMPLES` squared rays; see `Tracer.look`.

    "alpha", "depth" along z [m] and unit "normals" of the hit; "diffuse" and "specular" linear, premultiplied with alpha.
    """
    fine = camera.scaled(SAMPLES * camera.width, SAMPLES * camera.height)
    in_camera = fine.directions(fine.pixel_centres()).reshape(-1, 3)
    speed = np.linalg.norm(in_camera, axis=-1)
    directions = (in_camera / speed[:, None]) @ world_from_camera[:3, :3].T
    origins = np.broadcast_to(world_from_camera[:3, 3] / RADIUS_M, directions.shape)
    found = tracer.look(origins, directions, lamps_from_scene)
    found["depth"] = RADIUS_M * found.pop("t") / speed
    found["alpha"] = (found["depth"] > 0).astype(np.float32)
    maps = {name: _mean(values, camera) for name, values in found.items()}
    maps["depth"] = maps["depth"] / np.maximum(maps["alpha"], 1e-6)
    length = np.linalg.norm(maps["normals"], axis=-1, keepdims=True)
    maps["normals"] = np.where(length > 1e-3, maps["normals"] / np.maximum(length, 1e-3), 0)
    return {name: values.astype(np.float32) for name, values in maps.items()}


def _mean(values: NDArray, camera: Camera) -> NDArray[np.float64]:
    """(height, width, channels) mean of values over the rays of each pixel."""
    grid = values.reshape(camera.height, SAMPLES, camera.width, SAMPLES, -1)
    return grid.mean((1, 3), dtype=np.float64)


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
    """The surface as a mesh [m]: marching cubes, then its vertices are moved onto the surface along the normals.

    Returns:
        (2, 3) lower and upper corner of its box.
    """
    import trimesh
    from skimage.measure import marching_cubes

    axis = np.linspace(-1, 1, cells + 1, dtype=np.float32)
    slices = []
    for x in axis:
        y, z = np.meshgrid(axis, axis, indexing="ij")
        points = np.stack([np.full_like(y, x), y, z], -1).reshape(-1, 3)
        slices.append(tracer.measured(points)[0].reshape(y.shape))
    vertices, faces, _, _ = marching_cubes(np.stack(slices), 0.0, spacing=(2 / cells,) * 3)
    points = vertices.astype(np.float32) - 1
    for _ in range(3):
        distance, normal = tracer.measured(points)
        points = points - distance[:, None] * normal
    mesh = trimesh.Trimesh(RADIUS_M * points.astype(np.float64), faces, process=False)
    mesh.export(path)
    return np.asarray(mesh.bounds, np.float64)
