"""What a person writes about a rig: where the arm is, which camera it carries, and how that camera is mounted."""

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from datasets import pose
from datasets.core.schema import Schema, load_yaml

Vector = tuple[float, float, float]


class PoseDescription(Schema):
    """A rigid transform a_from_b as position and rotation vector."""

    position: Vector = Field(default=(0, 0, 0), description="origin of b in a [m]")
    rotation_deg: Vector = Field(default=(0, 0, 0), description="rotation vector: axis times angle [degrees]")

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) transform [m]."""
        return pose.from_rotation_vector(np.radians(self.rotation_deg), self.position)


class RobotDescription(Schema):
    """The arm and what it may do."""

    model: Literal["ur5e"] = Field(default="ur5e", description="model of the arm")
    host: str = Field(default="192.168.0.10", min_length=1, description="address of the controller on the network")
    max_joint_speed: float = Field(default=1.05, gt=0, le=np.pi, description="no joint is ever asked to be faster [rad/s]")
    max_joint_acceleration: float = Field(default=1.4, gt=0, le=10, description="nor to accelerate more [rad/s^2]")


class CameraDescription(Schema):
    """The camera and its lens. Exposure, gain and region belong to the trajectory."""

    model: Literal["basler"] = Field(default="basler", description="kind of camera")
    serial: str = Field(default="", description="serial number; empty: the only camera that is connected")


class SimulationDescription(Schema):
    """A simulated controller that runs already, as `capture sim` writes it. A real rig has none."""

    side_port: int = Field(ge=1, le=65535, description="port on 127.0.0.1 where the simulation says where the arm truly is")
    scene: str = Field(default="gold_head", description="what stands before the camera")
    seed: int = Field(default=0, ge=0, description="of everything random")


class RigDescription(Schema):
    """One rig: arm, camera and bracket."""

    robot: RobotDescription = Field(default_factory=RobotDescription, description="the arm")
    camera: CameraDescription = Field(default_factory=CameraDescription, description="the camera")
    flange_from_camera: PoseDescription = Field(
        default=PoseDescription(position=(0.0, 0.06, 0.08), rotation_deg=(45.0, 0.0, 0.0)),
        description="nominal camera pose on the flange, by drawing or ruler: 1 cm and 5 degrees are enough, calib finds the true one",
    )
    simulation: SimulationDescription | None = Field(
        default=None, description="only of a rig that is simulated; null: a real one"
    )


def load_rig(path: Path | str) -> RigDescription:
    """Read a rig file; raises UsageError in one line where something in it is wrong."""
    return load_yaml(path, RigDescription)
