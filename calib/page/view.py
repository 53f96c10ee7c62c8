"""The page of a calibration: target and cameras in space, arm against pictures, residuals over the image, uncertainty.

What the file holds is shown at once. The target is then found in the recording again, in the background.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import viser
from numpy.typing import NDArray

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import verify
from koala3d.calib.origin import recording_of
from koala3d.calib.page import board_mesh, figures
from koala3d.calib.page.evidence import CORRECTED, CalibrationEvidence, Sighting, gather
from koala3d.calib.page.summary import describe_calibration
from koala3d.calib.sessions.importer import observe_folder
from koala3d.calib.targets.detection import read_board
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.imaging import images
from koala3d.datasets.page import Page, PicturePanel, shapes
from koala3d.datasets.page.panel import WIDTH, bytes_of
from koala3d.datasets.targets.board import Board

THUMBNAIL = 96  # width of the pictures on the cameras [px]
ARROW = 0.03  # length of the arrow of a large residual, as a share of the picture's width
WORST_PX = 0.5  # residual that is drawn fully red [px]
ENLARGED = 100.0  # factor by which differences between arm and picture are drawn longer than they are


class CalibrationView:
    """What is on the page of one calibration."""

    def __init__(self, page: Page, calibration: Calibration) -> None:
        self.page, self.calibration = page, calibration
        self.beside = calibration.base_from_camera is not None
        """Whether the camera stands beside the arm."""
        self.evidence: CalibrationEvidence | None = None
        self.sightings: list[Sighting] = []
        self._state = page.gui.add_markdown("*reading the recording*")
        self._kind: viser.GuiDropdownHandle[Any] = page.gui.add_dropdown("residuals", (CORRECTED,))
        self._kind.on_update(lambda event: self._colour())
        words = "click a camera: arrows lead from the predicted corners to the detected ones"
        self.panel = PicturePanel(page, "View", words)
        self._figures: dict[str, NDArray[np.uint8]] = {}
        self._add_figures({f"uncertainty of {name}": figures.ellipses(name, value) for name, value in calibration.poses.items()})
        with page.gui.add_folder("Result"):
            page.gui.add_markdown(in_markdown(describe_calibration(calibration)))
        self._target()

    def _target(self) -> None:
        """The target where it stands, the base, and where browsers look from."""
        self.page.scene.add_frame("/base", axes_length=0.1, axes_radius=0.003)
        place = np.eye(4) if self.calibration.base_from_board is None else self.calibration.base_from_board.matrix
        content = self.calibration.provenance.get("board")
        if content is not None and not self.beside:
            add_board(self.page, "/target", read_board(content, where="calibration file, board"), place)
        if self.calibration.base_from_camera is not None:
            place = self.calibration.base_from_camera.matrix
            shapes.add_camera(self.page, "/camera", place, self.calibration.camera, colour=shapes.colour_of("train"), length=0.1)
        self.page.look(place[:3, 3] + [0.7, -0.9, 0.7], place[:3, 3], size=1.0)

    def _add_figures(self, pictures: dict[str, bytes]) -> None:
        """Put figures (PNG files by title) into the list; the first that ever comes is shown."""
        first = not self._figures
        self._figures |= {title: decoded(png) for title, png in pictures.items()}
        if not self._figures:
            return
        if first:
            with self.page.gui.add_folder("Figures"):
                self._figure = self.page.gui.add_dropdown("figure", tuple(self._figures))
                self._drawn = self.page.gui.add_image(next(iter(self._figures.values())))
            self._figure.on_update(lambda event: self._draw_figure())
        self._figure.options = tuple(self._figures)

    def _draw_figure(self) -> None:
        self._drawn.image = self._figures[self._figure.value]

    def read(self, recording: Path | None, description: Path | None) -> None:
        """Add what the recording holds; where it is missing or cannot be used, say so."""
        try:
            path = recording_of(self.calibration, recording)
            leave_out = self.calibration.provenance.get("leave_out") is True
            options = {"seen": self._seen, "leave_out": leave_out, "calibration": self.calibration}
            session, _ = observe_folder(path, description, **options)
            self.evidence = evidence = gather(self.calibration, session)
        except KoalaError as error:
            self._state.content = f"*{error}*"
            return
        except _Stopped:
            return
        self.sightings, self._kind.options = list(evidence.sightings()), tuple(evidence.residuals)
        pictures = {f"residuals, {kind}": figures.residual_vectors(evidence, kind) for kind in evidence.residuals}
        pictures |= {"coverage": figures.coverage(evidence), "errors by view": figures.view_errors(evidence)}
        if evidence.corrections is not None:
            pictures["rotations"] = figures.rotations(evidence)
        self._add_figures(pictures)
        rows = "".join(f"  \n{kind}: {overall(evidence, kind):.3f} px rms" for kind in evidence.residuals)
        notes = "".join(f"  \n**{note}**" for note in evidence.notes)
        self._state.content = f"`{path}`, {len(self.sightings)} views{rows}{notes}"
        self._draw()

    def _seen(self, words: str) -> None:
        if self.page.stopping.is_set():
            raise _Stopped
        self._state.content = f"*finding the target: {words}*"

    def _draw(self) -> None:
        """Every view in space, and the difference between arm and picture."""
        differences = []
        self._handles: dict[str, viser.CameraFrustumHandle] = {}
        colour = shapes.colour_of("calibration")
        for sighting in self.sightings:
            start, end = sighting.by_arm[:3, 3], sighting.by_picture[:3, 3]
            differences.append((start, start + ENLARGED * (end - start)))
            name, camera = f"/views/{sighting.name}", self.calibration.camera
            handle = shapes.add_camera(self.page, name, sighting.by_arm, camera, length=0.05, colour=colour)
            handle.on_click(lambda event, sighting=sighting: self._chosen(event.client, sighting))
            self._handles[sighting.name] = handle
        title = f"/arm against picture, {ENLARGED:.0f} times"
        shapes.add_lines(self.page, title, differences, colour=(214, 39, 40), thickness=2.5)
        self._colour()
        for sighting in self.sightings:
            if sighting.image is not None and not self.page.stopping.is_set():
                self._handles[sighting.name].image = bytes_of(images.read(sighting.image), THUMBNAIL)

    def _colour(self) -> None:
        """Colour the views by their residual: from green for 0 to red for WORST_PX and more; grey for views left out."""
        for sighting in self.sightings:
            share = min(sighting.rms(self._kind.value) / WORST_PX, 1.0) if self._kind.value in sighting.residuals else None
            self._handles[sighting.name].color = shapes.COLOURS["blocked"] if share is None else between_green_and_red(share)

    def _chosen(self, client: viser.ClientHandle | None, sighting: Sighting) -> None:
        if client is None or sighting.image is None:
            return
        kind = self._kind.value
        distance = 1e3 * float(np.linalg.norm(sighting.by_arm[:3, 3] - sighting.by_picture[:3, 3]))
        words = [f"**view {sighting.name}**", f"arm and picture {distance:.2f} mm apart"]
        words += [f"{name}: {sighting.rms(name):.3f} px rms" for name in sighting.residuals]
        if sighting.left_out:
            words.append(f"left out: {sighting.left_out}")
        picture, enlarged = with_arrows(images.read(sighting.image), sighting.pixels, sighting.residuals.get(kind))
        if enlarged:
            words.append(f"arrows: {kind}, {enlarged:.0f} times enlarged")
        self.panel.show(client, "  \n".join(words), picture)


class _Stopped(Exception):
    """The page has ended while the recording was being read."""


def in_markdown(words: str) -> str:
    """The lines of `describe_calibration` as Markdown that wraps in a narrow panel; indented lines as a list."""
    shown = []
    for line in words.splitlines():
        name, _, value = line.strip().partition("  ")
        item = f"- {name}: {value.strip()}" if line.startswith(" ") else f"\n**{name}** {value.strip()}\n"
        shown.append(item.replace("_", r"\_"))
    return "\n".join(shown)


def overall(evidence: CalibrationEvidence, kind: str) -> float:
    """Root mean square residual of one kind over all views [px]."""
    return verify.rms(evidence.residuals[kind][evidence.inliers]) if evidence.inliers.any() else float("nan")


def between_green_and_red(share: float) -> shapes.Colour:
    """sRGB bytes: green for 0, yellow for a half, red for 1."""
    return int(220 * min(1.0, 2 * share)), int(180 * min(1.0, 2 - 2 * share)), 40


def with_arrows(picture: NDArray[np.float32], pixels: Array, residuals: Array | None) -> tuple[NDArray[np.uint8], float]:
    """A picture with a ring at each corner and an arrow for each residual, and how many times these are enlarged.

    Args:
        picture: (height, width, 1 to 4) sRGB.
        pixels: (n, 2) corners that were seen [px].
        residuals: (n, 2) seen minus predicted [px]; None for rings alone.
    """
    scale = WIDTH / picture.shape[1]
    small = bytes_of(picture, WIDTH)
    drawn = np.asarray(small if scale < 1 else cv2.resize(small, None, fx=scale, fy=scale), np.uint8).copy()
    enlarged = 0.0
    if residuals is not None and len(residuals):
        enlarged = ARROW * picture.shape[1] / max(float(np.percentile(np.linalg.norm(residuals, axis=1), 95)), 1e-6)
    for index, seen in enumerate(pixels):
        place = _point(scale * seen)
        cv2.circle(drawn, place, 3, (40, 120, 255), 1, cv2.LINE_AA)
        if residuals is not None:
            tip = _point(scale * (seen + enlarged * residuals[index]))
            cv2.arrowedLine(drawn, place, tip, (255, 40, 40), 1, cv2.LINE_AA, tipLength=0.25)
    return drawn, enlarged


def _point(place: Array) -> tuple[int, int]:
    x, y = np.clip(np.round(place), -10_000, 10_000)
    return int(x), int(y)


def add_board(page: Page, name: str, board: Board, base_from_board: Array) -> None:
    """A target as a light plate with what is printed on it, at a (4, 4) pose."""
    rotation, place = shapes.placed(base_from_board)
    for part, (mesh, grey) in board_mesh.parts(board).items():
        colour = (grey, grey, grey)
        page.scene.add_mesh_simple(f"{name}/{part}", *mesh, color=colour, side="double", wxyz=rotation, position=place)


def decoded(png: bytes) -> NDArray[np.uint8]:
    """(height, width, 3) sRGB of a PNG file's bytes."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise CalibrationError("figure cannot be read")
    return np.ascontiguousarray(picture[..., ::-1], np.uint8)


def show(
    page: Page, calibration: Calibration, *, recording: Path | None = None, description: Path | None = None
) -> CalibrationView:
    """Put a calibration on a page; what its recording holds follows in the background.

    Args:
        recording: where its recording is now, if not where it was.
        description: how to read it, if it is a folder to import.
    """
    shown = CalibrationView(page, calibration)
    page.in_background(lambda: shown.read(recording, description))
    return shown
