"""Many scenes and many models: one run each, on this machine or on a cluster (Ray), into one table.

OUT/sweep.json               preset, common overrides, budget, and the scenes: name and path
OUT/SCENE/MODEL/seed_N/      a run per scene, model and seed
OUT/table.md .csv .tex

A run that was measured is not trained again, one that was broken off is gone on with: a sweep can be stopped at any time, and
further scenes, models and seeds can be added to it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from datasets.core.console import progress
from datasets.core.errors import UsageError
from reconstruct.errors import ReconstructError
from reconstruct.output.evaluate import METRICS
from reconstruct.studies import results_table
from reconstruct.studies.recipe import Recipe, begin, chosen_seeds, finish, named
from reconstruct.studies.results import rows_of_runs
from reconstruct.studies.seeds import seed_folder

FORMAT, VERSION = "koala-sweep", 1
SWEEP = "sweep.json"


@dataclass(frozen=True)
class Job:
    """One run of a sweep."""

    path: Path
    recipe: Recipe
    seed: int

    @property
    def name(self) -> str:
        """Scene, model and seed."""
        return "/".join(self.path.parts[-3:])

    def run(self) -> None:
        """Train and measure, as far as that was not done."""
        from reconstruct.backend import cache_compilations

        cache_compilations()
        finish(self.path, self.recipe, (f"train.seed={self.seed}",))


def jobs(
    scenes: Sequence[str],
    models: Sequence[str],
    preset: str,
    overrides: Sequence[str],
    budget_s: float | None,
    out: Path,
    seeds: Sequence[int] = (),
) -> list[Job]:
    """Every model on every scene with every seed, or with the model's own; seed by seed, so that there is a whole table early.

    Raises:
        UsageError: an unknown scene, model or setting, a seed twice, or two scenes of one name.
    """
    recipes = {
        (name, model): Recipe(path, model, preset, tuple(overrides), budget_s)
        for name, path in named(scenes).items()
        for model in models
    }
    of_model = {recipe.model: chosen_seeds(recipe.config(), seeds) for recipe in recipes.values()}
    return [
        Job(out / name / model / seed_folder(of_model[model][turn]), recipe, of_model[model][turn])
        for turn in range(len(seeds) or 1)
        for (name, model), recipe in recipes.items()
    ]


def run(wanted: Sequence[Job], out: Path, *, ray_address: str | None = None, use_ray: bool = False) -> dict[str, Any]:
    """Run all jobs that are not finished, then write the table of all runs that there are, earlier ones too.

    Args:
        use_ray: as tasks of Ray, each with a GPU where the cluster has any; else one after the other in this process.
        ray_address: cluster to use; None starts Ray on this machine. Workers must see the scenes and `out` under the same paths.

    Raises:
        UsageError: `out` holds something else, or a sweep with other settings.
        ReconstructError: jobs failed; the others are finished and in the table.
    """
    settled = wanted[0].recipe.content("preset", "overrides", "budget_s")
    scenes = {Path(job.recipe.scene).name: job.recipe.scene for job in wanted}
    begin(out / SWEEP, kind=FORMAT, version=VERSION, settled=settled, growing={"scenes": scenes})
    todo = [job for job in wanted if not (job.path / METRICS).is_file()]
    failed: dict[str, str] = {}
    with progress("sweeping", len(todo), "runs") as shown:
        for job, problem in _in_turn(todo) if not use_ray else _on_ray(todo, ray_address):
            if problem:
                failed[job.name] = problem
            shown.note(job.name)
            shown.advance()
    earlier = sorted(path.parent for path in out.glob(f"*/*/*/{METRICS}"))
    done = [path for path in dict.fromkeys([*(job.path for job in wanted), *earlier]) if (path / METRICS).is_file()]
    if done:
        rows = rows_of_runs(done)
        results_table.write_all(rows, results_table.chosen_columns(rows), out)
    if failed:
        name, problem = next(iter(failed.items()))
        raise ReconstructError(f"{len(failed)} of {len(todo)} runs failed", where=out, why=f"{name}: {problem}",
                               remedy="mend it and sweep again: what is finished is kept")  # fmt: skip
    return {"out": str(out), "runs": len(done), "trained": len(todo), "table": str(out / "table.md")}


def _in_turn(todo: Sequence[Job]) -> Iterator[tuple[Job, str]]:
    """Jobs and what went wrong with each, "" for nothing."""
    for job in todo:
        try:
            job.run()
        except (ReconstructError, OSError) as error:  # one scene's failure must not cost the others
            yield job, str(error)
        else:
            yield job, ""


def _on_ray(todo: Sequence[Job], address: str | None) -> Iterator[tuple[Job, str]]:
    """The same as tasks of Ray, in the order in which they end."""
    try:
        import ray
    except ImportError:
        raise UsageError("Ray is not installed", remedy="pip install 'koala-capture[sweep]', or sweep without --ray") from None
    ray.init(address=address, log_to_driver=False)
    try:
        gpus = 1 if ray.cluster_resources().get("GPU") else 0
        task = ray.remote(num_cpus=1, num_gpus=gpus)(Job.run)
        waiting = {task.remote(job): job for job in todo}
        while waiting:
            (ready, *_), _ = ray.wait(list(waiting), num_returns=1)
            job = waiting.pop(ready)
            try:
                ray.get(ready)
            except ray.exceptions.RayError as error:
                yield job, str(error).strip().splitlines()[-1]
            else:
                yield job, ""
    finally:
        ray.shutdown()
