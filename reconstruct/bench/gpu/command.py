"""The command `reconstruct bench gpu`."""

from pathlib import Path
from typing import Annotated

from typer import Option

from koala3d.datasets.core import console


def gpu_command(
    out: Annotated[Path | None, Option("--out", help="Folder to write; an interrupted measurement is resumed.")] = None,
    seconds: Annotated[
        float | None,
        Option(
            "--seconds", min=0.1, help="Seconds of training in all; default: 180. Needed on a processor, which tries small sizes."
        ),
    ] = None,
    data: Annotated[Path | None, Option(help="Folder with the real scenes; default: the usual places.")] = None,
    plan_only: Annotated[
        bool, Option("--plan", help="Compile the published step at its sizes and say what it needs; train nothing.")
    ] = False,
    as_json: console.Json = False,
) -> None:
    """Measure a GPU in ten minutes: rays per second of both presets, error over time, rendering, memory, all devices and one."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.reconstruct.bench.gpu import memory, run
    from koala3d.reconstruct.bench.gpu.plan import Sizes, trials

    about = run.device()
    if plan_only:
        sizes = Sizes.on("gpu", seconds)
        plans, todo = run.step_plans(sizes), trials(sizes)
        text = f"{about['text']}\n{run.listing(todo)}\n{memory.text(plans)}"
        console.report({"device": about, "trials": [vars(one) for one in todo], "plans": plans}, as_json=as_json, text=text)
        return
    if about["platform"] == "cpu" and seconds is None:
        remedy = "install the extra 'gpu', or give --seconds to try the command here at small sizes"
        raise UsageError("there is no GPU to measure", why=f"JAX computes on a {about['platform']}", remedy=remedy)
    if out is None:
        raise UsageError("give the folder of the measurement: --out DIR")
    found = run.measure(about, Sizes.on(about["platform"], seconds), out, data)
    console.report(found, as_json=as_json, text=run.text(found))
