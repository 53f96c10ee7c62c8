"""Measures the page of a run: pictures per second while the view moves, memory over time, slowdown of a training.

    python docs/measure_pages.py moving RUN [SECONDS]
    python docs/measure_pages.py memory RUN [SECONDS]
    python docs/measure_pages.py training SCENE [SECONDS] [alone] [open] [moving]

A headless Chromium on the same computer shows the page with a software rasteriser; its work is included.
Each training takes SECONDS and starts from scratch: `alone`, with the page `open` and still, and with the view `moving` all the time.
"""

import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from make_figures import chromium, run_program, served

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import KoalaError, UsageError, nearest
from koala3d.datasets.page import open_page

KINDS = ("alone", "open", "moving")
"""Kinds of trainings."""
STEP_S = 0.05
"""Between two moves of the mouse."""


def main() -> None:
    """Measure one thing and print it as JSON."""
    if {"--help", "-h"} & set(sys.argv):
        return console.hint((__doc__ or "").strip())
    measures = {"moving": (moving, 20.0), "memory": (memory, 600.0), "training": (training, 60.0)}
    if len(sys.argv) < 3 or sys.argv[1] not in measures:
        raise UsageError("give what to measure and on what", remedy=f"one of {', '.join(measures)}, then a run or a scene")
    name, path, *rest = sys.argv[1:]
    measure, seconds = measures[name]
    if rest and rest[0].replace(".", "", 1).isdigit():
        seconds = float(rest.pop(0))
    known = KINDS if name == "training" else ()
    for word in rest:
        if word not in known:
            advice = nearest(word, known) if known else "give seconds alone"
            raise UsageError(f"there is no '{word}' in 'measure_pages {name}'", remedy=advice)
    if not Path(path).exists():
        raise UsageError("no such run or scene", where=path)
    console.report(measure(Path(path), seconds, *rest), as_json=True, text="")


def opened(browser: Any, url: str) -> Any:
    """A browser window with the page."""
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.goto(url)
    return page


def drag(page: Any, seconds: float) -> None:
    """Rotate the view with the mouse for some seconds."""
    end, count = time.monotonic() + seconds, 0
    page.mouse.move(400, 350)
    page.mouse.down()
    while time.monotonic() < end:
        count += 1
        page.mouse.move(400 + 150 * np.sin(0.06 * count), 350 + 60 * np.sin(0.041 * count))
        page.wait_for_timeout(1e3 * STEP_S)
    page.mouse.up()


class Watched:
    """The page of a run in this process, with the times at which pictures were sent."""

    def __init__(self, page: Any, path: Path) -> None:
        from koala3d.reconstruct.page.run_page import show
        from koala3d.reconstruct.run import Run

        self.sent: list[tuple[float, int]] = []
        shown = show(page, Run.open(path))
        paint = shown.eyes._paint

        def noted(client: Any, eye: Any, rays: int, cancelled: Any) -> None:
            given_up = [False]

            def asked() -> bool:
                given_up[0] = given_up[0] or cancelled()
                return given_up[0]

            paint(client, eye, rays, asked)
            if shown.trained is not None and not given_up[0]:
                self.sent.append((time.monotonic(), rays))

        shown.eyes._paint = noted


def moving(run: Path, seconds: float) -> dict[str, Any]:
    """Pictures per second while the view rotates, and the time from the last move to pictures of each size."""
    with open_page("measure", 0) as page, chromium() as browser:
        watched = Watched(page, run)
        window = opened(browser, page.url)
        while not any(rays > 100_000 for _, rays in watched.sent):  # everything is compiled
            window.wait_for_timeout(200)
        start = time.monotonic()
        drag(window, seconds)
        stop = time.monotonic()
        window.wait_for_timeout(15_000)
        while_moving = [at for at, _ in watched.sent if start <= at <= stop]
        after = {rays: round(at - stop, 2) for at, rays in reversed(watched.sent) if at > stop}
        longest = round(float(np.diff(while_moving).max()), 2)
        rate = round(len(while_moving) / seconds, 2)
        return {"seconds": seconds, "pictures_per_s": rate, "longest_wait_s": longest, "after_the_last_move_s": after}


def memory(run: Path, seconds: float) -> dict[str, Any]:
    """Memory of this process, the server, while a browser moves and changes channels; [MB]."""
    with open_page("measure", 0) as page, chromium() as browser:
        watched = Watched(page, run)
        window = opened(browser, page.url)
        while not watched.sent:
            window.wait_for_timeout(200)
        drag(window, 20)
        end, resident = time.monotonic() + seconds, [_resident_mb()]
        while time.monotonic() < end:
            drag(window, 10)
            window.wait_for_timeout(5_000)
            resident.append(_resident_mb())
        quarter = max(len(resident) // 4, 1)
        first, last = float(np.median(resident[:quarter])), float(np.median(resident[-quarter:]))
        found = {"seconds": seconds, "pictures": len(watched.sent), "resident_mb": resident}
        return found | {"first_quarter_mb": first, "last_quarter_mb": last}


def _resident_mb() -> int:
    return round(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20)


def training(scene: Path, seconds: float, *kinds: str) -> dict[str, Any]:
    """Steps of trainings of a given time: alone, with the page open and still, and with the view moving all the time."""
    return {"seconds": seconds, **{kind: _trained(scene, seconds, kind) for kind in kinds or KINDS}}


def _trained(scene: Path, seconds: float, kind: str) -> dict[str, float]:
    folder = Path(tempfile.mkdtemp())
    options = ["--budget", f"{seconds:g}", "--set", "train.checkpoint_s=15", "--json", "--out", str(folder / "run")]
    command = [sys.executable, "-m", "koala3d.reconstruct.cli", "train", str(scene), *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    log = folder / "run" / "log.jsonl"
    try:
        while not log.exists() and process.poll() is None:
            time.sleep(0.2)
        begun = time.monotonic()
        with ExitStack() as stack:
            if kind != "alone":
                window = opened(
                    stack.enter_context(chromium()), stack.enter_context(served("reconstruct", ["view", str(folder / "run")]))
                )
                while kind == "moving" and process.poll() is None:
                    drag(window, 2)
            process.wait()
        wall_s = time.monotonic() - begun
        assert process.stdout is not None
        result = json.loads(process.stdout.read())
        if process.returncode:
            raise KoalaError("the training failed", where=scene, why=result["error"])
        return {
            "steps": result["steps"],
            "steps_per_s": round(result["steps"] / result["training_s"], 2),
            "wall_s": round(wall_s, 1),
        }
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait()
        shutil.rmtree(folder)


if __name__ == "__main__":
    run_program(main)
