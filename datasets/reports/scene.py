"""A scene as one HTML file: figures, the findings of `datasets check`, camera positions, every view as a thumbnail."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.checks.check import check
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.findings import Finding, tally
from koala3d.datasets.core.progress import Count, ignore
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.reports.html import Number, ReportPage
from koala3d.datasets.scene import TURNED, Scene, View
from koala3d.datasets.structure import bounds

THUMBNAIL = 190  # width of the thumbnails [px]
COLOURS = {"train": "#2f6fde", "val": "#8e5bbf", "test": "#d0342c"}
COLUMNS = ("view", "split", "width [px]", "height [px]", "fx", "fy", "cx", "cy", "distance to the box's centre", "truth")


def write(
    path: str | Path, out: Path, *, matches: bool = True, made_by: str = "", done: Count = ignore, **options: Any
) -> list[Finding]:
    """Write the report of a scene to the new file `out`; returns the findings of `datasets check`.

    Args:
        matches: match features between views, the slowest part.
        done: called with the number of views checked and their total.
        **options: of `load_scene`.

    Raises UsageError: `out` exists, or `path` is not a scene.
    """
    files.refuse_existing(out)
    problems: list[KoalaError] = []
    scene = load_scene(path, problems=problems, **options)
    findings = check(path, matches=matches, done=done, **options)
    page = ReportPage(f"Scene {scene.name}", made_by=[made_by] if made_by else [])
    errors, warnings = tally(findings)
    figures = {f"{split} views": count for split, count in scene.counts().items() if count}
    figures |= {"errors": errors, "warnings": warnings}
    page.headline([(name, Number(count, digits=0)) for name, count in figures.items()], str(path))
    page.section("Findings of 'datasets check'")
    if findings:
        page.items(finding.line for finding in findings)
    else:
        page.paragraph("Nothing is wrong." if matches else "Nothing is wrong; features were not matched between views.")
    _bounds(page, scene)
    both = "; squares are those after the object was turned over" if turned_views(scene) else ""
    page.section("Where the cameras are", f"Training blue, test red; the object's box in ochre{both}.")
    page.drawing(cameras(scene))
    page.section("Every view")
    page.table(COLUMNS, [_row(view, scene) for view in scene.views])
    page.section("Pictures")
    page.pictures(_thumbnails(scene))
    page.write(out)
    return findings


def _bounds(page: ReportPage, scene: Scene) -> None:
    unit = "m" if scene.metric else "units"
    page.section("Bounds", f"From {scene.bounds_from}.")
    low, high = scene.box
    rows = [
        ("near", Number(scene.near, unit), "smallest depth along z of anything visible"),
        ("far", Number(scene.far, unit), "largest depth; a dash where it is infinite"),
    ]
    for axis, a, b in zip("xyz", low, high, strict=True):
        rows.append((f"box along {axis}", Number(float(b - a), unit), f"from {a:.4g} to {b:.4g}"))
    page.numbers(rows)
    if scene.notes:
        page.items(scene.notes)


def _row(view: View, scene: Scene) -> tuple:
    camera, unit = view.camera, "m" if scene.metric else "units"
    away = float(np.linalg.norm(view.world_from_camera[:3, 3] - scene.box.mean(0)))
    pixels = [Number(value, "px", digits=1) for value in (camera.fx, camera.fy, camera.cx, camera.cy)]
    return (view.name, view.split, camera.width, camera.height, *pixels, Number(away, unit), ", ".join(sorted(view.truth)))


def _thumbnails(scene: Scene) -> Iterator[tuple[str, NDArray[np.floating]]]:
    """(name, thumbnail) of each readable view, over white where it has an alpha."""
    for view in scene.views:
        try:
            picture = view.read()
        except KoalaError:
            continue
        small = np.clip(images.resize(picture, THUMBNAIL, max(1, round(THUMBNAIL * picture.shape[0] / picture.shape[1]))), 0, 1)
        yield (
            f"{view.name} ({view.split})",
            small[..., :3] if small.shape[-1] == 3 else small[..., :3] * small[..., 3:] + 1 - small[..., 3:],
        )


def turned_views(scene: Scene) -> frozenset[str]:
    """Names of the views of the second session, of an object that was turned over."""
    found = scene.provenance.get(TURNED)
    return frozenset(found["views"] if isinstance(found, dict) and isinstance(found.get("views"), list) else ())


def cameras(scene: Scene) -> str:
    """Cameras and box from above and from the side, as SVG."""
    from matplotlib.patches import Rectangle

    from koala3d.datasets.reports.drawing import blank, svg_of

    figure, turned = blank(9, 4.2), turned_views(scene)
    matrices = np.stack([view.world_from_camera for view in scene.views])
    reach = 0.12 * float(np.median(np.linalg.norm(matrices[:, :3, 3] - bounds.focus(matrices)[0], axis=1)))
    unit = "m" if scene.metric else "units"
    for index, (i, j) in enumerate(((0, 1), (0, 2)), 1):
        axes = figure.add_subplot(1, 2, index, aspect="equal", xlabel=f"{'xyz'[i]} [{unit}]", ylabel=f"{'xyz'[j]} [{unit}]")
        low, high = scene.box[:, [i, j]]
        axes.add_patch(Rectangle(tuple(low), *(high - low), fill=False, edgecolor="#be961e", linewidth=1.5))
        for split, marker in ((split, marker) for split in COLOURS for marker in "os"):
            colour = COLOURS[split]
            chosen = matrices[[v.split == split and (v.name in turned) == (marker == "s") for v in scene.views]]
            if len(chosen):
                places, ahead = chosen[:, :3, 3][:, [i, j]], chosen[:, :3, 2][:, [i, j]]
                axes.plot(*places.T, marker, color=colour, markersize=3.5, label=split)
                axes.plot(*np.stack([places, places + reach * ahead], 1).transpose(2, 1, 0), color=colour, linewidth=1)
        axes.grid(alpha=0.25)
    return svg_of(figure)
