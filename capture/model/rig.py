"""Rig files: the address of the arm, its camera or cameras, and how they are mounted."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, StringConstraints, model_validator

from koala3d.capture.model.arm import DEFAULT, ArmModel, load_arm, recorded_arm
from koala3d.capture.model.carrier import BODY, MAX_TOOL_SPEED, Beside, Cable, CameraCapsule, Carrier, Fellow
from koala3d.capture.model.device import Device
from koala3d.capture.model.flaws import Flaws
from koala3d.capture.model.shapes.geometry import PoseDescription
from koala3d.capture.model.shapes.solids import AnySolid, CylinderSolid, MeshSolid
from koala3d.capture.model.turntable import LampDescription, LampOutput, TurntableDescription
from koala3d.capture.model.viewpoints import LampName
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import Schema, load_yaml, validate
from koala3d.datasets.kinematics import Links
from koala3d.datasets.recording import MANIFEST, Recording

Three = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


class InstallationDescription(Schema):
    """What the pendant should say; `capture doctor` compares it with what the controller reports. Empty or null: not compared."""

    serial: str = Field(default="", description="serial number of the arm")
    mounting: Literal["table", "ceiling"] = Field(default="table", description="whether the arm stands or hangs")
    payload_kg: float | None = Field(default=None, ge=0, le=100, description="camera, lens, bracket and plug [kg]")
    payload_centre: Three | None = Field(default=None, description="their centre of gravity in the flange [m]")
    tool_offset: Six | None = Field(
        default=None, description="tool centre point in the flange: position [m], rotation vector [rad]"
    )
    safety_checksum: str = Field(default="", description="of the safety settings, as 'capture doctor' has printed it")

    @property
    def upwards(self) -> int:
        """Sign of the base's z axis in the upward direction."""
        return 1 if self.mounting == "table" else -1


class RobotDescription(Schema):
    """The arm and its limits."""

    model: str = Field(default=DEFAULT, min_length=1, description="model of the arm: a name of 'capture list', or an arm file")
    host: str = Field(default="192.168.0.10", min_length=1, description="address of the controller on the network")
    client: Literal["auto", "ur_rtde", "koala"] = Field(
        default="auto",
        description="what speaks to the controller: ur_rtde, the vendor's; koala, our own; auto: ur_rtde if installed",
    )
    registers: Literal["lower", "upper"] = Field(
        default="lower",
        description="input registers that ur_rtde takes: lower, 0 to 23, or upper, 24 to 47, if a fieldbus owns the lower ones; "
        "koala always takes the upper ones",
    )
    stream_deadline_s: float = Field(
        default=0.2, ge=0.02, le=5, description="the arm is stopped if the controller sends no sample for this long [s]"
    )
    watchdog_hz: float = Field(
        default=5.0, ge=0.2, le=50, description="the controller ends the program if it hears nothing for a period of this [Hz]"
    )
    max_joint_speed: float = Field(default=1.05, gt=0, le=np.pi, description="limit of every joint [rad/s]")
    max_joint_acceleration: float = Field(default=1.4, gt=0, le=10, description="limit of every joint [rad/s^2]")
    max_tool_speed: float = Field(
        default=MAX_TOOL_SPEED, gt=0, le=3, description="limit of the fastest point of arm, camera and plate [m/s]"
    )
    cable: Cable | None = Field(default=Cable(), description="how far the camera's cable may be wound up; null: no limit")
    installation: InstallationDescription = Field(
        default_factory=InstallationDescription, description="settings of the pendant that 'capture doctor' compares"
    )


class CameraDescription(Device):
    """The camera. Exposure, gain and region belong to the trajectory."""

    firmware: str = Field(default="", description="firmware version; empty: not compared")
    lens: str = Field(default="", description="focal length, aperture and focus, in your words; empty: not compared")
    body: list[CameraCapsule] = Field(
        default=list(BODY), description="shape of camera, lens and plug in the camera's frame, for collision checks"
    )


class MountedCamera(CameraDescription):
    """One of several cameras on the flange."""

    flange_from_camera: PoseDescription = Field(description="nominal pose of this camera on the flange")

    @property
    def alone(self) -> CameraDescription:
        """The camera without its mount."""
        return CameraDescription(**{key: getattr(self, key) for key in CameraDescription.model_fields})


