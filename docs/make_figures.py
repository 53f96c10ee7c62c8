"""Makes the pictures of README.md and docs/ from the demonstration and the real code: `make figures`.

    python docs/make_figures.py DEMO OUT [PAGE...]

DEMO is the output of `make demo`. With names of pages, only their screenshots are made. Screenshots need an installed Chromium.
"""

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drawings
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording

WIDTH, HEIGHT, PANEL = 1280, 720, 400
"""Size of the browser's window, and width of the panel in it [px]."""
STILL_S = 10.0
"""A screenshot is taken once the page has not changed for this time: pictures sharpen while nobody moves."""
PATIENCE_S = 240.0


@dataclass(frozen=True)
class Shot:
    """A command that serves a page, and how the page is set up before the screenshot."""

    package: str
    words: list[str]
    least: float
    """Share of the picture that is not white once everything is shown."""
    channel: str = ""
    switched: tuple[str, ...] = ()
    """Labels of boxes to click."""


def main() -> None:
    """Make all pictures; the last line names their folder."""
    if len(sys.argv) < 3:
        raise UsageError("give the folder of the demonstration and that of the pictures", remedy="or run: make figures")
    demo, out = Path(sys.argv[1]), Path(sys.argv[2])
    for needed in ("board", "recording", "calibration.json", "run", "report/strip.png", "mesh.ply"):
        if not (demo / needed).exists():
            raise UsageError("is missing", where=demo / needed, remedy="run: make demo")
    out.mkdir(parents=True, exist_ok=True)
    if only := tuple(sys.argv[3:]):
        return pages(demo, out, only)
    drawings.draw_all(out)
    shutil.copy(demo / "report" / "strip.png", out / "gold_head.png")
    images.write(out / "board.png", contact_sheet(demo / "board", (2, 11, 20), width=320, columns=3))
    images.write(out / "recording.png", contact_sheet(demo / "recording", tuple(range(0, 48, 4)), width=160, columns=6))
    plan("koala_demo", out / "plan.png")
    plan("koala_hanging", out / "plan_hanging.png")
    pages(demo, out)
    console.hint(str(out))


def contact_sheet(recording: Path, chosen: tuple[int, ...], *, width: int, columns: int) -> NDArray[np.float32]:
    """Some photographs of a recording in rows, each `width` pixels wide, with white gaps."""
    opened = Recording.open(recording)
    pictures = []
    for index in chosen:
        picture = images.read(opened.image_path(opened.frames[index]))[..., :3]
        resized = images.resize(picture, width, round(width * picture.shape[0] / picture.shape[1]))
        pictures.append(np.pad(resized, ((0, 6), (0, 6), (0, 0)), constant_values=1.0))
    rows = [np.concatenate(pictures[start : start + columns], axis=1) for start in range(0, len(pictures), columns)]
    return np.concatenate(rows)[:-6, :-6]


def plan(name: str, path: Path) -> None:
    """The plot of `capture plan --plot` for a shipped trajectory."""
    from koala3d.capture.model.rig import RigDescription
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.planning import Obstacles, draw, duration
    from koala3d.capture.planning import plan as planned_views

    session = load_trajectory(drawings.SESSION.with_name(f"{name}.yaml"))
    mount = RigDescription().carrier()
    planned = planned_views(session, mount)
    path.unlink(missing_ok=True)
    title = f"{session.name}: {len(planned)} views, about {duration(session, planned, mount):.0f} s"
    draw.plot(planned, Obstacles.of(session, mount), path, title=title)


def pages(demo: Path, out: Path, only: tuple[str, ...] = ()) -> None:
    """Screenshots of the commands' pages, all of them or those with the given names."""
    trajectory = str(drawings.SESSION.with_name("koala_demo.yaml"))
    run = str(demo / "run")
    shots = {
        "view_trajectory": Shot("capture", ["view", trajectory], 0.05),
        "view_calibration": Shot("calib", ["view", str(demo / "calibration.json"), "--recording", str(demo / "board")], 0.02),
        "view_scene": Shot("datasets", ["view", str(demo / "scene"), "--quick"], 0.05),
        "view_run": Shot("reconstruct", ["view", run], 0.05, switched=("cameras",)),
        "mesh": Shot(
            "reconstruct", ["view", run, "--mesh", str(demo / "mesh.ply")], 0.05, channel="nothing", switched=("cameras",)
        ),
    }
    shots = {name: shot for name, shot in shots.items() if not only or name in only}
    with console.progress("taking screenshots", len(shots), "pages") as shown, chromium() as browser:
        for name, shot in shots.items():
            with served(shot.package, shot.words) as url:
                photograph(browser, url, out / f"{name}.png", shot)
            shown.advance()


@contextmanager
def chromium() -> Iterator[Any]:
    """A headless browser with a software rasteriser."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        raise KoalaError("there is no Chromium on this computer", remedy="apt install chromium")
    software = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=software, timeout=1e3 * PATIENCE_S)
        yield browser
        browser.close()


@contextmanager
def served(package: str, words: list[str]) -> Iterator[str]:
    """The address of a command's page; the command runs inside the context."""
    code = (
        f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from koala3d.{package}.cli import main; main()"
    )
    process = subprocess.Popen([sys.executable, "-c", code, *words, "--port", "0", "--json"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            raise KoalaError("the page did not open", where=f"{package} {' '.join(words)}")
        yield json.loads(line)["url"]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=PATIENCE_S)


def photograph(browser: Any, url: str, path: Path, shot: Shot) -> None:
    """Open a page, set it up, wait until it shows enough and stops changing, and save a screenshot."""
    page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    page.goto(url)
    page.add_style_tag(content=".mantine-Notifications-root { display: none }")
    if shot.channel:
        page.get_by_label("channel", exact=True).first.click(timeout=1e3 * PATIENCE_S)
        page.get_by_role("option", name=shot.channel, exact=True).dispatch_event("click")
    for label in shot.switched:
        page.get_by_label(label, exact=True).first.click(timeout=1e3 * PATIENCE_S)
    deadline, before, since = time.monotonic() + PATIENCE_S, np.empty(0), time.monotonic()
    while True:
        page.screenshot(path=str(path), timeout=1e3 * PATIENCE_S)
        now = images.read(path)[:, : WIDTH - PANEL, :3]
        if now.shape != before.shape or np.abs(now - before).max() > 0.1 or (now.min(-1) < 0.95).mean() < shot.least:
            before, since = now, time.monotonic()
        elif time.monotonic() - since > STILL_S:
            break
        if time.monotonic() > deadline:
            raise KoalaError("the page does not stop changing", where=path, remedy="try again when the computer is idle")
        page.wait_for_timeout(1_000)
    page.close()


def run_program(program: Callable[[], None]) -> None:
    """Run a program of this folder; an error is one line and an exit code."""
    try:
        program()
    except KoalaError as error:
        console.hint(f"error: {error}")
        sys.exit(error.exit_code)


if __name__ == "__main__":
    run_program(main)
