"""What a recording says about its session, and whether another session may resume it."""

from datetime import datetime
from importlib.metadata import version
from typing import Any

from koala3d.capture.model.carrier import MAX_TOOL_SPEED, Carrier
from koala3d.capture.model.rig import InstallationDescription, RigDescription, RobotDescription, recorded_rig
from koala3d.capture.model.trajectory import Trajectory, recorded_trajectory
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.radiometry.response import added_black
from koala3d.datasets.recording import POSE, RADIOMETRY, UPRIGHT, Recording

DEVICES = (
    ("robot", "model", "arm"),
    ("robot", "serial", "arm"),
    ("camera", "model", "camera"),
    ("camera", "serial", "camera"),
    ("camera", "lens", "lens"),
)
"""Part of the manifest, its entry, and what a person calls the device."""


def manifest_of(trajectory: Trajectory, rig: Rig) -> dict[str, Any]:
    """Everything that `calib` and `datasets build` need in addition to the frames."""
    volume = trajectory.object
    return {
        "name": trajectory.name,
        "started": datetime.now().astimezone().isoformat(timespec="seconds"),
        "software": f"koala-capture {version('koala-capture')}",
        "scene": None,
        "seed": None,
        **rig.extra,
        "trajectory": trajectory.model_dump(mode="json"),
        "rig": {"name": rig.name, **rig.description.model_dump(mode="json")},
        "arm": rig.carrier.arm.model_dump(mode="json"),
        "links": None if rig.links is None else rig.links.to_json(),
        "camera": {**rig.camera.description(), "lens": rig.description.camera.lens},
        "robot": rig.robot.description(),
        "turntable": None if rig.turntable is None else rig.turntable.description(),
        **_mounting(rig.carrier),
        "board": trajectory.target.to_json() if trajectory.target else None,
        "object": volume and {"centre": list(volume.centre), "size": list(volume.size), "box": volume.corners.tolist()},
    }


def _mounting(carrier: Carrier) -> dict[str, Any]:
    """Where the camera is by the rig file: on the flange, or beside the arm with the target on the flange."""
    if carrier.beside is None:
        return {"eye_to_hand": False, "nominal_flange_from_camera": carrier.flange_from_camera.tolist()}
    return {"eye_to_hand": True, "nominal_base_from_camera": carrier.beside.base_from_camera.tolist()}


def require_same_session(recording: Recording, trajectory: Trajectory, rig: Rig) -> None:
    """Raise UsageError where a session differs from that of a recording, or where one of its devices is another.

    Address and client of the controller do not matter, nor do settings that were added to Koala since, nor a slower motion. A
    device is compared where the recording says which it was.
    """
    now = manifest_of(trajectory, rig)
    remedy = "resume with the original arguments, or choose another --out"
    for part, key, device in DEVICES:
        was, new = recording.part(part).get(key), now[part].get(key)
        if was and was != new:
            why, original = f"{key} {was}, now {new or 'not known'}", f"use the original {device}, or choose another --out"
            raise UsageError(f"was taken with another {device}", where=recording.path, why=why, remedy=original)
    recorded = recorded_trajectory(recording)
    pairs = {
        "trajectory": (recorded, _if_slower(trajectory, recorded)),
        "rig": (_anywhere(recorded_rig(recording)), _anywhere(rig.description)),
        "scene": (recording.manifest.get("scene"), now["scene"]),
        "seed": (recording.manifest.get("seed"), now["seed"]),
        "pose": (recording.pose, now.get(POSE, UPRIGHT)),
    }
    for key, (was, new) in pairs.items():
        if was != new:
            why = "a recording has one session"
            raise UsageError(f"was taken with another {key}", where=recording.path, why=why, remedy=remedy)
    _require_same_black(recording, now["camera"])


def _require_same_black(recording: Recording, camera: dict[str, Any]) -> None:
    """Raise UsageError if the camera adds another black level than it did: it keeps one in sessions with a response."""
    was, new = added_black(recording.part("camera")), added_black(camera)
    if was != new:
        given = f"resume with --radiometry {recording.path / RADIOMETRY}" if was else "resume without --radiometry"
        why = f"{100 * was:.2f} % of the largest value, now {100 * new:.2f} %"
        raise UsageError("was taken with another black level", where=recording.path, why=why, remedy=given)


def _if_slower(trajectory: Trajectory, recorded: Trajectory) -> Trajectory:
    """The trajectory at the recorded speed and acceleration if its own are not above them: the pictures are the same."""
    now, was = trajectory.motion, recorded.motion
    if now.speed > was.speed or now.acceleration > was.acceleration:
        return trajectory
    motion = now.model_copy(update={"speed": was.speed, "acceleration": was.acceleration})
    return trajectory.model_copy(update={"motion": motion})


def _anywhere(rig: RigDescription) -> RigDescription:
    """The rig without addresses, client and expected settings of its controllers, and without the lens, a device by itself.

    The measured response is left out too: the recording keeps its own."""
    plain: dict[str, Any] = {"host": "anywhere", "client": "auto", "installation": InstallationDescription()}
    plain |= {key: RobotDescription.model_fields[key].default for key in ("registers", "stream_deadline_s", "watchdog_hz")}
    plain |= {"cable": None, "max_tool_speed": MAX_TOOL_SPEED}  # how the arm comes to a view is not in the pictures
    blank = {"lens": "", "firmware": "", "radiometry": ""}
    robot, camera = rig.robot.model_copy(update=plain), rig.camera.model_copy(update=blank)
    cameras = {name: one.model_copy(update=blank) for name, one in rig.cameras.items()}
    table = rig.turntable and rig.turntable.model_copy(update={"address": "anywhere", "baud": 115_200, "settle_time_s": 0.0})
    return rig.model_copy(update={"robot": robot, "camera": camera, "cameras": cameras, "turntable": table, "simulation": None})
