"""Arguments and options that several `capture` commands share."""

from pathlib import Path
from typing import Annotated

import typer

TrajectoryName = Annotated[
    Path, typer.Argument(metavar="TRAJECTORY", help="A trajectory: its name, as 'capture list' shows it, or a YAML file.")
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change a value of the trajectory: camera.binning=4.")
]
Recorded = Annotated[Path, typer.Argument(metavar="RECORDING", help="Folder that 'capture run' has written.")]
RigName = Annotated[
    str, typer.Option(metavar="RIG", help="'sim' for the simulated rig, the name of a rig ('capture list'), or a rig file.")
]
TimeScale = Annotated[float, typer.Option(min=0.1, max=1000, help="Simulation only: speed of the arm relative to real time.")]