AnyCamera = TypeVar("AnyCamera", bound=CameraDescription)
CameraName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]
"""Names the recording of this camera as well, a folder."""


class BesideDescription(Schema):
    """A camera that stands beside the arm and looks at a calibration target on the flange."""

    base_from_camera: PoseDescription = Field(
        description="nominal camera pose in the base, by a ruler. 1 cm and 5 degrees are enough: calib finds the true pose"
    )
    flange_from_plate: PoseDescription = Field(
        default=PoseDescription(position=(0.0, 0.0, 0.02), rotation_deg=(180.0, 0.0, 0.0)),
        description="nominal place of the target's middle on the flange: x along its squares_x, y along squares_y, z into it",
    )
    plate: tuple[float, float] = Field(
        default=(0.3, 0.24), description="extent of the plate that bears the target, along its x and y, for collision checks [m]"
    )


class SimulationDescription(Schema):
    """A simulated rig. A real rig has none."""

    side_port: int | None = Field(
        default=None,
        ge=1,
        le=65535,
        description="port of the side channel of a running simulated controller, as 'capture sim' writes it; "
        "null: each command starts its own controller",
    )
    scene: str = Field(default="gold_head", description="scene in front of the camera")
    seed: int = Field(default=0, ge=0, description="random seed of a running controller; else --seed counts")
    flaws: Flaws = Field(default_factory=Flaws, description="flaws of sensor, lens, lamps and arm")


