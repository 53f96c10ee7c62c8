"""Drives the arm along a trajectory without the camera, slowly, and records nothing: so that a person can watch the plan."""

from pathlib import Path

from koala3d.capture.doctor.examine import examination
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning import Obstacles, connect, plan
from koala3d.capture.recording.writer import Advance
from koala3d.capture.rig.arms import open_arm
from koala3d.capture.rig.controllers import host_of
from koala3d.capture.rig.links import reported_links
from koala3d.capture.rig.naming import describe
from koala3d.capture.sessions.start import SessionOptions

SLOW = 0.25
"""Factor of every speed, unless the person names another."""


def drive(trajectory: Trajectory, options: SessionOptions, advance: Advance) -> int:
    """Move to every view; returns how many there are. A turntable is left alone.

    Raises UnreachableError: a view cannot be taken, nothing has moved. CaptureError: an error of the arm, which stands still.
    """
    description = describe(options.rig)
    take_over, ignore = options.take_over, options.ignore
    examine = examination(Path.cwd(), trajectory.upwards, take_over=take_over, ignore=ignore, cameras=False)
    moves = options.moves()
    with open_arm(
        options.rig,
        trajectory,
        seed=options.seed,
        links_seed=options.seed,
        time_scale=options.time_scale,
        examine=examine,
        take_over=take_over,
    ) as (robot, controller):
        carrier = description.carrier().as_built(reported_links(description, host_of(description, controller)))
        planned, obstacles = plan(trajectory, carrier), Obstacles.of(trajectory, carrier)
        for number, view in enumerate(planned):
            name = f"view {view.viewpoint.name}"
            path = view.path if number else connect(robot.state().joints, view.joints, obstacles, where=name)
            moves.along(robot, path, trajectory.motion, obstacles, view=name)
            advance(view.viewpoint.name)
    return len(planned)
