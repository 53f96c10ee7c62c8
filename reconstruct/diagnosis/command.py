"""`reconstruct diagnose`."""

from pathlib import Path
from typing import Annotated

from typer import Option

from koala3d.datasets.core import console
from koala3d.reconstruct.options import RunFolder


def diagnose(
    run: RunFolder,
    out: Annotated[Path | None, Option("--out", help="Folder for a page with residual maps; must be new.")] = None,
    quick: Annotated[bool, Option("--quick", help="Do not check the scene's pictures again.")] = False,
    as_json: console.Json = False,
) -> None:
    """Name the causes of a bad result: what, where, evidence, remedy."""
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.backend import configure_process
    from koala3d.reconstruct.diagnosis.diagnose import diagnose as find
    from koala3d.reconstruct.diagnosis.diagnose import write
    from koala3d.reconstruct.output.trained_model import TrainedModel

    if out is not None:
        refuse_existing(out)
    configure_process()
    trained = TrainedModel.open(run)
    found = find(trained, pictures=not quick)
    page = None if out is None else write(found, trained, out, made_by=console.command_line())
    verdict = f"{len(found.findings)} findings" if found.findings else "nothing stands out"
    lines = [*(finding.line for finding in found.findings), verdict, *([str(page)] if page else [])]
    result = {**found.to_json(), **({"page": str(page)} if page else {})}
    console.report(result, as_json=as_json, text="\n".join(lines))
