"""From matches to poses, lenses and points: pycolmap's incremental mapping and a last adjustment with all lens parameters.

Mapping can find several models of groups of pictures, which may share some. The largest is kept; the others are only counted.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.progress import Step, ignore

if TYPE_CHECKING:
    import pycolmap

SMALLEST = 3
"""Smallest number of pictures of a group."""
FEW = 8
LEAST_TURN = np.deg2rad(4.0)
"""A camera with fewer pictures, or one that turns less than this about a second axis (RMS), keeps one focal length
and one coefficient of distortion: where it only walks around at one height, a wrong principal point looks like another height."""
LARGEST_PX = 2.0
"""Observations further than this from their projected point are dropped at the end [px of the picture that was searched]."""
LEAST_ANGLE_DEG = 1.5
"""Points whose rays meet at smaller angles are dropped."""
GROUPS = "groups.json"
"""File beside a model: the names of the pictures of each group, the largest first."""

Groups = list[list[str]]


def build(database: Path, pictures: Path, out: Path, colours: Mapping[str, NDArray[np.uint8]], *, done: Step = ignore) -> Groups:
    """Write the largest model of the pictures in `database` to the new folder `out`, all or nothing.

    Args:
        database: with matches.
        pictures: folder of the pictures, which are not read.
        out: folder of the model, and of `GROUPS`.
        colours: (n, 3) of each picture's features, by its file.
        done: called after each picture that is placed.

    Returns:
        The files of each group of pictures, the largest first; nothing where no two pictures overlap enough.
    """
    import pycolmap

    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)  # errors come back as exceptions or empty results
    with files.atomic_folder(out) as folder, tempfile.TemporaryDirectory(dir=out.parent) as temporary:
        found = pycolmap.incremental_mapping(
            database, pictures, temporary, _options(), initial_image_pair_callback=done, next_image_callback=done
        )
        models = sorted(found.values(), key=lambda model: (-model.num_reg_images(), -model.num_points3D()))
        groups = [sorted(model.images[number].name for number in model.reg_image_ids()) for model in models]
        if models:
            refine(models[0])
            _paint(models[0], colours)
            models[0].write_binary(folder)
        files.write_json(folder / GROUPS, groups)
    return groups


def read_groups(out: Path) -> Groups | None:
    """The groups that `build` wrote; None where it has not."""
    path = out / GROUPS
    return [[str(name) for name in group] for group in files.read_json(path)] if path.is_file() else None


def refine(model: "pycolmap.Reconstruction") -> None:
    """Adjust everything once more, with a second coefficient of distortion and the principal point where pictures fix them.

    Mapping has few parameters and can start from a guess; this starts close to the truth. Decentring is left out, since it can
    hardly be told from a shift of the principal point. Observations that stay wrong are dropped.
    """
    import pycolmap

    plain = {number for number in model.cameras if not _is_well_seen(model, number)}
    for number, camera in model.cameras.items():
        if number not in plain:
            camera.model, camera.params = pycolmap.CameraModelId.RADIAL, [*camera.params, 0.0]
    _adjust(model, set(), principal_point=False)
    if len(plain) < len(model.cameras):
        _adjust(model, plain, principal_point=True)
    pycolmap.ObservationManager(model).filter_all_points3D(LARGEST_PX, LEAST_ANGLE_DEG)
    _adjust(model, plain, principal_point=len(plain) < len(model.cameras))
    model.update_point_3d_errors()


def _is_well_seen(model: "pycolmap.Reconstruction", camera: int) -> bool:
    """Whether a camera's pictures are enough, and turned about enough axes, for all parameters of its lens."""
    own = [image.cam_from_world().matrix()[:, :3].T for image in model.images.values() if image.camera_id == camera]
    return len(own) >= FEW and second_turn(np.stack(own)) >= LEAST_TURN


def second_turn(rotations: ArrayLike) -> float:
    """Root mean square of the turns between all pairs of (n, 3, 3) rotations about the second of their principal axes [rad].

    0 where all turn about one axis, as on a turntable or on a circle around an object.
    """
    matrices = np.asarray(rotations, np.float64)
    first, second = np.triu_indices(len(matrices), 1)
    turns = pose.rotation_vector(matrices[first] @ np.swapaxes(matrices[second], 1, 2))
    return float(np.sqrt(max(np.linalg.eigvalsh(turns.T @ turns / len(turns))[1], 0.0)))


def _adjust(model: "pycolmap.Reconstruction", constant: set[int], *, principal_point: bool) -> None:
    """One bundle adjustment of all pictures; the cameras `constant` keep their lens."""
    import pycolmap

    options = pycolmap.BundleAdjustmentOptions(refine_principal_point=principal_point, print_summary=False)
    config = pycolmap.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    for number in constant:
        config.set_constant_cam_intrinsics(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()


def _paint(model: "pycolmap.Reconstruction", colours: Mapping[str, NDArray[np.uint8]]) -> None:
    """Give each point the mean colour of its features."""
    names = {number: image.name for number, image in model.images.items()}
    for point in model.points3D.values():
        point.color = np.mean([colours[names[e.image_id]][e.point2D_idx] for e in point.track.elements], axis=0).astype(np.uint8)


def _options() -> "pycolmap.IncrementalPipelineOptions":
    """Settings of mapping, with fixed seeds."""
    import pycolmap

    options = pycolmap.IncrementalPipelineOptions(min_model_size=SMALLEST, extract_colors=False, random_seed=0)
    options.mapper.random_seed = options.triangulation.random_seed = 0
    return options
