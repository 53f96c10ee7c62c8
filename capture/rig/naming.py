"""What the name of a rig means: its description, whether it is simulated, and the scene that a simulation shows."""

from koala3d import configs
from koala3d.capture.model.rig import RigDescription, load_rig
from koala3d.capture.model.trajectory import Trajectory
from koala3d.datasets.core.errors import UsageError

SIMULATED = "sim"  # name of the simulated rig; "sim:NAME" is the simulation of another rig


def describe(name: str) -> RigDescription:
    """The description of a rig: "sim", a shipped rig by name, or a rig file, the last two also after "sim:".

    Raises UsageError where it is missing or wrong.
    """
    if name == SIMULATED:
        return RigDescription()
    if name.startswith(f"{SIMULATED}:"):
        found = describe(name.removeprefix(f"{SIMULATED}:"))
        alone = None if found.simulation is None else found.simulation.model_copy(update={"side_port": None})
        return found.model_copy(update={"simulation": alone})
    path = configs.find("rigs", name, others=(SIMULATED,))
    if not path.exists():
        remedy = f"--rig takes {SIMULATED}, a name that 'capture list' shows, or a rig file"
        raise UsageError("no such file", where=name, remedy=remedy)
    return load_rig(path)


def is_simulated(name: str, description: RigDescription) -> bool:
    """Whether a rig is a simulated one."""
    return is_started(name, description) or description.simulation is not None


def is_started(name: str, description: RigDescription) -> bool:
    """Whether the rig is a simulated one whose controller is started by the command."""
    if name == SIMULATED or name.startswith(f"{SIMULATED}:"):
        return True
    return description.simulation is not None and description.simulation.side_port is None


def scene_for(rig: str, scene: str, trajectory: Trajectory) -> str:
    """The simulated scene for a trajectory: the named one, or else one that fits the trajectory; "" for a real rig.

    Raises UsageError: there is no such scene, the trajectory does not fit it, or the rig is real.
    """
    description = describe(rig)
    simulation = description.simulation
    if not is_simulated(rig, description):
        if scene:
            raise UsageError("--scene is only for simulated rigs", where=rig, remedy="leave it out, or use --rig sim")
        return ""
    from koala3d.capture.sim.laboratory.views import check_scene

    if not scene:
        scene = "board" if trajectory.target is not None else "gold_head" if simulation is None else simulation.scene
    return check_scene(scene, trajectory)
