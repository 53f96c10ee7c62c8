"""What the simulated camera looks at: an object in the laboratory, or the calibration board.

Both are described in the frame of the table; `InBase` converts them to the base frame of the robot.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import SimulationError
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.sim.laboratory import textures
from koala3d.capture.sim.laboratory.board import BoardPicture
from koala3d.capture.sim.laboratory.lens import Lens, strips
from koala3d.capture.sim.laboratory.scenes import CARDS, Stage, check_name, stage
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.mitsuba_variant import variant
from koala3d.datasets.recording import UPRIGHT

Maps = dict[str, NDArray[np.floating]]
SAMPLES = 9
"""Light paths per pixel of the supersampled pinhole picture, four times as many per pixel of the image: noise of 38 dB."""
FULL_SAMPLES = 4  # the same without binning, where the sensor noise of a pixel is higher
FINE = 2  # samples of the true surfaces per pixel of the pinhole picture, along each axis
RAYS_AT_ONCE = 4_000_000
TRIAL = "koala3d.capture.sim.laboratory.renderer_trial"


class View(ABC):
    """What the lens sees, described in one frame, `world`. A picture that fills the lens has neither maps, object nor room."""

    @abstractmethod
    def radiance(self, lens: Lens, world_from_camera: NDArray[np.float64], seed: int, /) -> NDArray[np.float32]:
        """(height, width, 3) linear light on the pixels of the lens's camera, its mean over (n, 4, 4) poses of an exposure."""

    def truth(self, lens: Lens, world_from_camera: NDArray[np.float64], seed: int, /) -> Maps:
        """The true maps of the newest picture, see `SimulatedCamera.save_truth`."""
        return {}

    @abstractmethod
    def depth(self, camera: Camera, world_from_camera: NDArray[np.float64], seed: int, /) -> NDArray[np.float32]:
        """(height, width) depth along z of the first surface at each pixel of a pinhole [m]; 0 where there is none."""

    def mesh(self) -> Any:
        """The object [m], a trimesh; None without an object."""
        return None

    def light(self, burning: tuple[bool, ...], /) -> None:  # noqa: B027
        """Switch the lamps of the laboratory; without this call it is lit evenly."""

    def place_room(self, world_from_room: NDArray[np.float64], /) -> None:  # noqa: B027
        """Move what does not turn with the object, from where it stood at first, by a (4, 4) motion [m]."""


