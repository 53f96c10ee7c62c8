"""Arguments and options that several `capture` commands share."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

SIMULATION = "Simulation"
"""Panel of options that mean nothing to a real rig."""
TrajectoryName = Annotated[
    Path, Argument(metavar="TRAJECTORY", help="A trajectory: its name, as 'capture list' shows it, or a YAML file.")
]
Settings = Annotated[
    list[str] | None, Option("--set", metavar="KEY=VALUE", help="Change a value of the trajectory: camera.binning=4.")
]
Recorded = Annotated[Path, Argument(metavar="RECORDING", help="Folder that 'capture run' has written.")]
RigName = Annotated[
    str,
    Option(
        metavar="RIG",
        help="A rig: a name that 'capture list' shows, or a YAML file. 'sim' is the simulated rig, 'sim:RIG' simulates another.",
    ),
]
Scene = Annotated[
    str, Option(help="A scene of 'capture list'. Default: one that fits the trajectory.", rich_help_panel=SIMULATION)
]
Seed = Annotated[int, Option(min=0, help="Random seed; the same seed is the same rig.", rich_help_panel=SIMULATION)]
TimeScale = Annotated[
    float, Option(min=0.1, max=1000, help="Speed of the arm relative to real time.", rich_help_panel=SIMULATION)
]
SessionFolder = Annotated[
    Path, Option("--out", metavar="SESSION", help="New recording to write, or with --resume an existing one.")
]
Resume = Annotated[bool, Option("--resume", help="Continue an interrupted session.")]
TakeOver = Annotated[
    bool, Option("--take-over", help="End the program that runs on the robot's controller. Default: refuse to start.")
]
Ignore = Annotated[
    list[str] | None,
    Option("--ignore", metavar="LINE", help="A line of 'capture doctor' that may be wrong; repeatable. Recordings keep it."),
]
SAFETY = "The arm's motion"
Slow = Annotated[
    float,
    Option(
        "--slow",
        metavar="FACTOR",
        min=0.01,
        max=1.0,
        help="Slow every move down: 0.1 is a tenth of the speed. A recording resumes at any speed.",
        rich_help_panel=SAFETY,
    ),
]
Confirm = Annotated[
    bool,
    Option("--confirm", help="Say what the next move is and ask on the terminal before it.", rich_help_panel=SAFETY),
]
CalibrationFile = Annotated[
    Path | None, Option("--calibration", metavar="CALIBRATION.json", help="Calibration file, which says what the pictures show.")
]
MeshScale = Annotated[
    float, Option("--mesh-scale", min=1e-6, max=1000, help="Metres per unit of the mesh: 0.001 for millimetres.")
]
