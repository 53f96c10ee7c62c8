"""The end of every command that makes a calibration: the file is written, then printed."""

from pathlib import Path
from typing import Any

from koala3d.calib.page.summary import describe_calibration, notes
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core import console


def finish(calibration: Calibration, out: Path, json: bool) -> None:
    """Write a calibration and print it, as text or as one JSON object."""
    calibration.save(out)
    facts = {"camera_std": calibration.camera_std, "residuals": calibration.residuals.to_json()}
    result: dict[str, Any] = {"out": str(out), "camera": calibration.camera.to_json(), **facts, "notes": notes(calibration)}
    for name, value in calibration.poses.items():
        std = {"translation_std_mm": value.translation_std_mm, "rotation_std_deg": value.rotation_std_deg}
        result[name] = {**value.to_json(), **std}
    if calibration.link_errors is not None:
        result["link_errors"] = calibration.link_errors.to_json()
    console.report(result, as_json=json, text=f"{describe_calibration(calibration)}\nwritten to {out}")
