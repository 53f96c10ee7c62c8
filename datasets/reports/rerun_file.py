"""Files for Rerun's viewer (.rrd): poses, cameras, pictures, points, lines, meshes and curves over time.

Entities are named by paths; what is below an entity moves with it. Poses are `parent_from_child`. Cameras have OpenCV's axes
(Rerun's RDF) and our pixels, which are Rerun's too: the first one's centre is (0.5, 0.5). Rerun's cameras are pinholes: pictures
are shown as they were taken, with their distortion.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images

SUFFIX = ".rrd"
SIDE, QUALITY = 960, 85  # longest side of pictures [px], and quality of their JPEGs


def require(path: Path | None) -> None:
    """Raise before the work begins where a file is wanted that cannot be written after it: UsageError, ModuleNotFoundError."""
    if path is None:
        return
    import rerun  # noqa: F401  names the extra where it is missing

    if path.suffix != SUFFIX:
        raise UsageError("is not named as a file of Rerun", where=path, remedy=f"end the name in {SUFFIX}")
    files.refuse_existing(path)


class RerunFile:
    """A file that is being written; made by `rerun_file`. What is logged belongs to the time that `at` has set."""

    def __init__(self, path: Path, title: str) -> None:
        import rerun

        self._rerun: Any = rerun
        self._stream = rerun.RecordingStream(f"koala {title}")
        self._stream.save(path)
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        self._stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def close(self) -> None:
        """Write what is still in memory."""
        self._stream.flush()
        self._stream.disconnect()

    def at(self, **counts: int) -> None:
        """Set the time of what follows: `view=3`, `step=100`."""
        for timeline, number in counts.items():
            self._stream.set_time(timeline, sequence=number)

    def at_second(self, seconds: float) -> None:
        """Set the time of what follows on the clock of the session [s]."""
        self._stream.set_time("time", duration=seconds)

    def frame(self, entity: str, parent_from_child: ArrayLike, *, always: bool = False, axes_m: float = 0.0) -> None:
        """A (4, 4) pose, with arrows of a length for its axes."""
        matrix = np.asarray(parent_from_child, np.float64)
        self._log(entity, self._rerun.Transform3D(translation=matrix[:3, 3], mat3x3=matrix[:3, :3]), always=always)
        if axes_m:
            self._log(entity, self._rerun.TransformAxes3D(axes_m), always=always)

    def camera(self, entity: str, camera: Camera, *, always: bool = True, length_m: float = 0.05) -> None:
        """Intrinsics, and how long the pyramid is drawn. Pictures below the entity have this size, `shown(camera)`."""
        seen = camera.within(SIDE)
        size, axes = (seen.width, seen.height), self._rerun.ViewCoordinates.RDF
        pinhole = self._rerun.Pinhole(
            image_from_camera=seen.matrix, resolution=size, camera_xyz=axes, image_plane_distance=length_m
        )
        self._log(entity, pinhole, always=always)

    def picture(self, entity: str, path: Path, camera: Camera, *, always: bool = False) -> None:
        """An image file, no larger than `SIDE`."""
        seen = camera.within(SIDE)
        values = images.read(path)
        rgb = np.repeat(values[..., :1], 3, -1) if values.shape[-1] < 3 else values[..., :3]
        small = cv2.resize(np.ascontiguousarray(rgb), (seen.width, seen.height), interpolation=cv2.INTER_AREA)
        shown = self._rerun.Image(np.uint8(np.rint(255 * np.clip(small, 0, 1)))).compress(jpeg_quality=QUALITY)
        self._log(entity, shown, always=always)

    def corners(self, entity: str, pixels: ArrayLike, residuals: ArrayLike | None, camera: Camera) -> None:
        """(n, 2) corners in a picture [px], and (n, 2) from where they were predicted to where they are."""
        scale = np.array([camera.within(SIDE).width / camera.width, camera.within(SIDE).height / camera.height])
        places = np.asarray(pixels, np.float64) * scale
        self._log(f"{entity}/found", self._rerun.Points2D(places, radii=1.5, colors=(44, 160, 44)))
        vectors = np.zeros((0, 2)) if residuals is None else np.asarray(residuals, np.float64) * scale
        origins = np.zeros((0, 2)) if residuals is None else places - vectors
        self._log(f"{entity}/residuals", self._rerun.Arrows2D(vectors=vectors, origins=origins, colors=(214, 39, 40)))

    def capsule(self, entity: str, length_m: float, radius_m: float, colour: tuple[int, int, int]) -> None:
        """A capsule from the origin of the entity along its z."""
        solid = self._rerun.components.FillMode.Solid
        shape = self._rerun.Capsules3D(lengths=[length_m], radii=[radius_m], colors=colour, fill_mode=solid)
        self._log(entity, shape, always=True)

    def box(self, entity: str, corners: ArrayLike, colour: tuple[int, int, int]) -> None:
        """The edges of a box with (2, 3) lowest and highest corners [m]."""
        low, high = np.asarray(corners, np.float64)
        self._log(entity, self._rerun.Boxes3D(mins=[low], sizes=[high - low], colors=colour), always=True)

    def line(self, entity: str, points: ArrayLike, colour: tuple[int, int, int], *, always: bool = False) -> None:
        """A line through (n, 3) points [m]."""
        self._log(entity, self._rerun.LineStrips3D([np.asarray(points)], colors=colour), always=always)

    def mesh(
        self,
        entity: str,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        colours: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        always: bool = False,
    ) -> None:
        """A mesh of (n, 3) vertices [m] and (m, 3) triangles, with (n, 3 or 4) colours in bytes and (n, 3) normals."""
        shape = self._rerun.Mesh3D(
            vertex_positions=vertices, triangle_indices=faces, vertex_colors=colours, vertex_normals=normals
        )
        self._log(entity, shape, always=always)

    def numbers(self, entity: str, values: dict[str, float]) -> None:
        """Points of curves, by name."""
        for name, value in values.items():
            self._log(f"{entity}/{name}", self._rerun.Scalars(value))

    def text(self, entity: str, words: str) -> None:
        """A document in Markdown."""
        self._log(entity, self._rerun.TextDocument(words, media_type="text/markdown"), always=True)

    def _log(self, entity: str, what: Any, *, always: bool = False) -> None:
        parts: list[Any] = [part.replace(" ", "_") for part in entity.strip("/").split("/")]  # a list is escaped
        self._stream.log(parts, what, static=always)


@contextmanager
def rerun_file(path: Path, title: str) -> Iterator[RerunFile]:
    """A file that is complete when this ends. Also after an error or Ctrl-C it holds what was logged until then."""
    ended: BaseException | None = None
    with files.atomic_path(path) as temporary:
        opened = RerunFile(temporary, title)
        try:
            yield opened
        except BaseException as error:
            ended = error
        finally:
            opened.close()
    if ended is not None:
        raise ended
