"""One trial in a process of its own: `python -m koala3d.reconstruct.bench.trial ORDER.json RESULT.json`.

Its memory can be measured then, and a crash costs one trial only.
"""

import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.formats import load_scene
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.bench.suite import COST, QUALITY, Trial

KIND, VERSION = "koala-bench-trial", 1


def order(trial: Trial, scene: Path, run: Path, settings: Sequence[str] = ()) -> dict[str, Any]:
    """The order for `main`; `settings`, KEY=VALUE, go on top of the preset's."""
    content = {"trial": asdict(trial), "scene": str(scene), "run": str(run), "settings": list(settings)}
    return {"format": KIND, "version": VERSION, **content}


def main(arguments: list[str]) -> None:
    """Execute the order in the first file and write the result to the second."""
    from koala3d.reconstruct.backend import cache_compilations, cache_folder

    content = files.read_json(Path(arguments[0]), kind=KIND, version=VERSION)
    trial, place = Trial(**content["trial"]), Path(content["scene"])
    before = _entries(cache_folder())
    cache_compilations()
    scene = chosen_views(load_scene(place, measure=True), trial.views)
    result = {QUALITY: quality, COST: cost}[trial.kind](trial, scene, place, Path(content["run"]), content["settings"])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    result |= {"peak_memory_mb": peak, "cold": int(_entries(cache_folder()) > before)}
    files.write_json(Path(arguments[1]), {"format": KIND, "version": VERSION, **result})


def _entries(cache: Path) -> int:
    folder = cache / "jax"
    return sum(1 for _ in folder.iterdir()) if folder.is_dir() else 0


def chosen_views(scene: Scene, count: int) -> Scene:
    """The scene with `count` of its training views, evenly spaced; all for 0."""
    train = scene.split("train")
    if not count or count >= len(train):
        return scene
    kept = {train[round(index * (len(train) - 1) / max(count - 1, 1))].name for index in range(count)}
    return scene.with_views(tuple(view for view in scene.views if view.split != "train" or view.name in kept))


def trained_work(trial: Trial, scene: Scene, place: Path, out: Path, settings: Sequence[str]) -> dict[str, Any]:
    """Train, and measure the work, by the names of `records.WORK`."""
    import jax

    from koala3d.reconstruct.models import load_config
    from koala3d.reconstruct.rendering.model import Model
    from koala3d.reconstruct.run import Run
    from koala3d.reconstruct.scene.rays import scaled_camera
    from koala3d.reconstruct.training.loop import train

    config = load_config(trial.model, trial.preset, [f"scale={trial.scale}", f"train.seed={trial.seed}", *settings])
    clock, processor = time.perf_counter(), time.process_time()
    found = train(scene, place, config, out, budget_s=trial.budget_s)
    elapsed, processor = time.perf_counter() - clock, time.process_time() - processor
    run = Run.open(out)
    sampler = Model.create(jax.random.key(0), run.config, run.facts).sampler
    rate = run.config.train.accumulate * found["steps"] / max(found["training_s"], 1e-9)
    camera = scaled_camera(scene.split("train")[0], trial.scale)
    kept = ("steps", "training_s", "preparation_s", "compilation_s", "skipped_steps")
    rates = {"rays_per_s": rate * sampler.rays_drawn, "samples_per_s": rate * sampler.samples_drawn}
    images = {"width": camera.width, "height": camera.height, "train_views": len(scene.split("train"))}
    machine = {"cores_used": processor / elapsed, "device": run.content.get("device")}
    return {**{name: found[name] for name in kept}, **rates, **images, **machine, "occupied": run.log()[-1].get("occupied")}


def quality(trial: Trial, scene: Scene, place: Path, out: Path, settings: Sequence[str]) -> dict[str, Any]:
    """Train and evaluate on the test views."""
    from koala3d.reconstruct.output.evaluate import evaluate
    from koala3d.reconstruct.output.trained_model import TrainedModel

    found = trained_work(trial, scene, place, out, settings)
    measured = evaluate(TrainedModel.open(out))
    return {**found, **measured["mean"], **(measured.get("mesh") or {})}


def cost(trial: Trial, scene: Scene, place: Path, out: Path, settings: Sequence[str]) -> dict[str, Any]:
    """Train and render one test view: time and memory only."""
    from koala3d.reconstruct.output.trained_model import TrainedModel

    found = trained_work(trial, scene, place, out, settings)
    ready = TrainedModel.open(out)
    view = ready.scene.split("test")[0]
    ready.warm_up(view)
    start = time.perf_counter()
    ready.picture(view)
    return {**found, "seconds": time.perf_counter() - start}


if __name__ == "__main__":
    main(sys.argv[1:])
