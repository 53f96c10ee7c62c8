"""What can go wrong in a calibration, said in one line each."""

from koala3d.datasets.core.errors import KoalaError


class CalibrationError(KoalaError):
    """A calibration could not be made, or would not be worth having."""


class TargetError(CalibrationError):
    """The calibration target is not described, not known or not seen often enough."""


class Unobservable(CalibrationError):
    """The views leave something undetermined; the message names what, and which motion would show it."""
