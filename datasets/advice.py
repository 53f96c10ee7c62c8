"""What a session that chooses its own views asks, and what its adviser answers: one line of JSON each.

`capture calibrate` asks; `calib advise` answers. They are two programs because neither package knows the other.
"""

import json
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import DatasetError

Figures = tuple[float, float]
"""Limits below which both errors of the hand-eye pose lie with 95 % certainty: translation [mm], rotation [deg]."""


class _Line:
    """A dataclass that is one line of JSON."""

    def to_line(self) -> str:
        """The fields as one line, arrays as lists."""
        content = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}
        return json.dumps(content, allow_nan=False) + "\n"

    @classmethod
    def from_line(cls, line: str) -> Self:
        """The fields from `to_line`. Raises DatasetError for anything else."""
        try:
            content = json.loads(line)
            names = {one.name for one in fields(cls)}  # type: ignore[arg-type]
            if set(content) - names:
                raise ValueError(f"unknown fields {sorted(set(content) - names)}")
            return cls(**content)
        except (ValueError, TypeError) as error:
            raise DatasetError("is no line of a question or an answer", why=str(error)) from None


@dataclass(frozen=True)
class Question(_Line):
    """One question. The adviser looks for new views first."""

    candidates: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4, 4)))
    """(n, 4, 4) base_from_flange of possible next views."""
    anew: bool = False
    """Calibrate from the start before answering, lens and outliers included."""
    finish: bool = False
    """Write the calibration, and say what would make it better."""
    flown: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4, 4)))
    """(n, 4, 4) flange poses that a rehearsal has flown since the last question; a recording holds its own."""
    rehearse: int | None = None
    """Begin the rehearsal of this rig."""

    def __post_init__(self) -> None:
        for name in ("candidates", "flown"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64).reshape(-1, 4, 4))


@dataclass(frozen=True)
class Answer(_Line):
    """What the views so far have shown."""

    views: int = 0
    """Views that show the board."""
    seen: bool = False
    """Whether the newest view shows it."""
    board: NDArray[np.float64] | None = None
    """(4, 4) base_from_board, or flange_from_board, as far as it is known; None before the first view with the board."""
    figures: Figures | None = None
    """None while the views do not allow a calibration."""
    refused: str = ""
    """Why they do not."""
    expected: list[Figures | None] = field(default_factory=list)
    """The figures after each candidate; before a calibration is possible these include broad priors. None: it would not show
    the board."""
    calibration: str = ""
    """Path of the calibration that `finish` has written."""
    hints: list[str] = field(default_factory=list)
    """What would lower the figures, each with an estimate."""
    error: str = ""
    """Why there is no answer, in one line; empty if there is one."""
    truth: Figures | None = None
    """Rehearsal only: the true errors, translation [mm] and rotation [deg]."""
    spread: Figures | None = None
    """Rehearsal only: root mean square errors that an efficient estimator has with these views."""

    def __post_init__(self) -> None:
        if self.board is not None:
            object.__setattr__(self, "board", np.asarray(self.board, np.float64).reshape(4, 4))
        for name in ("figures", "truth", "spread"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _two(getattr(self, name)))
        object.__setattr__(self, "expected", [None if one is None else _two(one) for one in self.expected])


def _two(values: Any) -> Figures:
    first, second = values
    return float(first), float(second)
