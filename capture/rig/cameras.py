"""Opens the camera of a rig: the driver that its `model` names, or a simulation; and the view of it that `capture doctor` has."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from koala3d.capture.drivers.cameras.base import CameraDriver, InspectedCamera
from koala3d.capture.drivers.protocols import Camera, GroundTruth
from koala3d.capture.model.device import Device
from koala3d.capture.model.flaws import Flaws
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import CameraSettings, Trajectory
from koala3d.capture.rig.naming import describe, is_simulated
from koala3d.datasets.recording import UPRIGHT

if TYPE_CHECKING:
    from koala3d.capture.rig.controllers import Simulation
    from koala3d.capture.sim.turntable import SimulatedTurntable


def driver_of(device: Device, settings: CameraSettings) -> CameraDriver:
    """The driver of a real camera with the settings of a trajectory; entering it connects."""
    if device.model == "genicam":
        from koala3d.capture.drivers.cameras.gentl import GenTlCamera

        return GenTlCamera(settings, device)
    if device.model == "opencv":
        from koala3d.capture.drivers.cameras.opencv import OpenCvCamera

        return OpenCvCamera(settings, device)
    if device.model == "realsense":
        from koala3d.capture.drivers.cameras.realsense import RealSense

        return RealSense(settings, device)
    if device.model == "gphoto2":
        from koala3d.capture.drivers.cameras.gphoto import GphotoCamera

        return GphotoCamera(settings, device)
    from koala3d.capture.drivers.cameras.basler import Basler

    return Basler(settings, device)


def seen(device: Device, *, simulated: bool = False, number: int = 0) -> AbstractContextManager[InspectedCamera]:
    """Open a camera only to look at it; a simulated one by its own emulation if it has one, else by that of pylon.

    Args:
        number: which of the rig's cameras it is, from 0, if it is simulated.

    Raises RigConnectionError: there is none, or several and no serial number, or another program uses it.
    """
    return (_emulated(device, number) if simulated else driver_of(device, CameraSettings())).inspected()


def _emulated(device: Device, number: int) -> CameraDriver:
    if device.model != "realsense":
        from koala3d.capture.drivers.cameras.basler import Basler, serial_of

        return Basler(CameraSettings(), Device(serial=serial_of(number)), emulated=True)
    import numpy as np

    from koala3d.capture.drivers.cameras.realsense import RealSense
    from koala3d.capture.sim.realsense_device import SoftwareRealSense
    from koala3d.capture.sim.truth import RigTruth

    source = SoftwareRealSense(RigTruth.draw(np.eye(4), 0).sensor_camera)
    return RealSense(CameraSettings(), device.model_copy(update={"serial": ""}), emulation=source)


def camera_in(
    rig: RigDescription,
    trajectory: Trajectory,
    controller: "Simulation | None",
    scene: str,
    seed: int,
    turned: "SimulatedTurntable | None",
    number: int,
    pose: str = UPRIGHT,
) -> tuple[Camera, GroundTruth | None]:
    """The camera of a rig, not connected, and what knows the truth about it; `number` and `pose` as in `SimulatedCamera`."""
    if controller is None:
        return driver_of(rig.camera, trajectory.camera), None
    from koala3d.capture.sim.camera import SimulatedCamera
    from koala3d.capture.sim.truth import RigTruth, seed_of_camera

    truth, flaws = RigTruth.of(rig.carrier(), trajectory, seed_of_camera(seed, number)), _flaws_of(rig)
    lamps = tuple(lamp.output for lamp in rig.lamps.values()) if trajectory.switches else ()
    made = SimulatedCamera(
        trajectory, scene, truth, controller, seed, flaws, device=rig.camera, table=turned, number=number, lamps=lamps, pose=pose
    )
    return made, made


def camera_for(
    name: str, trajectory: Trajectory, *, scene: str, seed: int = 0, view: int = 0, flat: Path | None = None
) -> Camera:
    """The camera of a rig, not connected; entering it connects it and leaves the arm alone.

    Args:
        scene: what a simulated camera looks at.
        seed: of everything random in a simulation.
        view: number of the view of the trajectory from which a simulated camera looks.
        flat: file that will hold its response; None: that of the rig.
    """
    description = describe(name)
    device = description.camera if flat is None else description.camera.model_copy(update={"radiometry": str(flat)})
    if not is_simulated(name, description):
        return driver_of(device, trajectory.camera)
    from koala3d.capture.planning import Obstacles
    from koala3d.capture.sim.camera import SimulatedCamera, StillArm
    from koala3d.capture.sim.truth import RigTruth

    carrier = description.carrier()
    arm = StillArm(Obstacles.of(trajectory, carrier).flange_for(trajectory.viewpoints()[view].camera_pose(carrier)))
    truth, flaws = RigTruth.of(carrier, trajectory, seed), _flaws_of(description)
    return SimulatedCamera(trajectory, scene, truth, arm, seed, flaws, device=device)


def _flaws_of(description: RigDescription) -> Flaws:
    """Flaws of a rig's simulated camera; none where the description has no simulation."""
    return Flaws() if description.simulation is None else description.simulation.flaws
