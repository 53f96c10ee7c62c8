"""Arguments and options that several `capture` commands share."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

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
        help="'sim' for the simulated rig, a rig by name ('capture list') or file, or 'sim:' and either: its simulation.",
    ),
]
TimeScale = Annotated[float, Option(min=0.1, max=1000, help="Simulation only: speed of the arm relative to real time.")]
TakeOver = Annotated[bool, Option("--take-over", help="End a program that runs on the robot; else it is left alone.")]
CalibrationFile = Annotated[
    Path | None,
    Option("--calibration", metavar="CALIBRATION.json", help="Camera and mount as they were calibrated: what pictures show."),
]
MeshScale = Annotated[
    float, Option("--mesh-scale", min=1e-6, max=1000, help="Metres per unit of the mesh: 0.001 for millimetres.")
]
