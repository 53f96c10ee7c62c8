"""The commands that measure the methods on simulated sessions: `calib bench` and `calib study`."""

from pathlib import Path
from typing import Annotated

from typer import Option

from koala3d.datasets.core import console
from koala3d.datasets.core.console import Json

Seed = Annotated[int, Option("--seed", min=0, help="Seed of the noise.")]


def bench(
    out: Annotated[Path, Option("--out", help="Folder to write: bench.csv, bench.md, bench.png; or coverage.json, coverage.md.")],
    quick: Annotated[bool, Option("--quick", help="Measure a few points in one minute instead of all in 45 minutes.")] = False,
    coverage: Annotated[
        bool, Option("--coverage", help="Measure instead how often the stated 95 % region holds the truth, on arms with errors.")
    ] = False,
    trials: Annotated[
        int | None, Option("--trials", min=2, help="Sessions per point. Default: 200, with --quick 40, with --coverage 50.")
    ] = None,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Benchmark all methods: run time and error.

    Sessions are simulated without pictures. Errors are compared with the Cramer-Rao bound.
    """
    from koala3d.calib.study import bench_report
    from koala3d.calib.study.bench import full_grid, quick_grid, run
    from koala3d.datasets.core.files import refuse_existing

    refuse_existing(out)
    if coverage:
        return _measure_coverage(out, trials or 50, quick, seed, json)
    points = quick_grid() if quick else full_grid()
    with console.progress("measuring", len(points), "points") as bar:
        results = list(run(points, trials or (40 if quick else 200), seed, done=lambda result: bar.advance()))
    bench_report.write(out, results)
    text = f"{bench_report.describe(results)}\nwritten to {out}"
    console.report({"out": str(out), **bench_report.summary(results)}, as_json=json, text=text)


def _measure_coverage(out: Path, rigs: int, quick: bool, seed: int, json: bool) -> None:
    """The part of `calib bench --coverage`; with `quick` two conditions."""
    from koala3d.calib.study import coverage

    conditions = coverage.CONDITIONS[:2] if quick else coverage.CONDITIONS
    with console.progress("measuring", len(conditions) * rigs, "rigs") as bar:
        outcomes = list(coverage.run(conditions, rigs, seed, done=bar.advance))
    coverage.write(out, outcomes)
    result = {"out": str(out), "conditions": [coverage.summary(outcome) for outcome in outcomes]}
    console.report(result, as_json=json, text=f"{coverage.markdown(outcomes)}written to {out}")


def study(
    sessions: Annotated[int, Option("--sessions", min=2, help="Simulated sessions of each kind.")] = 60,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Study what makes a session good: board, tilts, distances, separate intrinsics.

    Simulates the Koala rig and prints a table (Markdown).
    """
    from koala3d.calib.study import variants

    with console.progress("simulating", len(variants.VARIANTS), "kinds of session") as bar:
        outcomes = list(variants.run(sessions, seed, done=lambda outcome: bar.advance()))
    columns = ("refinement", "park", "stated")
    finished = [o for o in outcomes if len(o.refined)]
    medians = [dict(zip(columns, o.medians(), strict=True)) for o in finished]
    rows = [{"session": o.variant.name, "failures": o.failures, **values} for o, values in zip(finished, medians, strict=True)]
    console.report({"sessions": sessions, "aim": variants.AIM, "kinds": rows}, as_json=json, text=variants.markdown(outcomes))
