"""Commands that draw calibration files over the image: `calib uncertainty` and `calib difference`."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import UsageError

Picture = Annotated[Path, Option("--out", help="Picture to write (PNG).")]


def uncertainty(
    path: Annotated[Path, Argument(metavar="CALIBRATION.json", help="File made by 'calib handeye' or 'calib intrinsics'.")],
    out: Picture,
    distance: Annotated[float, Option("--distance", help="Distance of the points from the camera [m].")] = 0.5,
    json: console.Json = False,
) -> None:
    """Draw how certain a calibration is over the image.

    The picture shows the standard deviation of where a point at some distance is seen.
    """
    from koala3d.calib.page import figures, maps
    from koala3d.datasets.calibration import Calibration

    if not 0 < distance < 1e3:
        raise UsageError("distance must lie between 0 and 1000 m", where="--distance", why=f"{distance:g} given")
    _check(out)
    calibration = Calibration.load(path)
    found = maps.projection_uncertainty(calibration, distance)
    of_rig = (calibration.flange_from_camera or calibration.base_from_camera) is not None
    what = f"points at {distance:g} m" if of_rig else "directions, up to a rotation of the camera"
    title = f"standard deviation of {what}: {found.rms_px:.3f} px rms"
    _write(out, figures.map_over_image(calibration.camera, title, found, "standard deviation [px]"))
    text = f"{title}, {found.values_px.min():.3f} to {found.values_px.max():.3f} px\nwritten to {out}"
    low, high = float(found.values_px.min()), float(found.values_px.max())
    console.report({"out": str(out), "rms_px": found.rms_px, "least_px": low, "most_px": high}, as_json=json, text=text)


def difference(
    first: Annotated[Path, Argument(metavar="A.json", help="Calibration file.")],
    second: Annotated[Path, Argument(metavar="B.json", help="Another one, for images of the same size.")],
    out: Picture,
    json: console.Json = False,
) -> None:
    """Draw how far the cameras of two calibrations differ over the image.

    The rotation that brings them closest is left out: it looks like another principal point.
    """
    from koala3d.calib.intrinsics import crossval
    from koala3d.calib.page import figures
    from koala3d.datasets.calibration import Calibration

    _check(out)
    cameras = [Calibration.load(path).camera for path in (first, second)]
    sizes = [f"{camera.width}x{camera.height}" for camera in cameras]
    if sizes[0] != sizes[1]:
        remedy = "compare two of one camera setting"
        raise UsageError("is for images of another size", where=second, why=f"{sizes[1]}, not {sizes[0]}", remedy=remedy)
    found = crossval.difference(*cameras)
    most = float(found.values_px.max())
    title = f"{first.stem} and {second.stem} differ by {found.rms_px:.3f} px rms"
    _write(out, figures.map_over_image(cameras[0], title, found, "difference [px]"))
    text = f"{title}, at most {most:.3f} px\nwritten to {out}"
    console.report({"out": str(out), "rms_px": found.rms_px, "most_px": most}, as_json=json, text=text)


def _check(out: Path) -> None:
    """Raise UsageError where `out` cannot be written."""
    from koala3d.datasets.core.files import refuse_existing

    if out.suffix.lower() != ".png":
        raise UsageError("is no PNG file", where=out, remedy="give --out a name that ends in .png")
    refuse_existing(out)


def _write(out: Path, picture: bytes) -> None:
    from koala3d.datasets.core.files import write_bytes

    write_bytes(out, picture)
