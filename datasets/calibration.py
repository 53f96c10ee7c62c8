"""A calibration file: intrinsics, hand-eye pose and board pose, each with its uncertainty.

Covariances of poses are (6, 6) over a left perturbation, translation first [m], then rotation vector [rad]:
`true = perturbation(twist) @ stated`. What was not calibrated is None.

Errors of the arm's links and hand-eye pose are estimated together and are valid only together. `camera_pose` applies both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import kinematics, pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.kinematics import UR5E, Links
from koala3d.datasets.recording import Frame
from koala3d.datasets.residuals import Residuals
from koala3d.datasets.turntable import Axis

FORMAT, VERSION = "koala-calibration", 1
_LINKS = ("d_m", "a_m", "alpha_rad", "theta_rad")
_POSES = ("flange_from_camera", "base_from_board", "base_from_camera", "flange_from_board")


@dataclass(frozen=True)
class UncertainPose:
    """A rigid transform with the covariance of its error."""

    matrix: NDArray[np.float64]
    """(4, 4) rigid transform [m]."""
    covariance: NDArray[np.float64]
    """(6, 6): translation [m^2] first, then rotation vector [rad^2]."""

    @property
    def origin_covariance(self) -> NDArray[np.float64]:
        """(3, 3) covariance of `matrix[:3, 3]` [m^2].

        `covariance` is about the first frame's origin, so its rotation part moves the second frame's origin too.
        """
        by_twist = np.hstack([np.eye(3), -pose.cross(self.matrix[:3, 3])])
        return by_twist @ self.covariance @ by_twist.T

    @property
    def translation_std_mm(self) -> NDArray[np.float64]:
        """(3,) standard deviations of `matrix[:3, 3]` [mm]."""
        return 1e3 * np.sqrt(np.diag(self.origin_covariance))

    @property
    def rotation_std_deg(self) -> NDArray[np.float64]:
        """(3,) standard deviations of the rotation [deg]."""
        return np.rad2deg(np.sqrt(np.diag(self.covariance)[3:]))

    @property
    def total_std(self) -> tuple[float, float]:
        """Standard deviations over all axes: translation [mm], rotation [deg]."""
        return float(np.linalg.norm(self.translation_std_mm)), float(np.linalg.norm(self.rotation_std_deg))

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary: translation [m], quaternion `wxyz`, covariance."""
        return {
            "translation_m": self.matrix[:3, 3].tolist(),
            "quaternion_wxyz": pose.quaternion(self.matrix).tolist(),
            "covariance": self.covariance.tolist(),
        }

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Pose from `to_json`'s dictionary."""
        try:
            matrix = pose.from_quaternion(content["quaternion_wxyz"], content["translation_m"])
            covariance = np.asarray(content["covariance"], np.float64).reshape(6, 6)
        except (TypeError, KeyError, ValueError) as error:
            raise DatasetError("pose is not complete", where=where, why=str(error)) from None
        if not np.isfinite(covariance).all() or (np.diag(covariance) < 0).any():
            raise DatasetError("covariance is impossible", where=where, why="it is not finite, or a variance is negative")
        return cls(pose.checked(matrix, where=where), covariance)


@dataclass(frozen=True)
class LinkErrors:
    """True minus nominal Denavit-Hartenberg parameters of the arm; errors of theta are offsets of the joints.

    Those that move all views alike are zero by convention: other poses absorb them.
    """

    errors: NDArray[np.float64]
    """(4 n,) of d, a [m], alpha, theta [rad], in this order."""
    std: NDArray[np.float64]
    """(4 n,) standard deviations; 0 where an error was not estimated."""
    links: Links = UR5E
    """The nominal chain of the arm."""

    @property
    def joints(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) offsets of the joints, true angle minus reported angle, and their standard deviations [rad]."""
        return self.errors[-self.links.count :], self.std[-self.links.count :]

    @property
    def only_joints(self) -> bool:
        """Whether nothing but offsets of joints was estimated."""
        return not self.std[: -self.links.count].any()

    def corrected(self, base_from_flange: NDArray[np.float64], joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 4, 4) true flange poses from reported (..., 4, 4) poses [m] and (..., n) joint angles [rad]."""
        return kinematics.corrected(base_from_flange, joints, self.errors, self.links)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary."""
        of = {name: part.tolist() for name, part in zip(_LINKS, np.split(self.errors, 4), strict=True)}
        std = {f"{name}_std": part.tolist() for name, part in zip(_LINKS, np.split(self.std, 4), strict=True)}
        return {**of, **std, "links": self.links.to_json()}

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Errors from `to_json`'s dictionary."""
        try:
            links = Links.from_json(content["links"], where=f"{where}, links")
            errors, std = (
                np.concatenate([np.asarray(content[name + end], np.float64).reshape(links.count) for name in _LINKS])
                for end in ("", "_std")
            )
        except (TypeError, KeyError, ValueError, AttributeError) as error:
            raise DatasetError("errors of the links are not complete", where=where, why=str(error)) from None
        return cls._credible(errors, std, links, where)

    @classmethod
    def _credible(cls, errors: NDArray[np.float64], std: NDArray[np.float64], links: Links, where: object) -> Self:
        if not (np.isfinite([errors, std]).all() and np.abs(errors).max() < 1):
            raise DatasetError("errors of the links are not credible", where=where, why=f"{errors.tolist()} m, rad")
        return cls(errors, std, links)