@dataclass
class InBase:
    """A view described in the table's frame, as a `View` in the robot's base frame.

    Where a turntable has turned the object, the view is described in the frame that turns with it. Truth is then in the frame in
    which the object stands: the base, with the turntable at angle zero.
    """

    view: View
    base_from_table: NDArray[np.float64]
    _base_from_object: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))

    def turn(self, base_from_object: NDArray[np.float64]) -> None:
        """Turn the object from where it stood at first by a (4, 4) motion in the base [m]; the room and its lamps stay."""
        if not np.array_equal(base_from_object, self._base_from_object):
            self._base_from_object = base_from_object
            self.view.place_room(pose.inverse(self.base_from_table) @ pose.inverse(base_from_object) @ self.base_from_table)

    def light(self, burning: tuple[bool, ...]) -> None:
        """See `View`."""
        self.view.light(burning)

    def radiance(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        return self.view.radiance(lens, self._from_base @ base_from_camera, seed)

    @property
    def _from_base(self) -> NDArray[np.float64]:
        """(4, 4) to the frame in which the view is described."""
        return pose.inverse(self._base_from_object @ self.base_from_table)

    def truth(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> Maps:
        """See `View`."""
        maps = self.view.truth(lens, self._from_base @ base_from_camera, seed)
        if "normals" in maps:
            maps["normals"] = maps["normals"] @ self.base_from_table[:3, :3].T.astype(np.float32)
        return maps

    def depth(self, camera: Camera, base_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        return self.view.depth(camera, pose.inverse(self.base_from_table) @ base_from_camera, seed)

    def mesh(self) -> Any:
        """See `View`."""
        mesh = self.view.mesh()
        return None if mesh is None else mesh.copy().apply_transform(self.base_from_table)


@dataclass
class ObjectView(View):
    """An object in the laboratory, rendered."""

    stage: Stage
    samples: int  # light paths per pixel of the pinhole picture
    _newest: NDArray[np.float32] | None = None

    @cached_property
    def _renderer(self) -> Any:
        chosen = variant(TRIAL)  # Mitsuba loads LLVM as it is imported: which one is decided before

        from koala3d.capture.sim.laboratory.renderer import Renderer

        return Renderer(self.stage, using=chosen)

    def radiance(self, lens: Lens, table_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        pictures = (
            self._renderer.radiance(lens.pinhole, moment, samples=self.samples, seed=(seed + i) % 2**32)
            for i, moment in enumerate(table_from_camera)
        )
        self._newest = _mean(pictures, len(table_from_camera))
        return lens.image(self._newest)

    def truth(self, lens: Lens, table_from_camera: NDArray[np.float64], seed: int) -> Maps:
        """Means over each pixel: normals and depth over the part that shows the object, light over the whole pixel."""
        if self._newest is None:
            raise SimulationError("no picture has been taken yet")
        means = self._surfaces(lens.pinhole, table_from_camera, seed)
        specular = self._newest * means[..., :1]
        alpha, normals, depth, specular, diffuse = np.split(
            lens.image(np.concatenate([means, specular, self._newest - specular], -1)), [1, 4, 5, 8], axis=-1
        )
        normals = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-6)
        normals, depth = np.where(alpha > 0, normals, 0), depth / np.maximum(alpha, 1e-6)
        return {"alpha": alpha, "normals": normals, "depth": depth, "specular": specular, "diffuse": diffuse}

    def _surfaces(self, pinhole: Camera, table_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """(height, width, 5) means over the pixels of a pinhole: share of the object, and its normals and depth times that."""
        means = np.empty((pinhole.height, pinhole.width, 5), np.float32)
        for number, (rows, part) in enumerate(strips(pinhole, RAYS_AT_ONCE // FINE**2)):
            fine = part.scaled(FINE * part.width, FINE * part.height)
            seen = self._renderer.surfaces(fine, table_from_camera, seed=(seed + number) % 2**32)
            values = np.concatenate([np.ones_like(seen.normals[..., :1]), seen.normals, seen.depth[..., None]], -1)
            values *= seen.is_object[..., None]
            means[rows] = sum(values[down::FINE, right::FINE] for down in range(FINE) for right in range(FINE)) / FINE**2
        return means

    def depth(self, camera: Camera, table_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        return self._renderer.surfaces(camera, table_from_camera, seed=seed % 2**32).depth

    def mesh(self) -> Any:
        """See `View`."""
        return self.stage.mesh()

    def place_room(self, table_from_room: NDArray[np.float64]) -> None:
        """See `View`."""
        self._renderer.place_room(table_from_room)

    def light(self, burning: tuple[bool, ...]) -> None:
        """See `View`; each lamp is a panel of its own on the walls."""
        self._renderer.light(textures.lit(self.stage.room, burning))


@dataclass
class BoardView(View):
    """A calibration target on a plate that fills the picture and turns with it."""

    board: BoardPicture
    brightness: float = 1.0

    def light(self, burning: tuple[bool, ...]) -> None:
        """See `View`; the light comes from everywhere."""
        self.brightness = textures.brightness(burning)

    def radiance(self, lens: Lens, table_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        light = _mean((self.board.radiance(lens, moment) for moment in table_from_camera), len(table_from_camera))
        return light if self.brightness == 1.0 else light * np.float32(self.brightness)

    def depth(self, camera: Camera, table_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`; of the table's plane, on which the board lies."""
        down = (camera.directions(camera.pixel_centres()) @ table_from_camera[:3, :3].T)[..., 2]
        hits = down < -1e-6
        return np.where(hits, table_from_camera[2, 3] / np.where(hits, -down, 1.0), 0).astype(np.float32)


@dataclass
class CardView(View):
    """A card that fills the picture, everywhere with the same grey light."""

    grey: float
    brightness: float = 1.0

    def light(self, burning: tuple[bool, ...]) -> None:
        """See `View`; the light comes from everywhere."""
        self.brightness = textures.brightness(burning)

    def radiance(self, lens: Lens, table_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        return np.full((lens.camera.height, lens.camera.width, 3), self.grey * self.brightness, np.float32)

    def depth(self, camera: Camera, table_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`; none: the card is too near."""
        return np.zeros((camera.height, camera.width), np.float32)


def _mean(pictures: Iterable[NDArray[np.float32]], count: int) -> NDArray[np.float32]:
    """Mean of `count` pictures; a single one is returned bit for bit."""
    total = sum(pictures, np.float32(0))
    return np.asarray(total if count == 1 else total / np.float32(count), np.float32)


def check_scene(scene: str, trajectory: Trajectory) -> str:
    """The present name of a scene. Raises UsageError if there is none, or if the trajectory lacks what the scene needs."""
    scene = check_name(scene)
    if scene in CARDS:
        return scene
    if scene == "board":
        good, needed = trajectory.target is not None and trajectory.board is not None, "'target' and 'board'"
        remedy = "use the trajectory calibration_demo, or another --scene"
    else:
        good, needed = trajectory.object is not None, "'object'"
        remedy = "use the trajectory koala_demo, or --scene board"
    if not good:
        raise UsageError(f"scene '{scene}' needs a trajectory with {needed}", where=trajectory.name, remedy=remedy)
    return scene


def make_view(
    scene: str, trajectory: Trajectory, seed: int, flange_from_board: NDArray[np.float64] | None = None, *, pose: str = UPRIGHT
) -> InBase:
    """The view of a scene in the base frame, with the object in a pose of this name; raises as `check_scene` does.

    Where the arm carries the target at `flange_from_board`, the view is that of the target before a dark room, in the flange.
    """
    if flange_from_board is not None and trajectory.target is not None:
        return InBase(BoardView(BoardPicture(trajectory.target, flange_from_board, seed, None)), np.eye(4))
    return InBase(_on_table(check_scene(scene, trajectory), trajectory, seed, pose), trajectory.base_from_table)


def _on_table(scene: str, trajectory: Trajectory, seed: int, lying: str) -> View:
    table_from_base = pose.inverse(trajectory.base_from_table)
    if trajectory.target is not None and trajectory.board is not None and scene == "board":
        table_from_board, target = table_from_base @ trajectory.base_from_board, trajectory.target
        middle = table_from_board @ [*target.size / 2, 0, 1]
        return BoardView(BoardPicture(target, table_from_board, seed, (float(middle[0]), float(middle[1]))))
    if scene in CARDS:
        return CardView(CARDS[scene])
    volume = trajectory.object
    if volume is None:
        raise SimulationError(f"scene '{scene}' has nowhere to stand")
    samples = FULL_SAMPLES if trajectory.camera.binning == 1 else SAMPLES
    centre = table_from_base[:3, :3] @ volume.centre + table_from_base[:3, 3]
    return ObjectView(stage(scene, centre=centre, size=volume.size, seed=seed, pose=lying), samples)
