"""The numbers in `safety_mode` and `robot_mode` of a UR controller, by the names that its dashboard uses.

From Universal Robots, "Real-Time Data Exchange guide", and for the newer ones from the maker's client library.
"""

from enum import IntEnum


class SafetyMode(IntEnum):
    """What the safety system does to the arm."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED_SAFETY_MODE = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13
    TP_THREE_POSITION_ENABLING_STOP = 14
    IMMI_EMERGENCY_STOP = 15
    IMMI_SAFEGUARD_STOP = 16
    PROFISAFE_WAITING_FOR_PARAMETERS = 17
    PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP = 18
    PROFISAFE_SAFEGUARD_STOP = 19
    PROFISAFE_EMERGENCY_STOP = 20
    SAFETY_API_SAFEGUARD_STOP = 22


class RobotMode(IntEnum):
    """Whether the arm has power, and its brakes are released."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


def name_of(modes: type[IntEnum], number: int) -> str:
    """Name of a number among `modes`; the number itself if it is none of them."""
    return modes(number).name if number in list(modes) else str(number)


def may_move(safety: str) -> bool:
    """Whether an arm may move in a safety mode, by its name."""
    return safety in (SafetyMode.NORMAL.name, SafetyMode.REDUCED.name)


def is_guarded(safety: str) -> bool:
    """Whether a fence, a scanner or an enabling switch holds the arm. A controller may be set to go on by itself afterwards."""
    return safety.endswith(("SAFEGUARD_STOP", "ENABLING_STOP"))
