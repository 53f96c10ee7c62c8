"""The command `plan`: checks that the arm can take the views of a trajectory, or finds the views that a known shape needs."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from koala3d.capture.cli.options import CalibrationFile, MeshScale, RigName, Settings
from koala3d.datasets.core import console

if TYPE_CHECKING:
    from koala3d.capture.model.carrier import Carrier
    from koala3d.capture.model.trajectory import Trajectory
    from koala3d.capture.planning import PlannedView

DEFAULT = Path("koala")  # with --for-mesh
SHAPE = "A known shape"


Coverage = Annotated[
    Path | None,
    Option(
        "--coverage",
        metavar="MESH",
        help="Print the share of this mesh (base frame) that three training views see at 60 degrees or less.",
        rich_help_panel=SHAPE,
    ),
]
ForMesh = Annotated[
    Path | None,
    Option(
        "--for-mesh",
        metavar="MESH",
        help="Choose the views that cover this mesh (base frame); the trajectory says where the camera may be.",
        rich_help_panel=SHAPE,
    ),
]
Out = Annotated[
    Path | None,
    Option("--out", metavar="NEW.yaml", help="With --for-mesh: write these views as a new trajectory.", rich_help_panel=SHAPE),
]
Views = Annotated[
    int | None,
    Option("--views", min=1, max=999, help="With --for-mesh: largest number of training views.", rich_help_panel=SHAPE),
]
UntilCoverage = Annotated[
    float | None,
    Option(
        "--until-coverage",
        min=0.0,
        max=1.0,
        help="With --for-mesh: end at this share of the surface within reach. Default: 1.",
        rich_help_panel=SHAPE,
    ),
]


def plan(
    trajectory: Annotated[
        Path | None,
        Argument(
            metavar="TRAJECTORY",
            help=f"A trajectory: its name, as 'capture list' shows it, or a YAML file. With --for-mesh: {DEFAULT} if left out.",
        ),
    ] = None,
    rig: RigName = "sim",
    plot: Annotated[Path | None, Option(metavar="PLAN.png", help="Draw views, paths and joint angles.")] = None,
    page: Annotated[Path | None, Option(metavar="PLAN.html", help="Write a page with the plan in 3D.")] = None,
    urdf: Annotated[Path | None, Option(metavar="FOLDER", help="Write the rig as a URDF, and the plan for MoveIt.")] = None,
    coverage: Coverage = None,
    for_mesh: ForMesh = None,
    out: Out = None,
    views: Views = None,
    until_coverage: UntilCoverage = None,
    mesh_scale: MeshScale = 1.0,
    calibration: CalibrationFile = None,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Check that the arm can take every view, and estimate how long that takes. Nothing moves.

    With --for-mesh it chooses few views that show every place of a known shape three times, at 60 degrees or less and from
    directions that differ.
    """
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.planning import plan as plan_session
    from koala3d.capture.rig.naming import describe
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.core.files import refuse_existing

    needless = {"--out": out, "--views": views, "--until-coverage": until_coverage}
    needless |= {} if coverage is not None else {"--calibration": calibration}
    if given := [name for name, value in needless.items() if value is not None and for_mesh is None]:
        raise UsageError("is for a known shape", where=given[0], remedy="add --for-mesh, or leave it out")
    if coverage is not None and for_mesh is not None:
        raise UsageError("is printed by --for-mesh as well", where="--coverage", remedy="leave it out")
    if trajectory is None and for_mesh is None:
        raise UsageError("no TRAJECTORY is given", remedy="name one of 'capture list', or a file")
    for path in (plot, page, urdf, out):
        if path is not None:
            refuse_existing(path)
    session = load_trajectory(trajectory or DEFAULT, overrides=settings)
    mount, words, found = describe(rig).carrier(), "", {}
    describe(rig).lights_on(session.lights)
    if for_mesh is not None:
        limits = (1.0 if until_coverage is None else until_coverage, views)
        session, words, found = _covering(session, mount, for_mesh, mesh_scale, limits, calibration, out)
    planned = plan_session(session, mount)
    text, facts = _described(session, mount, planned, plot, page, urdf)
    if coverage is not None:
        from koala3d.capture.sessions.adaptive import coverage as measured
        from koala3d.datasets.calibration import Calibration

        known = None if calibration is None else Calibration.load(calibration)
        shares = measured.of_plan(session, mount, planned, coverage, mesh_scale, known)
        text, found = "\n".join([text, *measured.lines(shares)]), {"covered": shares[-1], "covered_after": shares}
    console.report({**facts, **found}, as_json=as_json, text=f"{words}{text}")


