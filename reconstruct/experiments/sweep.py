"""Sweeps: one run per scene, model and seed, on this machine or on a cluster (Ray), into one table.

OUT/sweep.json               preset, common overrides, budget, and the scenes: name and path
OUT/SCENE/MODEL/seed_N/      a run per scene, model and seed
OUT/SCENE/MODEL/seed_N.log   what it wrote to its terminal, on a cluster
OUT/table.md .csv .tex

An interrupted sweep is resumed; further scenes, models and seeds can be added.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from koala3d.datasets.core.console import hint, progress
from koala3d.reconstruct.backend import cache_compilations
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.output.evaluate import METRICS
from koala3d.reconstruct.studies import results_table
from koala3d.reconstruct.studies.jobs import Job, Recipe, chosen_seeds, open_study, scenes_by_name
from koala3d.reconstruct.studies.results import rows_of_runs
from koala3d.reconstruct.studies.seeds import seed_folder

FORMAT, VERSION = "koala-sweep", 1
SWEEP = "sweep.json"


def plan(
    scenes: Sequence[str],
    models: Sequence[str],
    preset: str,
    overrides: Sequence[str],
    budget_s: float | None,
    out: Path,
    seeds: Sequence[int] = (),
) -> list[Job]:
    """Every model on every scene with every seed, or the model's own; seed by seed, so that the table is complete early.

    All paths are absolute: a job may run in another working directory.

    Raises UsageError: an unknown scene, model or setting, a seed given twice, or two scenes of the same name.
    """
    out = out.absolute()
    pairs = product(scenes_by_name(scenes).items(), models)
    recipes = {(name, model): Recipe(path, model, preset, tuple(overrides), budget_s) for (name, path), model in pairs}
    of_model = {recipe.model: chosen_seeds(recipe.config(), seeds) for recipe in recipes.values()}
    return [
        Job(out / name / model / seed_folder(seed), recipe, (f"train.seed={seed}",))
        for turn in range(len(seeds) or 1)
        for (name, model), recipe in recipes.items()
        for seed in [of_model[model][turn]]
    ]


def run(wanted: Sequence[Job], out: Path, *, ray_address: str | None = None, use_ray: bool = False) -> dict[str, Any]:
    """Run the jobs that are not finished, then write the table of all runs in `out`, including earlier ones.

    Args:
        use_ray: run as Ray tasks, see `on_ray`; otherwise one after the other in this process.
        ray_address: cluster to use; None starts Ray on this machine.

    Raises:
        UsageError: `out` holds something else, or a sweep with other settings; or there is no such cluster.
        ReconstructError: jobs failed; the others are finished and in the table.
    """
    out = out.absolute()
    settings = wanted[0].recipe.content("preset", "overrides", "budget_s")
    scenes = {Path(job.recipe.scene).name: job.recipe.scene for job in wanted}
    open_study(out / SWEEP, kind=FORMAT, version=VERSION, settings=settings, members={"scenes": scenes})
    todo = [job for job in wanted if not job.done]
    failed: dict[str, str] = {}
    with progress("sweeping", len(todo), "runs") as bar:
        for job, problem in _ended(todo, use_ray, ray_address):
            name = "/".join(job.path.parts[-3:])
            if problem:
                failed[name] = problem
                hint(f"{name}: {problem}")
            bar.note(name)
            bar.advance()
    earlier = sorted(path.parent for path in out.glob(f"*/*/*/{METRICS}"))
    done = [path for path in dict.fromkeys([*(job.path for job in wanted), *earlier]) if (path / METRICS).is_file()]
    if done:
        rows = rows_of_runs(done)
        results_table.write_all(rows, results_table.chosen_columns(rows), out)
    if failed:
        why = ": ".join(next(iter(failed.items())))
        advice = "fix it and run the sweep again: finished runs are kept"
        raise ReconstructError(f"{len(failed)} of {len(todo)} runs failed", where=out, why=why, remedy=advice)
    return {"out": str(out), "runs": len(done), "trained": len(todo), "table": str(out / "table.md")}


def _ended(todo: Sequence[Job], use_ray: bool, ray_address: str | None) -> Iterator[tuple[Job, str]]:
    """Jobs as they end, each with its error or ""."""
    if use_ray:
        from koala3d.reconstruct.studies import on_ray  # Ray is optional

        yield from on_ray.run_all(todo, ray_address)
    else:
        cache_compilations()
        yield from ((job, job.attempt()) for job in todo)
