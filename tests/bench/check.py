"""The table of what the checks name: good scenes, injured in every way at three strengths, and left as they are."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from koala3d.datasets.checks import coverage
from koala3d.datasets.checks.evidence import VIEWS, Evidence
from koala3d.datasets.checks.matches import check_evidence
from koala3d.datasets.core import console
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.datasets.splits import evenly
from tests.bench.injure import INJURIES, Injury, whole
from tests.bench.studio import Studio, write

SIDE = 400
"""Pictures are shrunk to this many pixels a side. As many views are used as the checks look at, evenly spread."""
LIGHTS = (0.15, 0.3, 0.6)
"""Shares of the light from lamps that do not stand still with the object."""
MOST_NAMED = 0.5
"""Share of the hurt views that must be named."""


@dataclass(frozen=True)
class Trial:
    """One check of one scene."""

    scene: str
    injury: str
    strength: float
    unit: str
    named: bool
    others: tuple[str, ...]
    """Other findings, less those on the untouched scene."""


def trials(
    scenes: Sequence[Scene], *, injuries: Sequence[Injury] = INJURIES, lights: bool = True, done: Step = ignore
) -> Iterator[Trial]:
    """Check each scene untouched and after each injury; then the simulated lights."""
    for original in scenes:
        with tempfile.TemporaryDirectory() as folder:
            scene = prepared(original, Path(folder))
            known = Evidence.gather(scene, count=VIEWS)
            untouched = found_in(scene, known)
            for finding in untouched:
                yield Trial(scene.name, "none", 0.0, "", False, (f"{finding.cause}: {finding.what} ({finding.why})",))
            if not untouched:
                yield Trial(scene.name, "none", 0.0, "", False, ())
            done()
            causes = {finding.cause for finding in untouched}  # in their respect this is no good scene
            for injury in (one for one in injuries if fits(one, scene) and one.cause not in causes):
                for strength in injury.strengths:
                    yield _trial(scene, known, injury, strength, untouched)
                    done()
    for frame in ("camera", "turntable") if lights else ():
        for directed in LIGHTS:
            with tempfile.TemporaryDirectory() as folder:
                studio = Studio(lamps=frame, directed=directed, table=frame == "camera")
                found = {finding.cause for finding in found_in(write(studio, Path(folder)))}
            yield Trial("studio", f"light: {frame}", directed, "", "light" in found, tuple(sorted(found - {"light"})))
            done()


def _trial(scene: Scene, known: Evidence, injury: Injury, strength: float, untouched: Sequence[Finding]) -> Trial:
    with tempfile.TemporaryDirectory() as folder:
        injured, hurt = injury.apply(scene, strength, Path(folder))
        found = found_in(injured, known)
    causes = {finding.cause for finding in untouched}
    own = [finding for finding in found if finding.cause == injury.cause]
    views = {name for finding in own for name in finding.evidence.get("views", {})}
    named = len(views & hurt) >= MOST_NAMED * len(hurt) if hurt else bool(own)
    others = tuple(sorted({finding.cause for finding in found} - {injury.cause} - causes))
    return Trial(scene.name, injury.name, strength, injury.unit, named, others)


def found_in(scene: Scene, known: Evidence | None = None) -> list[Finding]:
    """Findings from coverage and pictures; `known` is evidence from the same pictures under other cameras."""
    same = known is not None and [view.image for view in known.views] == [view.image for view in scene.views]
    evidence = seen_again(known, scene) if known is not None and same else Evidence.gather(scene, count=VIEWS)
    return [*coverage.find(scene), *check_evidence(evidence)]


def seen_again(known: Evidence, scene: Scene) -> Evidence:
    """The features and matches of the same pictures under other cameras and poses."""
    rays = []
    for before, after, features in zip(known.views, scene.views, known.matches.features, strict=True):
        rays.append(after.camera.directions(before.camera.project(features.directions)))
    matrices = np.stack([view.world_from_camera for view in scene.views])
    return replace(known.with_cameras(rays, matrices), scene=scene, views=scene.views)


def fits(injury: Injury, scene: Scene) -> bool:
    """Whether a scene is of the kind that an injury needs."""
    if injury.needs == "masks":
        return scene.background == "white"
    if injury.needs == "whole masks":
        return scene.background == "white" and 3 * len(whole(scene)) >= len(scene.views)
    if injury.needs == "surroundings":
        return scene.background != "white"
    if injury.needs == "all around":
        outward = np.stack([view.world_from_camera[:3, 3] for view in scene.views]) - scene.box.mean(0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        return bool(np.linalg.norm(outward.mean(0)) < 0.75) and not coverage.find(scene)
    return True


def prepared(scene: Scene, folder: Path) -> Scene:
    """A scene of at most `VIEWS` views with small pictures in `folder`."""
    train_and_test = evenly(scene.views, VIEWS)
    views = []
    for number, view in enumerate(train_and_test):
        shrink = max(1.0, max(view.camera.width, view.camera.height) / SIDE)
        width, height = round(view.camera.width / shrink), round(view.camera.height / shrink)
        path = folder / f"{number:03d}.png"
        images.write(path, images.resize(view.read(), width, height).clip(0, 1))
        split = "test" if number % 8 == 0 else "train"
        camera = view.camera.scaled(width, height)
        views.append(replace(view, name=f"{number:03d}", camera=camera, image=path, mask=None, truth={}, split=split))
    return replace(scene, views=tuple(views), sightings=None)


def table(found: Sequence[Trial]) -> str:
    """Named of all per injury and strength, then what was said of untouched scenes."""
    lines = []
    for name in dict.fromkeys(trial.injury for trial in found if trial.injury != "none"):
        own = [trial for trial in found if trial.injury == name]
        cells = []
        for strength in dict.fromkeys(trial.strength for trial in own):
            named = [trial.named for trial in own if trial.strength == strength]
            cells.append(f"{strength:g} {own[0].unit}: {sum(named)}/{len(named)}")
        lines.append(f"{name:<18}" + "   ".join(f"{cell:<16}" for cell in cells))
    injured = [trial for trial in found if trial.injury != "none"]
    if injured:
        lines.append(f"named {sum(trial.named for trial in injured)} of {len(injured)}")
    said = [trial for trial in found if trial.injury == "none"]
    lines += [f"untouched {trial.scene}: {line}" for trial in said for line in (trial.others or ("nothing",))]
    return "\n".join(line.rstrip() for line in lines)


def main(
    scenes: Annotated[list[Path] | None, typer.Argument(metavar="SCENE", help="Good scenes to injure.")] = None,
    injuries: Annotated[list[str] | None, typer.Option("--injury", help="Injury to include; repeatable.")] = None,
    lights: Annotated[bool, typer.Option("--lights/--no-lights", help="Also simulate lamps that do not stand still.")] = True,
) -> None:
    """Injure good scenes in every way at three strengths, and count what 'datasets check' names."""
    chosen = [one for one in INJURIES if not injuries or one.name in injuries]
    loaded = [load_scene(path, measure=True) for path in scenes or ()]
    with console.progress("checking", len(loaded) * (1 + 3 * len(chosen)) + 6 * lights, "trials") as shown:
        print(table(list(trials(loaded, injuries=chosen, lights=lights, done=shown.advance))))


if __name__ == "__main__":
    typer.run(main)
