"""pycolmap's database: cameras, pictures, features, and the matches between pictures that obey one two-view geometry.

Matching goes through the pairs in blocks. What is in the database is not computed again, so interrupted matching continues.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.progress import Count, ignore
from koala3d.datasets.process.pictures.features import PictureFeatures
from koala3d.datasets.process.pictures.photographs import Photograph
from koala3d.datasets.process.poses.pairs import Pairs

if TYPE_CHECKING:
    import pycolmap

GUESS = 1.2
"""Focal length where nothing is known, in units of the longer side, as in COLMAP."""
BLOCK = 64
"""Pairs that are matched at a time."""
MOST_ALIKE = 40
"""Pictures that a vocabulary tree finds for each."""
FEWEST_MATCHES = 15
"""Smallest number of matches of one geometry between two pictures."""


Lens = tuple[str, list[float], bool]
"""COLMAP's name of a lens model, its parameters, and whether the focal length is known."""


@dataclass(frozen=True)
class Picture:
    """A picture as the database has it."""

    number: int
    """From 1 on."""
    file: str
    """Below the folder of images, without spaces."""
    photograph: Photograph
    camera: int
    """Pictures of one camera share its number."""
    features: PictureFeatures


def require_library() -> None:
    """Raise ModuleNotFoundError where pycolmap is not installed: before anything is computed, not halfway."""
    import pycolmap  # noqa: F401


def write(path: Path, pictures: Sequence[Picture], lens: Lens | None = None) -> None:
    """Write a new database with cameras and features, atomically. Its pixels are those of the pictures that were searched.

    `lens`: COLMAP's name and parameters of the lens if it is known; else each camera's is guessed.
    """
    import pycolmap

    with files.atomic_path(path) as temporary, pycolmap.Database.open(temporary) as stored:
        rigs = {}
        for picture in pictures:
            if picture.camera not in rigs:
                rigs[picture.camera] = _write_camera(stored, picture, lens or _guessed(picture))
            camera_id, rig_id = rigs[picture.camera]
            image_id = stored.write_image(pycolmap.Image(name=picture.file, camera_id=camera_id))
            assert image_id == picture.number
            frame = pycolmap.Frame(rig_id=rig_id)
            frame.add_data_id(stored.read_image(image_id).data_id)
            stored.write_frame(frame)
            stored.write_keypoints(image_id, picture.features.pixels)
            kind = pycolmap.FeatureExtractorType.SIFT
            stored.write_descriptors(image_id, pycolmap.FeatureDescriptors(kind, picture.features.descriptors))


def _guessed(picture: Picture) -> Lens:
    """The lens that a photograph's header states, or a usual one."""
    width, height, photograph = picture.features.width, picture.features.height, picture.photograph
    stated = photograph.focal_px * width / photograph.width if photograph.focal_px else None
    return "SIMPLE_RADIAL", [stated or GUESS * max(width, height), width / 2, height / 2, 0.0], stated is not None


def _write_camera(stored: "pycolmap.Database", picture: Picture, lens: Lens) -> tuple[int, int]:
    """Numbers of a new camera and of the rig that it is alone on."""
    import pycolmap

    model, values, is_known = lens
    camera = pycolmap.Camera(model=model, width=picture.features.width, height=picture.features.height, params=values)
    camera.has_prior_focal_length = is_known
    camera.camera_id = stored.write_camera(camera)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(camera.sensor_id)
    return camera.camera_id, stored.write_rig(rig)


def by_vocabulary(database: Path, vocabulary: Path) -> Pairs:
    """Pairs that COLMAP's vocabulary tree, a file for pycolmap, finds alike. Raises UsageError where it cannot be read."""
    import pycolmap

    options = pycolmap.VocabTreePairingOptions(vocab_tree_path=vocabulary, num_images=MOST_ALIKE)
    try:
        with pycolmap.Database.open(database) as stored:
            ends = pycolmap.VocabTreePairGenerator(options, stored).all_pairs()
    except (RuntimeError, ValueError) as error:
        raise UsageError("is no vocabulary tree", where=vocabulary, why=str(error).splitlines()[0]) from None
    return sorted({(min(a, b) - 1, max(a, b) - 1) for a, b in ends if a != b})


def match(path: Path, pictures: Sequence[Picture], pairs: Pairs, *, done: Count = ignore) -> None:
    """Match features of `pairs`, indices of `pictures`, and keep those that obey a two-view geometry.

    Pairs that are in the database already are left as they are. `done` is called with the pairs finished and their total.
    """
    import pycolmap

    pycolmap.logging.minloglevel = 2  # errors come back as exceptions
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False)
    geometry = pycolmap.TwoViewGeometryOptions(min_num_inliers=FEWEST_MATCHES)
    geometry.ransac.random_seed = 0
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        block = Path(folder) / "pairs.txt"
        for first in range(0, len(pairs), BLOCK):
            chosen = pairs[first : first + BLOCK]
            block.write_text("".join(f"{pictures[i].file} {pictures[j].file}\n" for i, j in chosen))
            listed = pycolmap.ImportedPairingOptions(match_list_path=block)
            pycolmap.match_image_pairs(path, matching, listed, geometry, pycolmap.Device.cpu)
            done(min(first + BLOCK, len(pairs)), len(pairs))


def links(path: Path) -> dict[tuple[int, int], int]:
    """Number of matches of each pair of pictures, by their numbers, that obey a two-view geometry."""
    import pycolmap

    with pycolmap.Database.open(path) as stored:
        pairs, counts = stored.read_two_view_geometry_num_inliers()
        ends = [pycolmap.pair_id_to_image_pair(pair) for pair in pairs]
    return {(int(a), int(b)): int(count) for (a, b), count in zip(ends, counts, strict=True) if count >= FEWEST_MATCHES}
