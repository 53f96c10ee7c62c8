"""The folder of a comparison.

FOLDER/shape.json       figures, see `comparison.DEFINITIONS`
FOLDER/deviation.ply    A in the frame of B: colours, and properties of the vertices
FOLDER/index.html       a page with pictures
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from koala3d.datasets.core import files
from koala3d.datasets.reports.drawing import COLOURS, GREY, blank, svg_of
from koala3d.datasets.reports.html import Number, ReportPage
from koala3d.reconstruct.output.mesh.files import save
from koala3d.reconstruct.output.shape import pictures
from koala3d.reconstruct.output.shape.comparison import SIGNIFICANT, Comparison

SHAPE, MESH, PAGE = "shape.json", "deviation.ply", "index.html"
DISTANCE, STD, COMPARED = "distance", "std", "compared"
"""Names of the vertices' properties in the mesh [m], and whether they are compared."""
SHOWN = 12
"""Places in the page's table."""


def write(found: Comparison, out: Path, command: str) -> dict[str, Any]:
    """Write a comparison into a new folder; returns the content of its shape.json. Raises UsageError where `out` exists."""
    content = found.to_json()
    with files.atomic_folder(out) as folder:
        mesh, limit = _coloured(found)
        save(mesh, folder / MESH)
        files.write_json(folder / SHAPE, content)
        _page(found, content, mesh, limit, command).write(folder / PAGE)
    return content


def summary(content: dict[str, Any]) -> str:
    """The figures for a person, a line each."""
    aligned, deviation, within = content["aligned"], content["deviation_m"], content["within"]
    how = {"base": "left where it stands", "icp": "moved from where it stands", "features": "placed where it fits"}
    move = f": {1e3 * aligned['moved_m']:.2f} mm, {aligned['turned_deg']:.2f}°" if aligned["by"] != "base" else ""
    lines = [f"A was {how[aligned['by']]}{move}"]
    if aligned["by"] == "base":
        lines[0] += f"; --align icp would move it by {1e3 * aligned['would_move_m']:.2f} mm"
    if aligned["ambiguous"]:
        lines.append("warning: another pose fits as well: a symmetric object can be turned")
    removed = ", removed" if aligned["scale_removed"] else ""
    lines.append(f"size of A relative to B {aligned['scale']:.5f} ± {aligned['scale_std']:.5f}{removed}")
    lines.append(
        f"deviation {1e3 * deviation['mean']:+.3f} mm on average, {1e3 * deviation['rms']:.3f} rms, "
        f"{1e3 * deviation['p05']:+.3f} to {1e3 * deviation['p95']:+.3f} in nine tenths of the area, "
        f"{1e3 * deviation['max']:+.3f} at most"
    )
    lines.append(f"{within['share']:.1%} within ± {1e3 * within['tolerance_m']:g} mm; {_not_compared(content)}")
    lines.append(_significance(content))
    return "\n".join(lines)


def _not_compared(content: dict[str, Any]) -> str:
    return f"{content['not_compared_share']:.1%} of A cannot be compared"


def _significance(content: dict[str, Any]) -> str:
    count = len(content["places"])
    where = "" if not count else ", the largest at " + ", ".join(f"{x:.4f}" for x in content["places"][0]["point_m"]) + " m"
    places = f"{count} place{'' if count == 1 else 's'}{where}"
    if content["significant_share"] is None:
        return f"nothing is stated of the errors of A or B: no deviation is called significant; beyond the tolerance: {places}"
    return f"{content['significant_share']:.2%} deviates by more than {SIGNIFICANT:g} standard deviations: {places}"


