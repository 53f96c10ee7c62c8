"""Each skip on and off on the same scene: its cost in error and its saving in time.

OUT/comparison.json      model, preset, overrides, and the scenes: name and path
OUT/SCENE/cells/NAME/    a run per cell; evaluated ones are not run again
OUT/skips.csv, skips.md  cost and saving of each skip on each scene
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.output.evaluate import METRICS
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.studies.jobs import BASE, CELLS, Job, Recipe, open_study, run_all, scenes_by_name
from koala3d.reconstruct.training.decisions import record

FORMAT, VERSION = "koala-skips", 1
COMPARISON = "comparison.json"
WORST_DB, WORST_DEG = 0.1, 0.2  # a skip with a higher cost than this on any scene is off by default
NORMALS = "normal_mae_alpha_acc_deg"


@dataclass(frozen=True)
class Result:
    """One skip on one scene, against the same training without it."""

    scene: str
    name: str
    applied: bool  # whether the skip applied to the scene
    psnr: tuple[float, float]  # kept, skipped [dB]
    normal_mae_deg: tuple[float, float] | None  # kept, skipped; None without true normals
    step_ms: tuple[float, float]  # kept, skipped: time of a step, from the fastest tenth of the training

    @property
    def cost_db(self) -> float:
        """Loss of PSNR [dB] by skipping."""
        return self.psnr[0] - self.psnr[1]

    @property
    def cost_deg(self) -> float | None:
        """Increase of the normal error [deg] by skipping."""
        return None if self.normal_mae_deg is None else self.normal_mae_deg[1] - self.normal_mae_deg[0]

    @property
    def cheap(self) -> bool:
        """Whether the cost permits it by default."""
        return self.cost_db <= WORST_DB and (self.cost_deg or 0.0) <= WORST_DEG


def cells(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Overrides of each cell: none for the base, one inverted skip for each other."""
    for name in names:
        if name not in record.NAMES:
            raise UsageError(f"there is no skip '{name}'", where="--skip", remedy=nearest(name, record.NAMES))
    chosen = names or record.NAMES
    defaults = load_config().skip
    return {BASE: ()} | {name: (f"skip.{name}={str(not getattr(defaults, name)).lower()}",) for name in chosen}


def run(
    scenes: Sequence[str],
    out: Path,
    *,
    names: Sequence[str] = (),
    model: str = "surfnerf",
    preset: str = "fast",
    overrides: Sequence[str] = (),
) -> list[Result]:
    """Run every cell that is not finished, then write the table.

    Raises UsageError: unknown scene, skip, model or setting; or `out` holds something else, or a comparison with other settings.
    """
    wanted, places = cells(names), scenes_by_name(scenes)
    recipes = {name: Recipe(path, model, preset, tuple(overrides)) for name, path in places.items()}
    first = next(iter(recipes.values()))
    first.config()  # raises before anything is written
    settings = first.content("model", "preset", "overrides")
    open_study(out / COMPARISON, kind=FORMAT, version=VERSION, settings=settings, members={"scenes": places})
    results: list[Result] = []
    for scene, recipe in recipes.items():
        run_all([Job(out / scene / CELLS / name, recipe, changes) for name, changes in wanted.items()], f"skips on {scene}")
        results += [compare(out / scene, name) for name in wanted if name != BASE]
        write(results, out)
    return results


def compare(folder: Path, name: str) -> Result:
    """One skip on one scene from its two runs."""
    base, turned = (folder / CELLS / cell for cell in (BASE, name))
    skipped_first = getattr(Run.open(base).config.skip, name)
    kept, skipped = (turned, base) if skipped_first else (base, turned)
    mean = [files.read_json(path / METRICS)["mean"] for path in (kept, skipped)]
    degrees = None if mean[0].get(NORMALS) is None else (mean[0][NORMALS], mean[1][NORMALS])
    applied = any(skip.name == name and skip.skipped for skip in record.read(skipped))
    times = (step_ms(kept), step_ms(skipped))
    return Result(folder.name, name, applied, (mean[0]["psnr"], mean[1]["psnr"]), degrees, times)


def step_ms(run: Path) -> float:
    """Time of a step in the fastest tenth of a run's log, which excludes the load of other programs."""
    points = [(line["step"], line["seconds"]) for line in Run.open(run).log()]
    steps, seconds = np.diff(np.array([(0, 0.0), *points]), axis=0).T
    return float(1e3 * np.quantile(seconds[steps > 0] / steps[steps > 0], 0.1))


def rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """The results as plain values."""
    found = []
    for r in results:
        about = {"scene": r.scene, "skip": r.name, "applied": r.applied}
        cost = {"cost_db": round(r.cost_db, 3), "cost_deg": None if r.cost_deg is None else round(r.cost_deg, 2)}
        kept_ms, skipped_ms = (round(ms, 1) for ms in r.step_ms)
        found.append({**about, **cost, "kept_ms": kept_ms, "skipped_ms": skipped_ms, "cheap": r.cheap})
    return found


def markdown(results: Sequence[Result]) -> str:
    """The results as a Markdown table."""
    lines = ["| scene | skip | cost | normals | time of a step | on by default |", "|---|---|---|---|---|---|"]
    for r in results:
        degrees = "-" if r.cost_deg is None else f"{r.cost_deg:+.2f}°"
        verdict = ("yes" if r.cheap else "no") if r.applied else "does not apply"
        times = f"{r.step_ms[0]:.1f} → {r.step_ms[1]:.1f} ms"
        lines.append(f"| {r.scene} | {r.name} | {r.cost_db:+.2f} dB | {degrees} | {times} | {verdict} |")
    return "\n".join(lines) + "\n"


def write(results: Sequence[Result], out: Path) -> None:
    """OUT/skips.csv and OUT/skips.md."""
    text, content = io.StringIO(), rows(results)
    writer = csv.DictWriter(text, content[0].keys(), lineterminator="\n")
    writer.writeheader()
    writer.writerows(content)
    files.write_text(out / "skips.csv", text.getvalue())
    files.write_text(out / "skips.md", markdown(results))
