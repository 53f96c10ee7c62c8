"""Sweeps: a training for each scene, model, setting, budget and seed, on this machine or on a cluster, into one table and page.

OUT/sweep.json                        preset, common overrides, scenes and settings
OUT/SCENE/MODEL/SETTING/seed_N/       a run
OUT/SCENE/MODEL/SETTING/seed_N.json   its result
OUT/SCENE/MODEL/SETTING/seed_N.log    what it wrote to its terminal
OUT/table.md .csv .tex, OUT/index.html

An interrupted sweep is resumed; further scenes, models, settings, budgets and seeds can be added.
"""

import shlex
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.core.console import hint, progress
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.formats import find
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.experiments import page, tables
from koala3d.reconstruct.experiments.jobs import BASE, Job, Recipe
from koala3d.reconstruct.experiments.paper import Settings, ablations
from koala3d.reconstruct.experiments.results import RESULTS, Result, rows_of, seed_folder
from koala3d.reconstruct.experiments.waiting import Runner

FORMAT, VERSION = "koala-sweep", 1
SWEEP, PAGE = "sweep.json", "index.html"
PAPER = "paper"
"""Name of all the paper's ablations together."""


def plan(
    scenes: Sequence[str],
    models: Sequence[str],
    preset: str,
    overrides: Sequence[str],
    out: Path,
    *,
    settings: Sequence[str] = (),
    budgets: Sequence[float] = (),
    seeds: Sequence[int] = (),
) -> list[Job]:
    """Every model on every scene, as it is and with each setting, for each budget and seed (default: the model's own).

    Seed by seed, so that the table is complete early. All paths are absolute: a job may run in another working directory.

    Args:
        settings: names of `ablations`, `PAPER` for all of them, or one's own: KEY=VALUE, several with spaces between.

    Raises UsageError: an unknown scene, model or setting, a seed given twice, or two scenes of the same name.
    """
    if len(set(seeds)) < len(seeds):
        raise UsageError("a seed is given twice", where="--seed", why=" ".join(map(str, seeds)), remedy="give each once")
    places, jobs = scenes_by_name(scenes), []
    bases = {model: Recipe("", model, preset, tuple(overrides)).config() for model in models}
    chosen = {model: chosen_settings(base, settings) for model, base in bases.items()}
    for turn in range(len(seeds) or 1):
        for (scene, path), model, budget in product(places.items(), models, budgets or (None,)):
            recipe = Recipe(path, model, preset, tuple(overrides), budget)
            seed = seeds[turn] if seeds else bases[model].train.seed
            for name, changes in chosen[model].items():
                recipe.config(changes)  # raises before anything is trained
                folder = out.absolute() / scene / model / folder_name(name, budget)
                jobs.append(Job(folder / seed_folder(seed), recipe, name, (*changes, f"train.seed={seed}")))
    return jobs


def chosen_settings(base: Config, wanted: Sequence[str]) -> Settings:
    """Overrides by the name of each wanted setting, the base first. Raises UsageError: there is no such setting."""
    known = ablations(base)
    found: Settings = {BASE: ()}
    for name in wanted:
        if name == PAPER:
            found |= known
        elif name in known:
            found[name] = known[name]
        elif all(0 < word.find("=") for word in name.split()):
            found[name] = tuple(name.split())
        else:
            raise UsageError(f"there is no setting '{name}'", where="--try", remedy=nearest(name, [PAPER, *known]))
    return found


def folder_name(setting: str, budget_s: float | None) -> str:
    """Folder name of a setting and a budget."""
    name = "".join(letter if letter.isalnum() or letter in ".-=" else "_" for letter in setting.replace(" = ", "_"))
    return name if budget_s is None else f"{name}_{budget_s:g}s"


def scenes_by_name(scenes: Sequence[str]) -> dict[str, str]:
    """Paths of scenes by the names of their folders. Raises UsageError: a scene does not exist, or two have the same name."""
    places = [find(scene).resolve() for scene in scenes]
    if len({place.name for place in places}) < len(places):
        raise UsageError("two scenes have the same name", why=", ".join(place.name for place in places), remedy="rename a folder")
    return {place.name: str(place) for place in places}