def _coloured(found: Comparison) -> tuple[Any, float]:
    """A moved onto B with a colour for each deviation, and the largest of the colour bar [m]."""
    import trimesh

    shown = np.abs(found.deviation[found.compared])
    limit = max(float(np.percentile(shown, 99)), 1e-6)
    tone = np.where(found.compared[:, None], pictures.colours(found.deviation, limit), pictures.UNKNOWN)
    normals = np.asarray(found.first.mesh.vertex_normals) @ found.aligned.fit.matrix[:3, :3].T * found.aligned.fit.scale
    mesh = trimesh.Trimesh(
        found.vertices,
        found.first.mesh.faces,
        vertex_normals=normals,
        vertex_colors=np.round(255 * tone).astype(np.uint8),
        process=False,
    )
    mesh.vertex_attributes[DISTANCE] = found.deviation.astype(np.float32)
    mesh.vertex_attributes[COMPARED] = found.compared.astype(np.uint8)
    if found.std is not None:
        mesh.vertex_attributes[STD] = found.std.astype(np.float32)
    return mesh, limit


def _page(found: Comparison, content: dict[str, Any], mesh: Any, limit: float, command: str) -> ReportPage:
    """The page with pictures and figures."""
    deviation, within = content["deviation_m"], content["within"]
    page = ReportPage(f"{found.first.name} compared with {found.second.name}", made_by=[command])
    page.headline(
        [
            ("deviation, rms", Number(1e3 * deviation["rms"], "mm", digits=3)),
            (f"within ± {1e3 * within['tolerance_m']:g} mm", Number(100 * within["share"], "%", digits=1)),
            ("size relative to B", Number(content["aligned"]["scale"], "", content["aligned"]["scale_std"])),
        ],
        _significance(content),
    )
    page.section("Deviation on the surface", "Red: A is outside B. Blue: inside. Grey: not compared.")
    page.drawing(_bar(limit))
    tone = np.asarray(mesh.visual.vertex_colors)[:, :3] / 255
    page.pictures(pictures.views(mesh, tone).items())
    if found.std is not None:
        largest = max(float(np.percentile(found.std, 95)), 1e-6)
        page.section("How certain it is", f"Standard deviation of the deviation, from white to red at {1e3 * largest:.3g} mm.")
        page.pictures(pictures.views(mesh, pictures.colours(found.std, largest)).items())
    page.section("How often")
    page.drawing(_histogram(found, limit))
    page.section("Figures")
    page.items(summary(content).splitlines())
    names = {"mean": "mean", "median": "median", "rms": "root mean square", "p05": "5 % are below", "p95": "5 % are above"}
    page.numbers((names.get(name, "largest"), Number(1e3 * value, "mm", digits=3), "") for name, value in deviation.items())
    if found.places:
        page.section("Places", "Largest first; positions are in the frame of B.")
        columns = ("x", "y", "z", "deviation", "area")
        page.table(columns, [_row(place) for place in found.places[:SHOWN]])
    return page


def _row(place: Any) -> tuple[Number, ...]:
    """A place in the table."""
    at = tuple(Number(1e3 * float(x), "mm", digits=1) for x in place.point)
    std = None if place.std is None else 1e3 * place.std
    return (*at, Number(1e3 * place.deviation, "mm", std, digits=3), Number(1e6 * place.area, "mm²", digits=1))


def _bar(limit: float) -> str:
    """The colour bar as SVG."""
    drawing = blank(5, 0.7)
    axes = drawing.add_subplot()
    values = np.linspace(-limit, limit, 201)
    axes.imshow(pictures.colours(values, limit)[None], aspect="auto", extent=(-1e3 * limit, 1e3 * limit, 0, 1))
    axes.set(yticks=[], xlabel="deviation [mm]")
    return svg_of(drawing)


def _histogram(found: Comparison, limit: float) -> str:
    """Area over the deviation as SVG, with the tolerance."""
    drawing = blank(7, 2.6)
    axes = drawing.add_subplot()
    values, weights = found.deviation[found.compared], found.areas[found.compared]
    edges: Float[np.ndarray, " e"] = 1e3 * limit * np.linspace(-1.2, 1.2, 97)
    axes.hist(np.clip(1e3 * values, edges[0], edges[-1]), edges.tolist(), weights=100 * weights / weights.sum(), color=COLOURS[0])
    for side in (-1, 1):
        if found.tolerance < 1.2 * limit:
            axes.axvline(side * 1e3 * found.tolerance, color=GREY, linestyle="--", linewidth=1)
    axes.set(xlabel="deviation [mm]", ylabel="area [%]")
    return svg_of(drawing)
