"""A rig that is connected."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.protocols import Camera, GroundTruth, Robot, Turntable
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.rig.lamps import SwitchedLamps
from koala3d.capture.rig.moves import Moves
from koala3d.datasets.kinematics import Links


@dataclass(frozen=True)
class Rig:
    """An arm and its camera, both connected; with several cameras the rig as the first one has it."""

    robot: Robot
    camera: Camera
    description: RigDescription
    name: str  # "sim", "sim:NAME", or the name or path of the rig file
    ground_truth: GroundTruth | None = None  # only in a simulation
    extra: dict[str, Any] = field(default_factory=dict)  # more entries for the manifest: the scene and seed of a simulation
    turntable: Turntable | None = None  # connected where the trajectory turns the object
    links: Links | None = None  # of this arm as it was built; None: they are not known
    moves: Moves = field(default_factory=Moves)  # what moves the arm
    lamps: SwitchedLamps | None = None  # connected where the trajectory switches lamps
    cameras: "dict[str, Rig]" = field(default_factory=dict)  # the rig as each camera has it, by name; empty: there is one camera

    @property
    def each(self) -> "dict[str, Rig]":
        """A copy of the rig for each camera, as if it were the only one, by the camera's name. The only camera of a rig is ""."""
        return self.cameras or {"": self}

    @property
    def carrier(self) -> Carrier:
        """The arm with its camera and what stands around it."""
        return self.description.carrier().as_built(self.links)

    @property
    def flange_from_camera(self) -> NDArray[np.float64]:
        """(4, 4) nominal mount [m]; without meaning where the camera stands beside the arm."""
        return self.description.flange_from_camera.matrix()