class RigDescription(Schema):
    """One rig: arm, camera or cameras, and what stands around them."""

    robot: RobotDescription = Field(default_factory=RobotDescription, description="the arm")
    camera: CameraDescription = Field(default_factory=CameraDescription, description="the camera")
    flange_from_camera: PoseDescription = Field(
        default=PoseDescription(position=(0.0, 0.06, 0.08), rotation_deg=(45.0, 0.0, 0.0)),
        description="nominal camera pose on the flange, from a drawing or a ruler. 1 cm and 5 degrees are enough: "
        "calib finds the true pose",
    )
    cameras: dict[CameraName, MountedCamera] = Field(
        default={},
        description="several cameras on the flange by name, in place of camera and flange_from_camera: each makes a recording of "
        "its own at the same stops. Views are planned for the first one; empty: there is one camera",
    )
    beside: BesideDescription | None = Field(
        default=None, description="the camera stands beside the arm; null: it is on the flange, at flange_from_camera"
    )
    obstacles: list[AnySolid] = Field(default=[], description="what else stands around the arm")
    turntable: TurntableDescription | None = Field(default=None, description="what turns the object; null: the object stands")
    lights: list[LampDescription] = Field(default=[], description="the lamps; empty: nobody says where they stand")
    lamps: dict[LampName, LampOutput] = Field(
        default={},
        description="lamps that are switched while a session runs, by name; one that is also in 'lights' stands where that says, "
        "any other in the room",
    )
    simulation: SimulationDescription | None = Field(default=None, description="only for a simulated rig; null: a real rig")

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        """With `cameras`, `camera` and `flange_from_camera` are those of one of them: of the first where they are not given."""
        if not self.cameras:
            return self
        if self.beside is not None:
            raise ValueError("a camera beside the arm is the only one: remove 'cameras' or 'beside'")
        self._require_different()
        given = self.model_fields_set & {"camera", "flange_from_camera"}
        if given and not (self.name and self.cameras[self.name].alone == self.camera):
            raise ValueError(f"'cameras' lists every camera, and this is none of them: remove {' and '.join(sorted(given))}")
        if not given:
            first = next(iter(self.cameras.values()))
            for key, value in (("camera", first.alone), ("flange_from_camera", first.flange_from_camera)):
                object.__setattr__(self, key, value)  # frozen for everybody else
        return self

    def _require_different(self) -> None:
        """Raise ValueError where two entries of `cameras` are one and the same camera, or are at one place."""
        seen: dict[Any, str] = {}
        for name, one in self.cameras.items():
            keys = [("flange_from_camera", str(one.flange_from_camera.model_dump()))]
            for key, value in keys + [("serial", one.serial)] * bool(one.serial):
                if (key, value) in seen:
                    raise ValueError(f"cameras: '{seen[key, value]}' and '{name}' have the same {key}")
                seen[key, value] = name

    @property
    def name(self) -> str:
        """Name in `cameras` of the camera that `camera` describes; empty where the rig has one camera, or it is none of them."""
        return next((name for name, one in self.cameras.items() if one.flange_from_camera == self.flange_from_camera), "")

    @property
    def each(self) -> dict[str, Self]:
        """A copy of the rig for each camera, as if it were the only one, by the camera's name. The only camera of a rig is ""."""
        return {name: self._with(one) for name, one in self.cameras.items()} or {"": self}

    def _with(self, one: MountedCamera) -> Self:
        return self.model_copy(update={"camera": one.alone, "flange_from_camera": one.flange_from_camera})

    @property
    def arm(self) -> ArmModel:
        """The model of the arm; raises UsageError where there is no such file, or something in it is wrong."""
        return load_arm(self.robot.model)

    def carrier(self, arm: ArmModel | None = None) -> Carrier:
        """The arm with its camera and what stands around it; raises UsageError where they do not fit together.

        Args:
            arm: takes the place of the arm that the rig file names.
        """
        arm, cable = self.arm if arm is None else arm, self.robot.cable
        if cable is not None:
            if not all(1 <= joint <= arm.count for joint in cable.joints):
                why = f"joints {cable.joints}, but the {arm.name} has joints 1 to {arm.count}"
                raise UsageError("robot.cable.joints names a joint that does not exist", why=why)
            if cable.rest_deg and len(cable.rest_deg) != (number := len(cable.joints) or 2):
                why = f"{len(cable.rest_deg)} angles for {number} joints"
                raise UsageError("robot.cable.rest_deg needs an angle for each joint of the cable", why=why)
        names = [solid.name for solid in self.obstacles]
        if len(set(names)) < len(names):
            raise UsageError("two obstacles have the same name", why=", ".join(sorted(names)), remedy="rename one of them")
        body, beside = tuple(self.camera.body), None
        solids = list(self.obstacles)
        if self.beside is not None:
            stated = self.beside
            beside = Beside(stated.base_from_camera.matrix(), stated.flange_from_plate.matrix(), stated.plate)
            solids.append(_camera_as_solid(body, beside.base_from_camera))
        fellows = tuple(
            Fellow(name, one.flange_from_camera.matrix(), tuple(one.body))
            for name, one in self.cameras.items()
            if name != self.name
        )
        mount, speed = self.flange_from_camera.matrix(), self.robot.max_tool_speed
        return Carrier(arm, mount, body, tuple(solids), cable, self.turntable, beside, fellows, speed)

    def lights_at(self, trajectory_lights: list[str] | None, lamps: tuple[str, ...] | None) -> tuple[str, ...] | None:
        """Names of the lamps that are on at a view: as a person has switched them, and `lamps` of those that are switched.

        Raises UsageError as `lights_on` does.
        """
        by_hand = self.lights_on(trajectory_lights)
        return by_hand if lamps is None else (*(name for name in by_hand or () if name not in self.lamps), *lamps)

    def require_lamps(self, names: set[str], where: str) -> None:
        """Raise UsageError unless the rig can switch these lamps, each by an output of its own."""
        if missing := sorted(names - self.lamps.keys()):
            why = f"the rig file switches {', '.join(self.lamps) or 'none'}"
            remedy = "correct 'lamps' in the trajectory, or add the lamp to 'lamps' of the rig file"
            raise UsageError(f"no lamp called '{missing[0]}' can be switched", where=where, why=why, remedy=remedy)
        outputs = [lamp.output for lamp in self.lamps.values()]
        if len(set(outputs)) < len(outputs):
            raise UsageError("two lamps have the same output", where="lamps", why=str(outputs), remedy="correct the rig file")

    def lights_on(self, trajectory_lights: list[str] | None) -> tuple[str, ...] | None:
        """Names of the lamps that are on in a trajectory; None where the rig file names no lamps.

        Args:
            trajectory_lights: `Trajectory.lights`.

        Raises UsageError: one of them is no lamp of the rig, two lamps have one name, or one stands on a missing turntable.
        """
        names = [lamp.name for lamp in self.lights]
        if len(set(names)) < len(names):
            raise UsageError("two lamps have the same name", why=", ".join(sorted(names)), remedy="rename one under 'lights'")
        riding = [lamp.name for lamp in self.lights if lamp.stands == "turntable"]
        if riding and self.turntable is None:
            why = "the rig file describes no turntable"
            raise UsageError(f"lamp '{riding[0]}' stands on the turntable", where="lights", why=why)
        for name in trajectory_lights or ():
            if name not in names:
                why = f"the rig file has {', '.join(names) or 'none'}"
                remedy = "correct 'lights' in the trajectory, or add the lamp to the rig file"
                raise UsageError(f"no lamp called '{name}'", where="lights", why=why, remedy=remedy)
        return (tuple(names) if trajectory_lights is None else tuple(trajectory_lights)) if names else None


