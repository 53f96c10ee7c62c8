"""What would lower the figures of a session that has come to its end: more views, another board, other angles and distances.

Each change is tried on views drawn at random: as now, and with the change. The ratio of both gives the figures to expect.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from koala3d.calib.advice import information
from koala3d.calib.advice.information import Knowledge
from koala3d.calib.advice.patterns import Rig, ViewRange, viewpoints
from koala3d.calib.arrays import Array
from koala3d.datasets import pose
from koala3d.datasets.advice import Figures
from koala3d.datasets.targets.board import Board

DRAWN = 150  # views per change; of them about half show the board
WORTH = 0.85  # a change is named if it lowers the worse figure to this share
STEEP_DEG = (25.0, 55.0)
STEEP_ENOUGH_DEG = 40.0  # median tilt above which more is not advised


def hints(known: Knowledge, base_from_flange: Array, figures: Figures, until: Figures) -> list[str]:
    """What would help after views from (n, 4, 4) flange poses, the most useful first; then how many views would do."""
    now, views = _as_now(known, base_from_flange), len(base_from_flange)
    worse = int(np.argmax([figures[0] / until[0], figures[1] / until[1]]))
    base = _expected(known, known.board, now, views)
    found = []
    for words, board, pattern in _changes(known.board, now, _median_tilt(known, base_from_flange)):
        changed = _expected(known, board, pattern, views)
        if base is not None and changed is not None:
            share = changed[0] / base[0], changed[1] / base[1]
            if share[worse] <= WORTH and max(share) < 1.1:
                about = f"about {share[0] * figures[0]:.3f} mm and {share[1] * figures[1]:.4f} deg with as many views"
                found.append((share[worse], f"{words}: {about}"))
    lines = [line for _, line in sorted(found)]
    needed = int(np.ceil(views * max(figures[0] / until[0], figures[1] / until[1], 1.0) ** 2))
    return [*lines, f"more views: about {needed} in all for {until[0]:g} mm and {until[1]:g} deg"] if needed > views else lines


def _as_now(known: Knowledge, base_from_flange: Array) -> ViewRange:
    """The ranges of the views that were taken."""
    in_board = _cameras_in_board(known, base_from_flange)
    distance = np.linalg.norm(in_board[:, :3, 3] - np.append(known.board.points[:, :2].mean(0), 0.0), axis=1)
    tilt = np.rad2deg(np.arccos(np.clip(in_board[:, 2, 2], -1, 1)))
    near, far = np.percentile(distance, [10, 90])
    return ViewRange((float(tilt.min()), float(tilt.max())), (float(near), float(far)), shift_m=0.05)


def _cameras_in_board(known: Knowledge, base_from_flange: Array) -> Array:
    stand_from_mount = pose.inverse(base_from_flange) if known.eye_to_hand else base_from_flange
    return pose.inverse(known.state.stand_from_board) @ stand_from_mount @ known.state.mount_from_camera


def _median_tilt(known: Knowledge, base_from_flange: Array) -> float:
    return float(np.median(np.rad2deg(np.arccos(np.clip(_cameras_in_board(known, base_from_flange)[:, 2, 2], -1, 1)))))


def _changes(board: Board, now: ViewRange, tilt_deg: float) -> Iterator[tuple[str, Board, ViewRange]]:
    """Changes in words, each with its board and its views."""
    square = board.square_length_m
    larger = board.with_squares(round(1.5 * board.squares_x), round(1.5 * board.squares_y))
    farther = replace(now, distance_m=(1.3 * now.distance_m[0], 1.5 * now.distance_m[1]))
    yield (
        f"a larger board of {larger.squares_x}x{larger.squares_y} squares of {1e3 * square:.0f} mm, from farther away",
        larger,
        farther,
    )
    finer = larger.with_squares(larger.squares_x, larger.squares_y, 1 / 1.5)
    yield f"finer squares, {larger.squares_x}x{larger.squares_y} of {1e3 * square / 1.5:.0f} mm", finer, now
    if tilt_deg < STEEP_ENOUGH_DEG:
        yield f"more tilt, {STEEP_DEG[0]:.0f} to {STEEP_DEG[1]:.0f} deg", board, replace(now, tilt_deg=STEEP_DEG)
    yield (
        "nearer views, at 0.7 of the distance",
        board,
        replace(now, distance_m=(0.7 * now.distance_m[0], 0.7 * now.distance_m[1])),
    )


def _expected(known: Knowledge, board: Board, pattern: ViewRange, views: int) -> Figures | None:
    """Figures of as many views of a pattern, from the mean information of those drawn; None where they say too little."""
    state = known.state
    middle = state.stand_from_board @ pose.rigid(
        np.eye(3), [*(known.board.points[:, :2].mean(0) - board.points[:, :2].mean(0)), 0.0]
    )
    rig = Rig(known.camera, board, state.mount_from_camera, middle)
    drawn = viewpoints(np.random.default_rng(0), rig, DRAWN, pattern) @ pose.inverse(state.mount_from_camera)
    drawn = pose.inverse(drawn) if known.eye_to_hand else drawn
    changed = replace(known, board=board, state=replace(state, stand_from_board=middle))
    told = [one for one in information.informations(changed, drawn) if one is not None]
    if len(told) < len(drawn) / 10:
        return None
    found = information.figures(views * np.mean(told, axis=0), changed.state)
    return found if np.isfinite(found).all() else None
