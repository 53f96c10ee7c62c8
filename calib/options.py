"""Options that several `calib` commands share. A command with a parameter of one of these classes has all its options."""

import inspect
import math
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import UsageError, nearest

if TYPE_CHECKING:
    from koala3d.calib.handeye.model import Accuracy
    from koala3d.calib.sessions.session import TargetSession
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.targets.board import Board

READING, CAMERA = "How the session is read", "Camera"
ACCURACY, OFF = "How accurate the arm is", "What is off by the same in all views"

RecordingPath = Annotated[
    Path,
    Argument(metavar="RECORDING", help="Folder made by 'capture run', or a ROS bag, with a calibration target in view."),
]
Target = Annotated[
    Path | None,
    Option(
        "--board",
        help="Target to look for instead of the recording's own: a shipped name or a file. ROS bags need it.",
        rich_help_panel=READING,
    ),
]
Import = Annotated[
    Path | None,
    Option("--import", help="How to read a folder of images and poses: a shipped name or a YAML file.", rich_help_panel=READING),
]
LeaveOut = Annotated[
    bool,
    Option(
        "--leave-out",
        help="Leave out imported pictures without a pose, instead of refusing the session.",
        rich_help_panel=READING,
    ),
]
Lens = Annotated[str, Option("--lens", help="Lens model: auto, brown, rational, fisheye or splined.", rich_help_panel=CAMERA)]
Intrinsics = Annotated[
    Path | None,
    Option("--intrinsics", help="Calibration file with the camera. Default: estimate it as well.", rich_help_panel=CAMERA),
]
ArmMm = Annotated[float, Option("--arm-mm", help="The arm's stated position accuracy per axis [mm].", rich_help_panel=ACCURACY)]
ArmDeg = Annotated[
    float, Option("--arm-deg", help="The arm's stated orientation accuracy per axis [deg].", rich_help_panel=ACCURACY)
]
JointDeg = Annotated[
    float,
    Option("--joint-deg", help="Accuracy of the joints' zeros [deg]. Above 0, joint offsets are estimated.", rich_help_panel=OFF),
]
LinkMm = Annotated[
    float,
    Option(
        "--link-mm",
        help="Accuracy of the links' lengths [mm]. Above 0, errors of all lengths d and a are estimated.",
        rich_help_panel=OFF,
    ),
]
LinkDeg = Annotated[
    float,
    Option(
        "--link-deg",
        help="Accuracy of the links' angles [deg]. Above 0, errors of all alpha and theta are estimated.",
        rich_help_panel=OFF,
    ),
]
PrintPercent = Annotated[
    float,
    Option(
        "--print-percent",
        help="Accuracy of the printed target's lengths [%]. Above 0, its stretch is estimated.",
        rich_help_panel=OFF,
    ),
]
SagMm = Annotated[
    float, Option("--sag-mm", help="How far the target may be bent [mm]. Above 0, its sag is estimated.", rich_help_panel=OFF)
]
AllowMm = Annotated[
    float,
    Option(
        "--allow-mm",
        help="Accept poses uncertain by up to this many mm, for an inaccurate arm; the result is marked.",
        rich_help_panel=ACCURACY,
    ),
]


@dataclass(frozen=True, kw_only=True)
class Inexact:
    """What may be off by the same in all views. It is estimated where the stated accuracy is above 0."""

    joint_deg: JointDeg = 0.0
    link_mm: LinkMm = 0.0
    link_deg: LinkDeg = 0.0
    print_percent: PrintPercent = 0.0
    sag_mm: SagMm = 0.0