def _camera_as_solid(body: tuple[CameraCapsule, ...], base_from_camera: NDArray[np.float64]) -> CylinderSolid:
    """The cylinder along the view that encloses the body of a camera beside the arm."""
    ends = np.array([[part.start, part.end] for part in body])
    radii = np.array([part.radius for part in body])
    low, high = (ends[..., 2].min(axis=1) - radii).min(), (ends[..., 2].max(axis=1) + radii).max()
    radius = float((np.linalg.norm(ends[..., :2], axis=-1).max(axis=1) + radii).max())
    placed = base_from_camera @ pose.rigid(np.eye(3), [0.0, 0.0, (low + high) / 2])
    where = PoseDescription(position=tuple(placed[:3, 3]), rotation_deg=tuple(np.degrees(pose.rotation_vector(placed))))
    return CylinderSolid(kind="cylinder", name="camera beside the arm", radius=radius, height=float(high - low), pose=where)


def recorded_rig(recording: Recording) -> RigDescription:
    """The rig that a recording was made with; the default rig where its manifest has none."""
    content = {key: value for key, value in recording.part("rig").items() if key != "name"}
    return validate(content, RigDescription, where=f"{recording.path / MANIFEST}, rig")


def recorded_carrier(recording: Recording) -> Carrier:
    """The arm of a recording with its camera, and with its own links if the recording has them."""
    content = recording.manifest.get("links")
    links = None if content is None else Links.from_json(content, where=f"{recording.path / MANIFEST}, links")
    return recorded_rig(recording).carrier(recorded_arm(recording)).as_built(links)


def load_rig(path: Path | str) -> RigDescription:
    """Read a rig file; raises UsageError where something in it is wrong. Paths in it are relative to its folder."""
    rig, folder = load_yaml(path, RigDescription), Path(path).resolve().parent
    placed = [
        solid.model_copy(update={"file": str(folder / solid.file)}) if isinstance(solid, MeshSolid) else solid
        for solid in rig.obstacles
    ]
    robot, model = rig.robot, Path(rig.robot.model)
    if model.suffix and not model.is_absolute() and (folder / model).is_file():
        robot = robot.model_copy(update={"model": str(folder / model)})
    camera, cameras = _camera_in(folder, rig.camera), {name: _camera_in(folder, one) for name, one in rig.cameras.items()}
    rig = rig.model_copy(update={"obstacles": placed, "robot": robot, "camera": camera, "cameras": cameras})
    try:
        rig.carrier()
    except UsageError as error:
        raise UsageError(error.what, where=error.where or path, why=error.why, remedy=error.remedy) from None
    return rig


def _camera_in(folder: Path, camera: AnyCamera) -> AnyCamera:
    """The camera with its files in the folder of the rig file."""
    changes = {}
    if camera.radiometry:
        changes["radiometry"] = str(folder / camera.radiometry)
    if (folder / camera.source).parent.is_dir() and Path(camera.source).suffix:
        changes["source"] = str(folder / camera.source)
    return camera.model_copy(update=changes)