def _described(
    session: "Trajectory",
    mount: "Carrier",
    planned: "list[PlannedView]",
    plot: Path | None,
    page: Path | None,
    urdf: Path | None,
) -> tuple[str, dict[str, Any]]:
    """What to report of a plan, which is drawn, and written for other programs, if that is asked for."""
    import numpy as np

    from koala3d.capture.planning import Obstacles, draw, duration, export

    seconds = duration(session, planned, mount.turntable)
    drawings = [(write, path) for write, path in ((draw.plot, plot), (draw.page, page)) if path is not None]
    for write, path in drawings:
        title = f"{session.name}: {len(planned)} views, about {seconds:.0f} s"
        write(planned, Obstacles.of(session, mount), path, title=title)
    drawn = "".join(f"; drawn in {path}" for _, path in drawings)
    if urdf is not None:
        export.write(urdf, session, Obstacles.of(session, mount), planned)
        drawn += f"; rig and plan for other programs in {urdf}"
    turns, most = float(mount.wound(np.stack([view.joints for view in planned])).max()), mount.cable and mount.cable.max_turns
    wound = f"; the cable is wound up by at most {turns:.2f} of {most:g} turns" if most else ""
    splits = Counter(view.viewpoint.split for view in planned)
    parts = ", ".join(f"{count} {split}" for split, count in splits.items())
    text = f"{session.name}: all {len(planned)} views can be taken ({parts}), in about {seconds:.0f} s{wound}{drawn}"
    found = {"name": session.name, "views": len(planned), "splits": splits, "seconds": round(seconds, 1)}
    return text, {**found, "cable_turns": round(turns, 3), "plot": plot, "page": page, "urdf": urdf}


def _covering(
    session: "Trajectory",
    mount: "Carrier",
    mesh: Path,
    scale: float,
    limits: tuple[float, int | None],
    calibration: Path | None,
    out: Path | None,
) -> tuple["Trajectory", str, dict[str, Any]]:
    """The trajectory that covers a mesh, written if that is asked for, and what to report of it."""
    from koala3d.capture.sessions.adaptive.candidates import dense
    from koala3d.capture.sessions.adaptive.known_shape import cover, surface_of, write
    from koala3d.capture.sessions.adaptive.loop import LEAST, MOST
    from koala3d.capture.sessions.adaptive.session import check
    from koala3d.capture.sessions.adaptive.shape import eye_of, lens_of
    from koala3d.datasets.calibration import Calibration

    check(session)
    places = surface_of(mesh, session, scale)
    known = None if calibration is None else Calibration.load(calibration)
    eye, camera = eye_of(mount.flange_from_camera, known), lens_of(session, known)
    with console.progress("planning", len(dense(session)), "views") as bar:
        found = cover(session, mount, places, eye=eye, camera=camera, until=limits[0], views=limits[1] or MOST, done=bar.advance)
    covered, reachable = found.coverage.covered, found.coverage.reachable
    train = sum(split == "train" for split in found.trajectory.splits)
    enough = train == limits[1] or covered >= limits[0]
    ended = "" if enough else f"; one more adds less than {100 * LEAST:g} %"
    if out is not None:
        write(found.trajectory, out)
    words = (
        f"{train} of {found.candidates} views within reach cover {100 * covered:.1f} % of the surface that these can cover, "
        f"which is {100 * reachable:.1f} % of {mesh}{ended}" + (f"; written to {out}\n" if out else "\n")
    )
    facts = {"out": out, "candidates": found.candidates, "covered": covered, "reachable": reachable}
    return found.trajectory, words, facts
