"""What a UR controller answers to every question, collected once: dashboard, primary interface, and a few samples of RTDE.

The connections only read. Each has a deadline and may fail by itself: then its part is None and `silent` says why.
"""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.drivers.ur.interfaces import robot_api
from koala3d.capture.drivers.ur.interfaces.dashboard import Dashboard
from koala3d.capture.drivers.ur.interfaces.primary import Primary, listen
from koala3d.capture.drivers.ur.interfaces.robot_api import RobotApi
from koala3d.capture.drivers.ur.rtde.stream import RtdeStream
from koala3d.capture.model.kinematics import pose_from_six
from koala3d.datasets import pose

QUESTIONS = ("PolyscopeVersion", "get serial number", "is in remote control", "programState", "safetystatus", "robotmode")
OUTPUTS = (
    "timestamp actual_q actual_TCP_pose actual_tool_accelerometer payload payload_cog safety_mode robot_mode runtime_state "
    "target_speed_fraction"
).split()
RATE_HZ, SAMPLE_S = 125.0, 4.0  # of the samples, and until the first one has come


@dataclass(frozen=True)
class ControllerReport:
    """All that the controller says."""

    host: str
    dashboard: dict[str, str] | None
    """Reply to each of `QUESTIONS`."""
    primary: Primary | None
    sample: dict[str, Any] | None
    """The newest values of `OUTPUTS`."""
    arrivals: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) time of each sample on the host's monotonic clock and on the controller's [s]."""
    api: RobotApi | None = None
    """What the Robot API of PolyScope X says; not asked beside a dashboard."""
    joints: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 6)))
    """(n, 6) measured angles of the samples [rad]."""
    silent: tuple[str, ...] = ()
    """Why a part is missing."""

    @property
    def base_from_flange(self) -> NDArray[np.float64] | None:
        """(4, 4) as the controller reports it [m]: its tool pose without the tool offset; None where one is not known."""
        if self.sample is None or self.primary is None or self.primary.tcp_offset is None:
            return None
        return pose_from_six(self.sample["actual_TCP_pose"]) @ pose.inverse(pose_from_six(self.primary.tcp_offset))


def ask(host: str, seconds: float) -> ControllerReport:
    """Put every question to a controller, and listen to its samples for some time."""
    silent: list[str] = []

    def tried(part: Any, *arguments: Any) -> Any:
        try:
            return part(*arguments)
        except (OSError, ValueError, RigConnectionError) as error:
            silent.append(str(error))
            return None

    replies, primary = tried(_dashboard, host), tried(listen, host)
    api = robot_api.ask(host) if replies is None else None
    sample, arrivals, joints = tried(_samples, host, seconds) or (None, np.zeros((0, 2)), np.zeros((0, 6)))
    return ControllerReport(host, replies, primary, sample, arrivals, api, joints, tuple(silent))


def _dashboard(host: str) -> dict[str, str]:
    dashboard = Dashboard.connect(host)
    try:
        return {question: dashboard.ask(question) for question in QUESTIONS}
    finally:
        dashboard.close()


def _samples(host: str, seconds: float) -> tuple[dict[str, Any], NDArray[np.float64], NDArray[np.float64]]:
    stream = RtdeStream(host, OUTPUTS, [], RATE_HZ)
    try:
        newest = stream.newest(SAMPLE_S)
        if newest is None:
            raise TimeoutError(f"RTDE sends no samples within {SAMPLE_S:.0f} s")
        begun = time.monotonic()
        arrivals, joints = [(begun, newest["timestamp"])], [newest["actual_q"]]
        while (left := begun + seconds - time.monotonic()) > 0 and stream.connected:
            if (sample := stream.newest(left)) is not None:
                newest = sample
                arrivals.append((time.monotonic(), sample["timestamp"]))
                joints.append(sample["actual_q"])
        arrivals.append((time.monotonic(), newest["timestamp"]))  # the gap that is still open
        return newest, np.array(arrivals), np.array(joints)
    finally:
        stream.close()