def run(wanted: Sequence[Job], out: Path, runner: Runner[Job]) -> dict[str, Any]:
    """Run the jobs that have no result, then write table and page of all results in `out`, earlier ones included.

    Raises:
        UsageError: `out` holds something else, or a sweep with other settings; or there is no such cluster.
        ReconstructError: jobs failed; the others are finished and in the table.
    """
    out, first = out.absolute(), wanted[0].recipe
    members = {
        "scenes": {Path(job.recipe.scene).name: job.recipe.scene for job in wanted},
        "settings": {f"{job.recipe.model}, {job.setting}": list(job.changes[:-1]) for job in wanted},
    }
    content = open_sweep(out, {"preset": first.preset, "overrides": list(first.overrides)}, members)
    todo = [job for job in wanted if not job.done]
    failed: dict[str, str] = {}
    with progress("sweeping", len(todo), "runs") as bar:
        for job, problem in runner([todo]):
            if problem is None:
                continue
            if problem:
                failed[job.name] = problem
                hint(f"{job.name}: {problem}")
            bar.note(job.name)
            bar.advance()
    found = dict.fromkeys([*(job.result for job in wanted if job.done), *sorted(out.glob(RESULTS))])
    results = [Result.read(path) for path in found]
    if results:
        write(results, content, out)
    if failed:
        why = ": ".join(next(iter(failed.items())))
        advice = "fix it and run the sweep again: finished runs are kept"
        raise ReconstructError(f"{len(failed)} of {len(todo)} runs failed", where=out, why=why, remedy=advice)
    return {"out": str(out), "runs": len(results), "trained": len(todo), "table": str(out / "table.md")}


def write(results: Sequence[Result], content: Mapping[str, Any], out: Path) -> None:
    """Write the table and the page of a sweep, given the content of its file; existing ones are replaced."""
    rows = rows_of(results)
    columns = tables.chosen_columns(rows)
    for suffix, text_of in tables.FORMATS.items():
        files.write_text(out / f"table{suffix}", text_of(rows, columns))
    made_by = [command(results, content, out)]
    files.write_text(out / PAGE, page.of_results(out.name, results, settings=content["settings"], made_by=made_by))


def command(results: Sequence[Result], content: Mapping[str, Any], out: Path) -> str:
    """The command line that makes a sweep."""
    origins = [one.origin for one in results]
    axes = {
        "scene": content["scenes"].values(),
        "model": (origin.model for origin in origins),
        "set": content["overrides"],
        "try": (origin.setting for origin in origins if origin.setting != BASE),
        "budget": (f"{origin.budget_s:g}" for origin in origins if origin.budget_s is not None),
        "seed": (str(one.seed) for one in results),
    }
    words = [f"--{axis} {shlex.quote(value)}" for axis, values in axes.items() for value in dict.fromkeys(values)]
    return " ".join(["reconstruct sweep", *words, f"--preset {content['preset']} --out {out}"])


def open_sweep(out: Path, settings: Mapping[str, Any], members: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Start a sweep, or check that an existing one has the same settings and extend it.

    Args:
        settings: values that never change, by key.
        members: collections, by key, to which entries may be added; an existing entry never changes.

    Returns:
        The content of its file.

    Raises UsageError: a setting differs, or the folder holds something else.
    """
    before: dict[str, Any] = {}
    if (out / SWEEP).is_file():
        before = files.read_json(out / SWEEP, kind=FORMAT, version=VERSION)
        pairs = {key: (before.get(key), value) for key, value in settings.items()}
        for key, entries in members.items():
            known = before.get(key, {})
            pairs |= {f"{key}.{name}": (known.get(name, value), value) for name, value in entries.items()}
        for key, (old, new) in pairs.items():
            if old != new:
                why = f"{key} was {_shown(old)}, and is {_shown(new)} now"
                raise UsageError("was started with other settings", where=out, why=why, remedy="choose another --out")
    else:
        files.refuse_existing(out)
    merged = {key: before.get(key, {}) | dict(entries) for key, entries in members.items()}
    content = {"format": FORMAT, "version": VERSION, **settings, **merged}
    files.write_json(out / SWEEP, content)
    return content


def _shown(value: Any) -> str:
    """A setting as on the command line."""
    return " ".join(map(str, value or ["nothing"])) if isinstance(value, list) else str(value)


def listing(jobs: Sequence[Job]) -> str:
    """The trainings and what each changes, a line each."""
    width = max(len(job.name) for job in jobs)
    lines = [f"{job.name:<{width}}  {' '.join(job.changes[:-1])}".rstrip() for job in jobs]
    return "\n".join([*lines, f"{len(jobs)} trainings"])
