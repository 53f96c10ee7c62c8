"""All commands by number, and what the vendor's client calls them."""

from koala3d.capture.sim.controller.commands import joint_moves, paths, questions, settings, steering, stops, tool_moves
from koala3d.capture.sim.controller.commands.registers import Action, Answer

ACTIONS: dict[int, Action] = {
    **joint_moves.ACTIONS,
    **tool_moves.ACTIONS,
    **paths.ACTIONS,
    **steering.ACTIONS,
    **stops.ACTIONS,
    **settings.ACTIONS,
}
"""What commands do; what they return blocks the program until it ends."""
ANSWERS: dict[int, Answer] = {**questions.ANSWERS, **settings.ANSWERS}
"""What commands ask for."""
EVERY_CYCLE = frozenset({9, 10, 11, 24, 25, 26, 58})
"""Commands that are carried out in every cycle while they are in the register, and never answered with done."""
_CALLS = """
    1 moveJ, 2 moveJ_IK, 3 moveL, 4 moveL_FK, 6 forceMode, 7 forceModeStop, 8 zeroFtSensor, 9 speedJ, 10 speedL, 11 servoJ,
    12 servoC, 15 speedStop, 16 servoStop, 17 setPayload, 18 teachMode, 19 endTeachMode, 20 forceModeSetDamping,
    21 forceModeSetGainScaling, 24 servoL, 25 toolContact, 26 getStepTime, 27 getActualJointPositionsHistory,
    28 getTargetWaypoint, 29 setTcp, 30 getInverseKinematics, 31 triggerProtectiveStop, 33 stopL, 34 stopJ, 35 setWatchdog,
    36 isPoseWithinSafetyLimits, 37 isJointsWithinSafetyLimits, 38 getJointTorques, 39 poseTrans, 40 getTCPOffset, 41 jogStart,
    42 jogStop, 43 getForwardKinematics, 44 getForwardKinematics, 45 movePath, 46 getInverseKinematics, 47 isSteady,
    51 moveUntilContact, 52 freedriveMode, 53 endFreedriveMode, 54 getFreedriveStatus, 55 setExternalForceTorque,
    56 ftRtdeInputEnable, 57 enableExternalFtSensor, 58 getActualToolFlangePose, 59 setGravity,
    60 getInverseKinematicsHasSolution, 61 getInverseKinematicsHasSolution, 62 startContactDetection, 63 stopContactDetection,
    64 readContactDetection, 65 setTargetPayload, 66 directTorque, 67 getMassMatrix, 68 getCoriolisAndCentrifugalTorques,
    69 getTargetJointAccelerations, 70 getJacobian, 71 getJacobianTimeDerivative
"""
CALLS: dict[int, str] = {int(number): name for number, name in (one.split() for one in _CALLS.split(","))}
"""The vendor's names by number."""


def called(number: int) -> str:
    """A command in words, with the name that the vendor's client has for it."""
    return f"{CALLS[number]} (command {number})" if number in CALLS else f"command {number}"
