"""`reconstruct diagnose`: evidence from the log, from renderings of some views, and from the scene's pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks.check import check
from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.reports.html import Number, ReportPage
from koala3d.datasets.scene import View
from koala3d.reconstruct import convergence
from koala3d.reconstruct.diagnosis import causes
from koala3d.reconstruct.diagnosis.residuals import Residual, relit, residual
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.scene.rays import over, read_scaled

VIEWS, SIDE = 16, 160
"""Number of views that are rendered, and the longer side of their renderings [px]."""
BRIGHTEST = 0.25
"""Error that is drawn white in residual maps, in sRGB."""


@dataclass(frozen=True)
class Diagnosis:
    """What was found, and what it was found in."""

    findings: list[Finding]
    residuals: list[Residual]

    def to_json(self) -> dict[str, Any]:
        """Findings and the figures of each rendered view."""
        views = [
            {"name": one.name, "split": one.split, "psnr": one.psnr, "gains": one.gains, "shift_px": one.shift_px}
            for one in self.residuals
        ]
        return {"findings": [vars(finding) for finding in self.findings], "views": views}


def diagnose(trained: TrainedModel, *, pictures: bool = True) -> Diagnosis:
    """Findings on a run, first those of its log, then of its residuals, then of its scene.

    Args:
        pictures: also check the scene as `datasets check` does, which takes about as long as everything else.
    """
    log = trained.run.log()
    found = [*convergence.find(log), *convergence.got_worse(log)]
    residuals = rendered(trained)
    found += causes.find(residuals)
    if pictures:
        known = {(finding.cause, finding.where) for finding in found}
        found += [one for one in check(trained.run.scene_path) if (one.cause, one.where) not in known]
    return Diagnosis(found, residuals)


def rendered(trained: TrainedModel) -> list[Residual]:
    """Residuals of up to `VIEWS` views, evenly spread over training and test views.

    Where the run learned gains of its pictures, renderings are compared in the light of the pictures, as `eval` does.
    """
    known = [view for view in trained.scene.views if view.split in ("train", "test")]
    chosen = [known[i] for i in np.unique(np.linspace(0, len(known) - 1, VIEWS).round().astype(int))]
    found, gains = [], trained.model.per_image
    with progress("rendering", len(chosen), "views") as shown:
        for view in chosen:
            camera = small_camera(view)
            seen, picture = truth(trained, view, camera), trained.renderer.picture(trained.model, view, camera, normals=False).rgb
            if gains is not None:
                picture = relit(picture, seen, colours=gains.shape[1] == 3)
            found.append(residual(view.name, view.split, seen, picture))
            shown.advance()
    return found


def small_camera(view: View) -> Camera:
    """A view's camera at most `SIDE` pixels a side."""
    shrink = max(1.0, max(view.camera.width, view.camera.height) / SIDE)
    return view.camera.scaled(max(1, round(view.camera.width / shrink)), max(1, round(view.camera.height / shrink)))


def truth(trained: TrainedModel, view: View, camera: Camera) -> np.ndarray:
    """(height, width, 3) a view's picture at the size of `camera`, over the renderer's background."""
    picture = read_scaled(view, camera.width / view.camera.width)
    if picture.shape[:2] != (camera.height, camera.width):
        picture = cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(np.clip(over(picture, np.asarray(trained.renderer.behind, np.float32)), 0, 1), np.float32)


def write(diagnosis: Diagnosis, trained: TrainedModel, out: Path, *, made_by: str = "") -> Path:
    """Write the page of a diagnosis with residual maps into the new folder `out`. Raises UsageError where it is not empty."""
    files.refuse_existing(out)
    page = ReportPage(f"Diagnosis of {trained.scene.name}", made_by=[made_by] if made_by else [])
    mean = [one.psnr for one in diagnosis.residuals]
    page.headline(
        [("findings", Number(len(diagnosis.findings), digits=0)), ("PSNR", Number(float(np.mean(mean)), "dB", digits=1))]
    )
    page.section("Findings", "What is wrong, where, the evidence, and what to do.")
    if diagnosis.findings:
        page.items(finding.line for finding in diagnosis.findings)
    else:
        page.paragraph("Nothing stands out.")
    page.section("Views", "Gain is the picture's light over the rendering's; shift is the picture's against the rendering.")
    page.table(("view", "split", "PSNR", "gain", "shift right", "shift down"), [_row(one) for one in diagnosis.residuals])
    page.section("Residual maps", f"Where picture and rendering differ: black is nothing, white is {BRIGHTEST:g} of the range.")
    worst = sorted(diagnosis.residuals, key=lambda one: one.psnr)
    page.pictures((f"{one.name} ({one.psnr:.1f} dB)", np.clip(one.error_map / BRIGHTEST, 0, 1)[..., None]) for one in worst)
    page.section("The worst views", "Left of the line is the picture, right of it the rendering; the pointer moves the line.")
    page.wipes((one.name, one.truth, one.rendered) for one in worst[:6])
    with files.atomic_folder(out) as folder:
        page.write(folder / "index.html")
    return out / "index.html"


def _row(one: Residual) -> tuple[Any, ...]:
    gain, shifted = float(np.mean(one.gains)), [Number(float(value), "px", digits=1) for value in one.shift_px]
    return one.name, one.split, Number(one.psnr, "dB", digits=1), Number(gain, digits=2), *shifted
