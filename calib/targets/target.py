"""Calibration targets: what they look like, and where their corners are in a picture.

Board frame: origin in the outer corner of the first square, x along the rows of squares, y along the columns,
z into the board (OpenCV's). Corners are numbered row by row; corner (i, j) lies at ((i + 1), (j + 1), 0) square lengths.

A grid of tags (AprilTag or ArUco) has one tag in the middle of each square, numbered row by row from `first_id`; tag n has the corners
4 n to 4 n + 3, clockwise from the upper left one.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.errors import TargetError
from calib.targets import corners
from datasets import conventions
from datasets.core.errors import nearest

KINDS = ("charuco", "chessboard", "tags")
MIN_CORNERS = 8
"""A view of a checkered target with fewer corners is left out; of tags, one whole tag will do."""
_SUBPIXEL = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)


@dataclass(frozen=True)
class Observation:
    """Corners of a target in one view."""

    name: str
    """Name of the view."""
    ids: NDArray[np.int64]
    """(n,) corner numbers."""
    pixels: NDArray[np.float64]
    """(n, 2) where they are seen, first pixel's centre at (0.5, 0.5) [px]."""
    points: NDArray[np.float64]
    """(n, 3) where they are on the board, board frame [m]."""


@dataclass(frozen=True)
class Board:
    """A flat target: a ChArUco board, a plain chessboard that must be seen whole, or a grid of tags."""

    type: str
    """"charuco", "chessboard" or "tags"."""
    squares_x: int
    """Squares along x."""
    squares_y: int
    """Squares along y."""
    square_length_m: float
    """Side of a square [m]."""
    marker_length_m: float = 0.0
    """Side of a marker, its black border included [m]; not of a chessboard."""
    dictionary: str = "DICT_5X5_100"
    """OpenCV's name of the marker dictionary; not of a chessboard."""
    legacy_pattern: bool = False
    """True for boards printed by OpenCV before 4.6 with an even number of rows."""
    first_id: int = 0
    """Number of the first tag; tags only."""

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Board as a recording's manifest describes it under `board`; keys that are not ours are passed over."""
        if not isinstance(content, dict):
            raise TargetError("recording describes no calibration target", where=where,
                              remedy="record a target session, for instance with --scene charuco_board")  # fmt: skip
        known = {k: content[k] for k in cls.__dataclass_fields__ if content.get(k) is not None}
        try:
            board = cls(**known)
            board = cls(str(board.type), int(board.squares_x), int(board.squares_y), float(board.square_length_m),
                        float(board.marker_length_m), str(board.dictionary), bool(board.legacy_pattern),
                        int(board.first_id))  # fmt: skip
        except (TypeError, ValueError) as error:
            raise TargetError("calibration target is not described completely", where=where, why=str(error)) from None
        board._check(where)
        return board

    def _check(self, where: object) -> None:
        def refuse(why: str, remedy: str = "") -> None:
            raise TargetError("calibration target cannot exist", where=where, why=why, remedy=remedy)

        if self.type not in KINDS:
            refuse(f"type {self.type!r}", nearest(self.type, KINDS))
        least = 1 if self.type == "tags" else 3
        if min(self.squares_x, self.squares_y) < least or not 0 < self.square_length_m < np.inf:
            refuse(f"{self.squares_x}x{self.squares_y} squares of {self.square_length_m:g} m")
        if self.type != "chessboard":
            names = [n for n in dir(cv2.aruco) if n.startswith("DICT_")]
            if self.dictionary not in names:
                refuse(f"dictionary {self.dictionary!r}", nearest(self.dictionary, names))
            if not (
                0 < self.marker_length_m < self.square_length_m
                or (self.type == "tags" and 0 < self.marker_length_m == self.square_length_m)
            ):
                refuse(f"markers of {self.marker_length_m:g} m in squares of {self.square_length_m:g} m")
            self._check_tags(refuse)

    def _check_tags(self, refuse: Callable[[str], None]) -> None:
        """Refuse more markers than the dictionary has."""
        have = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary)).bytesList)
        squares = self.squares_x * self.squares_y
        need = self.first_id + squares if self.type == "tags" else squares // 2
        if need > have or self.first_id < 0:
            refuse(f"{need} markers, {self.dictionary} has {have}")

    @property
    def is_ambiguous(self) -> bool:
        """True for a chessboard that looks the same when it is turned by 180 degrees."""
        return self.type == "chessboard" and (self.squares_x + self.squares_y) % 2 == 0

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary that `from_json` reads."""
        return asdict(self)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(corners, 3) inner corners, or corners of tags, in the board frame [m]."""
        if self.type == "tags":
            column, row = np.meshgrid(np.arange(self.squares_x), np.arange(self.squares_y))
            centres = (np.stack([column.ravel(), row.ravel()], -1) + 0.5) * self.square_length_m
            around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.marker_length_m / 2
            flat = (centres[:, None] + around).reshape(-1, 2)
            return np.column_stack([flat, np.zeros(len(flat))])
        x, y = np.meshgrid(np.arange(1, self.squares_x), np.arange(1, self.squares_y))
        return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1) * self.square_length_m

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's object for the same ChArUco board; it can draw it."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.squares_x, self.squares_y), self.square_length_m, self.marker_length_m, dictionary)
        board.setLegacyPattern(self.legacy_pattern)
        return board

    def detect(self, grey: NDArray[np.float32], name: str) -> Observation | None:
        """Find the target in a picture.

        Args:
            grey: (height, width) brightness, sRGB 0..1.
            name: of the view, for the record.

        Returns:
            The corners, or None where fewer than 8 are seen or all of them lie on one line.
        """
        picture = np.ascontiguousarray(np.rint(np.clip(grey, 0, 1) * 255), np.uint8)
        search = {"charuco": self._charuco_corners, "chessboard": self._chessboard_corners, "tags": self._tag_corners}
        found = search[self.type](picture)
        if found is None or len(found[0]) < self.min_corners:
            return None
        ids, places = found
        points = self.points[ids]
        if np.linalg.matrix_rank(points - points.mean(0), tol=1e-9) < 2:
            return None
        if self.type == "tags":
            places = places.astype(np.float64)
        else:
            places = self._refined(np.ascontiguousarray(grey, np.float32), ids, places)
        return Observation(name, ids, conventions.pixels_from_opencv(places), points)

    @property
    def min_corners(self) -> int:
        """Fewest corners that make a view."""
        return 4 if self.type == "tags" else MIN_CORNERS

    def _tag_corners(self, picture: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.float32]] | None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        quads, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(picture)
        if ids is None:
            return None
        numbers = ids.ravel() - self.first_id
        chosen = [i for i, n in enumerate(numbers) if 0 <= n < self.squares_x * self.squares_y]
        if not chosen or len(set(numbers[chosen])) < len(chosen):
            return None
        chosen.sort(key=lambda i: numbers[i])
        corner = (4 * numbers[chosen][:, None] + np.arange(4)).ravel().astype(np.int64)
        return corner, np.concatenate([quads[i].reshape(4, 2) for i in chosen])

    def _charuco_corners(self, picture: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.float32]] | None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        detector = cv2.aruco.CharucoDetector(self.charuco, cv2.aruco.CharucoParameters(), parameters)
        places, ids, _, _ = detector.detectBoard(picture)
        if ids is None or len(ids) == 0:
            return None
        return ids.reshape(-1).astype(np.int64), places.reshape(-1, 2)

    def _chessboard_corners(self, picture: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.float32]] | None:
        columns, rows = self.squares_x - 1, self.squares_y - 1
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, places = cv2.findChessboardCorners(picture, (columns, rows), flags=flags)
        if not found:
            return None
        places = places.reshape(rows, columns, 2)
        if not self.is_ambiguous and not _first_square_is_dark(picture, places):
            places = places[::-1, ::-1]
        return np.arange(rows * columns), np.ascontiguousarray(places.reshape(-1, 2))

    def _refined(self, grey: NDArray[np.float32], ids: NDArray[np.int64], found: NDArray[np.float32]) -> NDArray[np.float64]:
        """(n, 2) corners to a few hundredths of a pixel: `cornerSubPix` brings them near, a fit of the picture there."""
        points = self.points[ids, :2]
        metres, pixels = np.linalg.norm(points[:, None] - points, axis=-1), np.linalg.norm(found[:, None] - found, axis=-1)
        neighbours = (metres > 0) & (metres < 1.01 * self.square_length_m)
        scale = np.percentile(pixels[neighbours] / metres[neighbours], 10) if neighbours.any() else 0.0
        half = int(np.clip(0.8 * scale * self._clear_m / np.sqrt(2), 2, 10))
        near = cv2.cornerSubPix(grey, found.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), _SUBPIXEL).reshape(-1, 2)
        return corners.fit(grey, near.astype(np.float64), points, 0.9 * self._clear_m)

    @property
    def _clear_m(self) -> float:
        """Radius around a corner in which only its own two edges are seen: to the nearest marker, or half a square [m]."""
        margin = self.square_length_m - self.marker_length_m
        return margin / np.sqrt(2) if self.type == "charuco" else self.square_length_m / 2


def _first_square_is_dark(picture: NDArray[np.uint8], places: NDArray[np.float32]) -> bool:
    """Whether the square between the corners (0, 0) and (1, 1) is darker than its right neighbour.

    That square touches the board's first one, which is dark, at a corner.
    """

    def brightness(row: int, column: int) -> float:
        x, y = places[row : row + 2, column : column + 2].reshape(-1, 2).mean(0)
        return float(cv2.getRectSubPix(picture, (3, 3), (float(x), float(y))).mean())

    return brightness(0, 0) < brightness(0, 1)
