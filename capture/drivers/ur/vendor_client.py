"""The vendor's client, ur-rtde. Only a child process imports it: it can hang or crash when a connection breaks."""

import time
from collections.abc import Sequence

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from koala3d.capture.drivers.ur.client import StartError, StartFailure, State, versioned
from koala3d.capture.drivers.ur.rtde.stream import RegistersInUse, RtdeStream

START_S, RELEASED_S = 2.0, 0.5  # until the program runs, and until a client that failed has let go of its registers [s]
VARIABLES = (
    "timestamp actual_q actual_qd actual_TCP_pose joint_temperatures robot_mode safety_mode safety_status_bits runtime_state "
    "target_speed_fraction"
).split()


class VendorClient:
    """Both connections of the library, as a `Client`; with `upper` it takes the registers 24 to 47 and leaves 0 to 23."""

    def __init__(self, host: str, frequency: float, watchdog_hz: float, *, upper: bool = False) -> None:
        self.name, self._is_free = versioned("ur_rtde", "ur-rtde"), False
        try:
            self._receive = RTDEReceiveInterface(host, frequency, VARIABLES)
            flags = int(RTDEControlInterface.FLAG_UPLOAD_SCRIPT)
            flags |= int(RTDEControlInterface.FLAG_UPPER_RANGE_REGISTERS) if upper else 0
            self._control = RTDEControlInterface(host, frequency, flags)
        except RuntimeError as error:  # the library has one class for all its errors: ask the controller which it is
            time.sleep(RELEASED_S)
            raise StartError(str(error), StartFailure.IN_USE if _registers_in_use(host, upper) else StartFailure.OTHER) from None
        deadline = time.monotonic() + START_S
        while not (self._connected and self._control.isProgramRunning()):
            if time.monotonic() > deadline:
                raise StartError("connected, but the control program does not run")
            time.sleep(0.01)
        if not self._control.setWatchdog(watchdog_hz):
            raise StartError("the controller refused the watchdog")

    @property
    def _connected(self) -> bool:
        return self._receive.isConnected() and self._control.isConnected()

    def state(self) -> State:
        """The newest sample. After the connection is lost the library keeps returning the last one."""
        operation = self._control.getAsyncOperationProgressEx()
        return {
            "robot_time_s": self._receive.getTimestamp(),
            "joints": self._receive.getActualQ(),
            "joint_speeds": self._receive.getActualQd(),
            "tcp_pose": self._receive.getActualTCPPose(),
            "joint_temperatures": self._receive.getJointTemperatures(),
            "speed_fraction": self._receive.getTargetSpeedFraction(),
            "safety_bits": self._receive.getSafetyStatusBits(),
            "connected": self._connected,
            "running": self._control.isProgramRunning(),
            "operation": operation.operationId(),
            "moving": operation.isAsyncOperationRunning(),
            "host_time_ns": time.monotonic_ns(),
        }

    def move(self, joints: Sequence[float], speed: float, acceleration: float) -> int | None:
        """Start a motion; the number of the one before, None where the controller did not take it."""
        before = self._control.getAsyncOperationProgressEx().operationId()
        return before if self._control.moveJ(list(joints), speed, acceleration, True) else None

    def stop(self, deceleration: float) -> None:
        """Bring the arm to rest; returns at once."""
        if self._is_free:
            self.freedrive(False)
        self._control.stopJ(deceleration, True)

    def freedrive(self, on: bool) -> bool:
        """Let a person move the arm by hand, or hold it; whether the controller did so."""
        done = bool(self._control.teachMode() if on else self._control.endTeachMode())
        self._is_free = on if done else self._is_free
        return done

    def kick(self) -> None:
        """Show the controller's watchdog that somebody is there."""
        self._control.kickWatchdog()

    def tcp_offset(self) -> list[float]:
        """(6,) position [m] and rotation vector [rad] of the tool in the flange."""
        return self._control.getTCPOffset()

    def leave(self) -> None:
        """Let the arm come to rest."""
        self.stop(2.0)


def _registers_in_use(host: str, upper: bool) -> bool:
    """Whether another client owns the registers that the library writes."""
    try:
        RtdeStream(host, ["timestamp"], [[f"input_int_register_{24 if upper else 0}"]], 1.0).close()
    except RegistersInUse:
        return True
    except OSError:
        return False
    return False
