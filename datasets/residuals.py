"""How well a calibration fits what it was made from, and what it was made from: `residuals` of its file."""

from dataclasses import dataclass, field, fields
from types import NoneType, UnionType
from typing import Any, Self, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

from koala3d.datasets.core.errors import DatasetError


@dataclass(frozen=True)
class Correlation:
    """How the errors of estimated values are correlated."""

    names: list[str]
    """Of the k values."""
    matrix: list[list[float]]
    """(k, k)."""

    @classmethod
    def of(cls, names: tuple[str, ...], covariance: ArrayLike) -> Self:
        """From a (k, k) covariance."""
        values = np.asarray(covariance, np.float64)
        std = np.sqrt(np.diag(values))
        return cls(list(names), (values / np.outer(std, std)).round(6).tolist())

    def among(self, names: tuple[str, ...]) -> np.ndarray:
        """(k, k) correlations of some of the values, in the order of `names`."""
        rows = [self.names.index(name) for name in names]
        return np.asarray(self.matrix, np.float64)[np.ix_(rows, rows)]


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """What does not apply is None: a camera alone has no arm."""

    rms_px: float | None = None
    """Root mean square of the residuals of the views that the calibration was made from."""
    held_out_px: float | None = None
    """The same for views that were predicted from the others, over the corners that the fit kept; None if a fit failed."""
    held_out_mm: float | None = None
    """The same at the target, across the line of sight."""
    held_out_all_px: float | None = None
    """The same as `held_out_px`, over all corners."""
    held_out_all_mm: float | None = None
    sigma_px: float | None = None
    """Estimated standard deviation of a corner per axis."""
    arm_translation_mm: float | None = None
    """Estimated error of the arm's reports per axis."""
    arm_rotation_deg: float | None = None
    arm_stop_mm: float | None = None
    """Part of it that is new at each stop."""
    arm_stop_deg: float | None = None
    arm_links_mm: float | None = None
    """Errors of the links that explain the part that repeats."""
    arm_links_deg: float | None = None
    corners: int | None = None
    """Corners that the fit kept."""
    corners_left_out: int | None = None
    coverage: float | None = None
    """Share of the image in which corners were seen."""
    views_used: int | None = None
    allowed_mm: float | None = None
    """The bound on uncertain poses if it was relaxed."""
    held_out_px_without_link_errors: float | None = None
    """Errors on held-out views as above, if the arm's links are taken as nominal."""
    held_out_mm_without_link_errors: float | None = None
    held_out_all_px_without_link_errors: float | None = None
    held_out_all_mm_without_link_errors: float | None = None
    settled: bool | None = None
    """Whether the refinement converged."""
    views_unseen: list[str] = field(default_factory=list)
    """Views in which no target was found."""
    views_left_out: list[str] = field(default_factory=list)
    """Views that did not take part, and in `why_left_out` the reasons."""
    why_left_out: dict[str, str] = field(default_factory=dict)
    view_rms_px: dict[str, float] = field(default_factory=dict)
    closed_form: dict[str, Any] | None = None
    """Residuals of the closed form from which the refinement began, and how far it moved."""
    links_not_shown: list[str] | None = None
    """Errors of the links that the views do not determine."""
    target_shape: list[float] | None = None
    """Stretch along x and y [1], sag along x and y [m]."""
    target_shape_std: list[float] | None = None
    """Standard deviations; 0 where it was not estimated."""
    target_seems: list[float] | None = None
    """The shape that the corners ask for if none was estimated."""
    boards: list[dict[str, Any]] | None = None
    """Each of several targets: name, counts, error and pose."""
    camera_correlation: Correlation | None = None
    """Of the intrinsics."""
    rig_correlation: Correlation | None = None
    """Of everything that was estimated."""
    latency_s: float | None = None
    """How much later the pictures' time stamps are than their exposures on the clock of the poses; of ROS bags."""
    latency_std_s: float | None = None
    latency_pictures: int | None = None
    """Pictures of a moving arm from which it was estimated."""
    latency_px_per_ms: float | None = None
    """How far the target moves in these pictures in a millisecond of latency, and how far an exposure of one blurs it."""
    turntable: dict[str, Any] | None = None
    """How the axis of a turntable was found."""

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary of what applies."""
        found = {name: value for name, value in vars(self).items() if value is not None}
        return {name: vars(value) if isinstance(value, Correlation) else value for name, value in found.items()}

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """From `to_json`'s dictionary. Raises DatasetError where a value is not of its kind."""
        if not isinstance(content, dict):
            raise DatasetError("is not made of names and values", where=where, why=str(content)[:80])
        found = {}
        for one in fields(cls):
            if (value := content.get(one.name)) is not None:
                found[one.name] = _checked(value, one.type, f"{where}, {one.name}")
        return cls(**found)


def _checked(value: Any, kind: Any, where: str) -> Any:
    """`value` if it is of the kind that a field has, apart from None."""
    main = next(one for one in get_args(kind) if one is not NoneType) if isinstance(kind, UnionType) else kind
    if main is Correlation:
        if isinstance(value, dict) and _is_square(value.get("names"), value.get("matrix")):
            return Correlation(value["names"], value["matrix"])
    elif main in (float, int, bool):
        allowed = bool if main is bool else (int, float)
        if isinstance(value, allowed) and isinstance(value, bool) == (main is bool):
            return value
    elif isinstance(value, get_origin(main)):
        return value
    raise DatasetError("is not of its kind", where=where, why=str(value)[:80], remedy="calibrate again")


def _is_square(names: Any, matrix: Any) -> bool:
    """Whether these are k names and a (k, k) matrix of numbers."""
    if not (isinstance(names, list) and isinstance(matrix, list) and 0 < len(names) == len(matrix)):
        return False
    rows = all(isinstance(row, list) and len(row) == len(names) for row in matrix)
    return rows and all(isinstance(one, int | float) for row in matrix for one in row)