@dataclass(frozen=True)
class Calibration:
    """What is known about the rig, how accurately, and from which recording."""

    camera: Camera
    """Intrinsics at the size of the recorded images."""
    camera_std: dict[str, float]
    """Standard deviation of each estimated intrinsic [px for fx fy cx cy, else 1]."""
    flange_from_camera: UncertainPose | None = None
    """Hand-eye pose: X in AX = XB."""
    base_from_board: UncertainPose | None = None
    """Pose of the calibration target."""
    base_from_camera: UncertainPose | None = None
    """Replaces the hand-eye pose where the camera stands beside the arm."""
    flange_from_board: UncertainPose | None = None
    """Pose of the target on the flange, where the camera stands beside the arm."""
    link_errors: LinkErrors | None = None
    """Errors of the arm's links, where they were estimated: of joint offsets alone, or of all parameters."""
    turntable: Axis | None = None
    """Axis of the turntable on which the object stands, where it was calibrated."""
    region: Region | None = None
    """Region of the sensor that the recorded images show; None if the session did not say."""
    residuals: Residuals = field(default_factory=Residuals)
    """How well it fits, and how well it predicts views held out of the fit."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Recording path and hash, target, method, software versions."""

    @property
    def poses(self) -> dict[str, UncertainPose]:
        """The poses that were calibrated, by name."""
        return {name: value for name in _POSES if (value := getattr(self, name)) is not None}

    def camera_pose(self, base_from_flange: NDArray[np.float64], joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 4, 4) `base_from_camera` of a camera on the flange, from what the arm reported.

        Args:
            base_from_flange: (..., 4, 4) [m].
            joints: (..., n) [rad]; ignored where no errors of the links were estimated.

        Raises:
            DatasetError: there is no hand-eye pose.
        """
        if self.flange_from_camera is None:
            raise DatasetError("calibration holds no hand-eye pose", remedy="make one with 'calib handeye'")
        flange = base_from_flange if self.link_errors is None else self.link_errors.corrected(base_from_flange, joints)
        return flange @ self.flange_from_camera.matrix

    def camera_poses(self, frames: Sequence[Frame]) -> NDArray[np.float64]:
        """(n, 4, 4) world_from_camera [m] of frames. The world is the base, or of frames with a turntable the object's frame.

        Raises:
            DatasetError: there is no hand-eye pose, or the object turned and the axis is not known.
        """
        flanges, joints = np.stack([one.base_from_flange for one in frames]), np.stack([one.joints for one in frames])
        found, turns = self.camera_pose(flanges, joints), any(one.turntable_angle for one in frames)
        return pose.inverse(self.object_poses(frames)) @ found if turns else found

    def object_poses(self, frames: Sequence[Frame]) -> NDArray[np.float64]:
        """(n, 4, 4) base_from_world [m] of frames, of the world of `camera_poses`. Raises DatasetError as it does."""
        angles = [one.turntable_angle or 0.0 for one in frames]
        if not np.any(angles):
            return np.broadcast_to(np.eye(4), (len(frames), 4, 4))
        if self.turntable is None:
            remedy = "find it in a recording of the board on the table: 'calib turntable'"
            raise DatasetError("calibration holds no axis of the turntable", why="the object turned", remedy=remedy)
        return self.turntable.base_from_object(angles)

    def save(self, path: Path) -> None:
        """Write atomically as JSON."""
        content = {"format": FORMAT, "version": VERSION, "camera": self.camera.to_json(), "camera_std": self.camera_std}
        content |= dict.fromkeys(_POSES[:2]) | {name: value.to_json() for name, value in self.poses.items()}
        optional = {"link_errors": self.link_errors, "turntable": self.turntable, "region": self.region}
        content |= {name: value.to_json() for name, value in optional.items() if value}
        files.write_json(path, {**content, "residuals": self.residuals.to_json(), "provenance": self.provenance})

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a calibration. Raises UsageError where the file is missing, DatasetError where it is damaged."""
        content = files.read_json(path, kind=FORMAT, version=VERSION)
        if "camera" not in content:
            raise DatasetError("calibration holds no camera", where=path)
        camera = Camera.from_json(content["camera"], where=f"{path}, camera")
        stored: dict[str, Any] = {}
        for name in _POSES:
            if content.get(name):
                stored[name] = UncertainPose.from_json(content[name], where=f"{path}, {name}")
        if content.get("link_errors"):
            stored["link_errors"] = LinkErrors.from_json(content["link_errors"], where=f"{path}, link_errors")
        if content.get("turntable"):
            stored["turntable"] = Axis.from_json(content["turntable"], where=f"{path}, turntable")
        if content.get("region"):
            stored["region"] = Region.from_json(content["region"], where=f"{path}, region")
        for name in ("camera_std", "residuals", "provenance"):
            stored[name] = content.get(name, {})
            if not isinstance(stored[name], dict):
                raise DatasetError("is not made of names and values", where=f"{path}, {name}", why=str(stored[name])[:80])
            _check_finite(stored[name], f"{path}, {name}")
        stored["residuals"] = Residuals.from_json(stored["residuals"], where=f"{path}, residuals")
        return cls(camera, **stored)


def _check_finite(content: Any, where: str) -> None:
    """Raise DatasetError where a number is NaN or infinite: it could not be written again."""
    if isinstance(content, float) and not np.isfinite(content):
        raise DatasetError("number is not finite", where=where, why=str(content), remedy="calibrate again")
    for key, value in content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ():
        _check_finite(value, f"{where}, {key}")