@dataclass(frozen=True, kw_only=True)
class Arm:
    """How accurate the arm is."""

    arm_mm: ArmMm = 0.05
    arm_deg: ArmDeg = 0.01

    def accuracy(self, inexact: Inexact | None = None) -> "Accuracy":
        """The accuracy of arm and target as given on the command line. Raises UsageError where it is impossible."""
        from koala3d.calib.handeye.model import Accuracy

        inexact = inexact or Inexact()
        stated = {"--arm-mm": self.arm_mm, "--arm-deg": self.arm_deg}
        given = stated | {f"--{field.name.replace('_', '-')}": getattr(inexact, field.name) for field in fields(Inexact)}
        for name, value in given.items():
            if not (math.isfinite(value) and value >= (1e-9 if name in stated else 0)):
                raise UsageError("accuracy must be a positive number", where=name, why=f"{value:g} given")
        return Accuracy(
            1e-3 * self.arm_mm,
            math.radians(self.arm_deg),
            math.radians(inexact.joint_deg),
            1e-3 * inexact.link_mm,
            math.radians(inexact.link_deg),
            inexact.print_percent / 100,
            1e-3 * inexact.sag_mm,
        )


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """A recording of a target, or a folder to import."""

    recording: RecordingPath
    description: Import = None
    leave_out: LeaveOut = False

    def __post_init__(self) -> None:
        """Of a ROS bag, take the recording that is made of it."""
        if self.description is None:
            from koala3d.datasets.bags.command import opened

            object.__setattr__(self, "recording", opened(self.recording))

    def observe(
        self, board: "Board | None" = None, calibration: "Calibration | None" = None
    ) -> "tuple[TargetSession, Calibration | None]":
        """Find the target, or `board`, in every image, with a progress bar; and the camera that an imported session brings.

        `calibration` says what a ROS bag does not: its target, and how late its pictures are.
        """
        from koala3d.calib.sessions.importer import count_views, observe_folder
        from koala3d.datasets.calibration import Calibration

        with console.progress("finding the target", count_views(self.recording, self.description), "views") as bar:

            def seen(words: str) -> None:
                bar.note(words)
                bar.advance()

            options = {"board": board, "seen": seen, "leave_out": self.leave_out, "calibration": calibration}
            session, camera = observe_folder(self.recording, self.description, **options)
        return session, Calibration(camera, {}) if camera else None


@dataclass(frozen=True, kw_only=True)
class RigOptions(Arm, Pictures):
    """A session to calibrate the whole rig from."""

    target: Target = None
    intrinsics: Intrinsics = None
    lens: Lens = "auto"

    def read(self, board: "Board | None" = None) -> "tuple[TargetSession, Calibration | None]":
        """The session of its target, or of `board`, and the camera that is given. Options are checked before pictures."""
        from koala3d.calib.targets.commands import board_named
        from koala3d.datasets.calibration import Calibration

        check_lens(self.lens)
        self._require_still()
        given = Calibration.load(self.intrinsics) if self.intrinsics is not None else None
        board = board_named(self.target) if board is None and self.target is not None else board
        session, camera = self.observe(board)
        return session, given or camera

    def _require_still(self) -> None:
        """Raise UsageError for a recording in which a turntable turned the target: it has no single pose in the base."""
        from koala3d.datasets.recording import MANIFEST, Recording

        if self.description is None and (self.recording / MANIFEST).is_file() and Recording.open(self.recording).turns:
            remedy = "record a target that stands still; then 'calib turntable' takes this recording"
            raise UsageError("the target turned on a table", where=self.recording, remedy=remedy)


def allowed_m(allow_mm: float) -> float:
    """The bound of `--allow-mm` in metres. Raises UsageError where it is stricter than the usual one, or no number."""
    from koala3d.calib.handeye.uncertainty import MAX_STD_M

    if not 1e3 * MAX_STD_M <= allow_mm < math.inf:
        why, remedy = f"{allow_mm:g} given", f"{1e3 * MAX_STD_M:g} mm is the usual bound; give more"
        raise UsageError("cannot be stricter than usual", where="--allow-mm", why=why, remedy=remedy)
    return 1e-3 * allow_mm


def check_lens(lens: str) -> None:
    """Raise UsageError where there is no such lens."""
    from koala3d.calib.intrinsics.lenses import LENSES

    if lens not in LENSES:
        raise UsageError(f"no lens called {lens!r}", where="--lens", remedy=nearest(lens, LENSES))


def spread(command: Callable[..., None]) -> Callable[..., None]:
    """`command` with each parameter that is one of these classes spread out into its fields, as typer reads them."""
    hints = get_type_hints(command)
    grouped: dict[str, type] = {name: kind for name, kind in hints.items() if isinstance(kind, type) and is_dataclass(kind)}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        parameters += _options(grouped[name]) if name in grouped else [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)]

    @wraps(command)
    def outer(**values: Any) -> None:
        for name, kind in grouped.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        command(**values)

    outer.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    outer.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return outer


def _options(kind: type) -> list[inspect.Parameter]:
    """The fields of a class as parameters."""
    empty, keyword = inspect.Parameter.empty, inspect.Parameter.KEYWORD_ONLY
    found = [(field.name, empty if field.default is MISSING else field.default, field.type) for field in fields(kind)]
    return [inspect.Parameter(name, keyword, default=default, annotation=option) for name, default, option in found]
