"""What is in front of the simulated lens: an object in the laboratory, or the calibration board."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from capture.errors import SimulationError
from capture.sim.board import BoardPicture
from capture.sim.lens import Lens
from capture.sim.scenes import Stage, check_name, stage
from capture.trajectory import Trajectory
from datasets.errors import Misuse

Maps = dict[str, NDArray[np.float32]]
SAMPLES = 9
"""Light paths per pixel of the supersampled pinhole picture, four times as many per pixel of the image: noise of 36 dB."""


class View(Protocol):
    """What is in front of the lens."""

    def radiance(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """(height, width, 3) linear light on the pixels of the lens's camera, its mean over (n, 4, 4) poses of an exposure."""

    def truth(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> Maps:
        """What evaluation may know of the newest picture, see `SimulatedCamera.keep_truth`."""

    def mesh(self) -> Any:
        """The object [m, base frame], a trimesh; None where there is none."""


@dataclass
class ObjectView:
    """An object in the laboratory, rendered."""

    stage: Stage
    _newest: NDArray[np.float32] | None = None

    @cached_property
    def _renderer(self) -> Any:
        from capture.sim.renderer import Renderer

        return Renderer(self.stage)

    def radiance(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        pictures = (self._renderer.radiance(lens.pinhole, moment, samples=SAMPLES, seed=(seed + i) % 2**32)
                    for i, moment in enumerate(base_from_camera))  # fmt: skip
        self._newest = _mean(pictures, len(base_from_camera))
        return lens.image(self._newest)

    def truth(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> Maps:
        """Means over each pixel: normals and depth over that part of it which shows the object, light over all of it."""
        if self._newest is None:
            raise SimulationError("no picture has been taken yet")
        fine = replace(lens, supersampling=2 * lens.supersampling, taps=2 * lens.taps)
        surfaces = self._renderer.surfaces(fine.pinhole, base_from_camera, seed=seed)
        shown = surfaces.is_object[..., None].astype(np.float32)
        means = fine.image(np.concatenate([shown, shown * surfaces.normals, shown * surfaces.depth[..., None]], -1))
        alpha = means[..., :1]
        normals = means[..., 1:4] / np.maximum(np.linalg.norm(means[..., 1:4], axis=-1, keepdims=True), 1e-6)
        coarse = shown.reshape(lens.pinhole.height, 2, lens.pinhole.width, 2, 1).mean(axis=(1, 3))
        specular = lens.image(self._newest * coarse)
        return {
            "alpha": alpha, "normals": np.where(alpha > 0, normals, 0), "depth": means[..., 4:] / np.maximum(alpha, 1e-6),
            "specular": specular, "diffuse": lens.image(self._newest * (1 - coarse)),
        }  # fmt: skip

    def mesh(self) -> Any:
        """See `View`."""
        return self.stage.mesh()


@dataclass
class BoardView:
    """The calibration board on the table."""

    board: BoardPicture

    def radiance(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
        """See `View`."""
        return _mean((self.board.radiance(lens, moment) for moment in base_from_camera), len(base_from_camera))

    def truth(self, lens: Lens, base_from_camera: NDArray[np.float64], seed: int) -> Maps:
        """Nothing per picture: the board's pose says it all."""
        return {}

    def mesh(self) -> None:
        """None: a board is no object."""


def _mean(pictures: Iterable[NDArray[np.float32]], count: int) -> NDArray[np.float32]:
    """Of `count` pictures; a single one stays as it is, bit for bit."""
    total = sum(pictures, np.float32(0))
    return np.asarray(total if count == 1 else total / np.float32(count), np.float32)


def check_scene(scene: str, trajectory: Trajectory) -> None:
    """Raise Misuse where there is no such scene, or where the trajectory does not say what it needs."""
    check_name(scene)
    if scene == "charuco_board" and (trajectory.target is None or trajectory.board is None):
        raise Misuse("scene 'charuco_board' needs a trajectory with 'target' and 'board'", where=trajectory.name,
                     remedy="use configs/trajectories/calibration_demo.yaml, or another --scene")  # fmt: skip
    if scene != "charuco_board" and trajectory.object is None:
        raise Misuse(f"scene '{scene}' needs a trajectory with 'object'", where=trajectory.name,
                     remedy="use configs/trajectories/koala_demo.yaml, or --scene charuco_board")  # fmt: skip


def make_view(scene: str, trajectory: Trajectory, seed: int) -> View:
    """What stands in front of the camera; raises as `check_scene` does."""
    check_scene(scene, trajectory)
    if trajectory.target is not None and trajectory.board is not None and scene == "charuco_board":
        base_from_board, target = trajectory.board.matrix(), trajectory.target
        extent = np.array([target.squares_x, target.squares_y, 0]) * target.square_length_m
        middle = base_from_board[:3, :3] @ extent / 2 + base_from_board[:3, 3]
        return BoardView(BoardPicture(target, base_from_board, seed, (float(middle[0]), float(middle[1]))))
    volume = trajectory.object
    if volume is None:
        raise SimulationError(f"scene '{scene}' has nowhere to stand")
    return ObjectView(stage(scene, centre=volume.centre, size=volume.size, seed=seed))
