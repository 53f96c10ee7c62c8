"""Every page that a command writes as a file, opened from there: it is sound, and a click, a key or the pointer changes it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.page import report as recording_report
from koala3d.capture.planning import Obstacles, draw, plan
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.formats import koala
from koala3d.datasets.reports import scene as scene_report
from tests.browser import Browse

ROOT = Path(__file__).parents[2]
PACKAGES = ("capture", "calib", "datasets", "reconstruct")
Fixture = Callable[[str], Any]
"""A fixture of the test by its name."""


def of_recording(fixture: Fixture, out: Path) -> Path:
    recording_report.write(fixture("recorded")(), out / "page.html")
    return out / "page.html"


def of_calibration(fixture: Fixture, out: Path) -> Path:
    from koala3d.calib.advice.simulate import KOALA
    from koala3d.calib.page import report
    from tests.calib.page.test_report import evidence_of

    report.page(evidence_of(Calibration(KOALA.camera, {}))).write(out / "page.html")
    return out / "page.html"


def of_scene(fixture: Fixture, out: Path) -> Path:
    koala.save(fixture("make_scene")(), out / "scene")
    scene_report.write(out / "scene", out / "page.html", matches=False)
    return out / "page.html"


def of_run(fixture: Fixture, out: Path) -> Path:
    from koala3d.reconstruct.output import report

    fixture("without_mesh")
    return Path(report.write(fixture("ball"), out / "page")["report"])


def of_diagnosis(fixture: Fixture, out: Path) -> Path:
    from koala3d.reconstruct.diagnosis.diagnose import diagnose, write

    return write(diagnose(fixture("ball"), pictures=False), fixture("ball"), out / "page")


def of_sweep(fixture: Fixture, out: Path) -> Path:
    from koala3d.reconstruct.experiments import comparison, page

    make_row = fixture("make_row")
    before, after = ([make_row(scene, psnr=psnr) for scene in ("ball", "head")] for psnr in (20.0, 22.0))
    (out / "page.html").write_text(page.of_comparison("after against before", comparison.compare(before, after)))
    return out / "page.html"


def of_series(fixture: Fixture, out: Path) -> Path:
    from koala3d.reconstruct.series import page
    from koala3d.reconstruct.series.table import Row

    rows = [
        Row(name, "done", "", "", {"train": 60.0}, {"psnr": psnr}, {}, "", "", [])
        for name, psnr in (("cup", 31.0), ("jug", 28.0))
    ]
    page.write(rows, {row.name: out / row.name for row in rows}, out, {})
    return out / "index.html"


def of_shapes(fixture: Fixture, out: Path) -> Path:
    from koala3d.reconstruct.output.shape import comparison, files
    from tests.reconstruct.output.shape.test_comparison import DENT, DRAWING, piece

    found = comparison.compare(piece(dent=DENT), DRAWING, by="base")
    (place,) = found.places
    files.write(replace(found, places=[place, replace(place, point=place.point + 0.01)]), out, "reconstruct compare-shape")
    return out / "index.html"


REPORTS = {
    "capture/page/report.py": of_recording,
    "calib/page/report.py": of_calibration,
    "datasets/reports/scene.py": of_scene,
    "reconstruct/output/report.py": of_run,
    "reconstruct/diagnosis/diagnose.py": of_diagnosis,
    "reconstruct/experiments/page.py": of_sweep,
    "reconstruct/output/shape/files.py": of_shapes,
    "reconstruct/series/page.py": of_series,
}
"""How the report of each module is made."""


@pytest.mark.parametrize("module", REPORTS)
def test_a_report_is_sound_and_sorts_its_tables(
    module: str, request: pytest.FixtureRequest, tmp_path: Path, browse: Browse
) -> None:
    written = REPORTS[module](request.getfixturevalue, tmp_path)
    with browse(written.as_uri()) as window:
        table = window.page.locator("table.sortable").filter(has=window.page.locator("tbody tr + tr")).first
        column = [bool(words) for words in table.locator("th").all_text_contents()].index(True)  # the first may be of pictures
        head, names = table.locator("th").nth(column), table.locator(f"td:nth-child({column + 1})")
        head.click()
        rising = names.all_text_contents()
        head.click()
        assert head.get_attribute("aria-sort") == "descending" and names.all_text_contents() == rising[::-1] != rising


def test_a_plan_turns_steps_and_plays(tmp_path: Path, browse: Browse) -> None:
    views = (
        "views=[{kind: orbit, target: [0.4, 0.0, 0.14], distance: 0.4, elevation_deg: 50, count: 2, roll_deg: [0, 90, 180, 270]}]"
    )
    session, mount = load_trajectory("koala_demo", overrides=[views, "split=null"]), RigDescription().carrier()
    draw.page(plan(session, mount), Obstacles.of(session, mount), tmp_path / "plan.html", title="two views")
    with browse((tmp_path / "plan.html").as_uri()) as window:
        page = window.page
        drawn = lambda: page.evaluate("canvas.toDataURL()")  # noqa: E731
        page.get_by_text("two views\nview 000").wait_for()
        page.keyboard.press("ArrowRight")
        page.get_by_text("view 001").wait_for()
        before = drawn()
        page.mouse.move(200, 200)
        page.mouse.down()
        page.mouse.move(300, 220)
        page.mouse.up()
        assert drawn() != before, "it turns"
        page.get_by_text("play").click()
        page.wait_for_function("document.getElementById('time').value < 1")  # from the end to the beginning
        page.get_by_text("pause").click()


def test_no_page_is_left_out() -> None:
    """Whatever writes a page is opened above; the only templates are those of the reports and of the plan."""
    sources = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    writing = {str(path.relative_to(ROOT)) for path in sources if "= ReportPage(" in path.read_text(encoding="utf-8")}
    assert writing == {*REPORTS, "datasets/reports/html.py"}
    templates = {path.name for package in PACKAGES for path in (ROOT / package).rglob("*.html")}
    assert templates == {"report.html", "blocks.html", "plan.html"}
