"""Measures everything, each part in a process of its own: this one never touches the device, whose memory one process takes.

OUT/records.csv             a line per training, as `reconstruct bench` writes them
OUT/one_device/records.csv  where there are several devices: the same of one
OUT/gpu.json                device, sizes, and the plan of the published step
OUT/index.html              curves and tables
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.formats import find
from koala3d.reconstruct.backend import cache_folder
from koala3d.reconstruct.bench import context, report, runner
from koala3d.reconstruct.bench.gpu import memory
from koala3d.reconstruct.bench.gpu.plan import LARGE, LEGO, Sizes, trials
from koala3d.reconstruct.bench.records import DONE, Records, Row, latest
from koala3d.reconstruct.bench.scenes.shiny import EDITION
from koala3d.reconstruct.bench.suite import Trial

RESULT, ALONE = "gpu.json", "one_device"
FORMAT, VERSION = "koala-bench-gpu", 1
PATIENCE_S = 600.0
"""Time limit of a part beside the trainings."""
ONE = {"CUDA_VISIBLE_DEVICES": "0", "ROCR_VISIBLE_DEVICES": "0"}
"""Variables by which a process sees the first device only."""


def device() -> dict[str, Any]:
    """What `reconstruct backend` says, asked in a process of its own. Raises KoalaError where JAX finds no device at all."""
    return json.loads(_command("backend", "--json"))


def _command(*words: str) -> str:
    """Output of a `reconstruct` command in a process of its own."""
    command = [sys.executable, "-c", "from koala3d.reconstruct.cli import main; main()", *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    except subprocess.CalledProcessError as error:
        why = (error.stderr.strip().splitlines() or ["no output"])[-1]
        raise KoalaError("cannot be run", where=f"reconstruct {words[0]}", why=why[:200]) from None
    return done.stdout


def measure(about: dict[str, Any], sizes: Sizes, out: Path, data: Path | None = None) -> dict[str, Any]:
    """Everything that is not measured yet; what `run` leaves in gpu.json.

    Args:
        about: what `device` returned.
        data: folder of the real scenes.
    """
    folders, alone = {out: trials(sizes)}, out / ALONE
    if about["devices"] > 1:
        folders[alone] = trials(sizes, alone=True)
    places, failed = _places(sizes, data), 0
    with progress("measuring", sum(len(one) for one in folders.values()) + 1, "parts") as shown:
        for folder, todo in folders.items():
            records = Records(folder / runner.RECORDS)
            finished, variables = records.done(), ONE if folder == alone else {}
            for one in todo:
                shown.note(one.name)
                if one.scene in places and one.key not in finished:
                    row = runner.measure(one, places[one.scene], folder, sizes.settings, **variables)
                    failed += row["status"] != DONE
                    records.append(row)
                shown.advance()
        shown.note("memory of the published step")
        known = files.read_json(out / RESULT, kind=FORMAT, version=VERSION) if (out / RESULT).is_file() else {}
        plans = known.get("plans") or step_plans(sizes)
    absent = sorted({LEGO, LARGE} - set(places))
    result = {"device": about, "plans": plans, "failed": failed, "absent": absent, **context.describe()}
    files.write_json(out / RESULT, {"format": FORMAT, "version": VERSION, **result})
    report.write(out, made_by=[f"reconstruct bench gpu --out {out}"])
    return result | {"rows": rows_of(out), "alone": rows_of(alone), "page": str(out / report.REPORT)}


def _places(sizes: Sizes, data: Path | None) -> dict[str, Path]:
    """Folders of the scenes that are there; the large one is rendered once."""
    name, (train, test) = LARGE.rpartition("_")[0], sizes.views
    large = cache_folder() / runner.SCENES / f"{name}-{sizes.side}-{train}-{test}-{EDITION}"
    counts = ("--train", str(train), "--test", str(test), "--size", str(sizes.side))
    _command("bench", "scenes", "--scene", name, *counts, "--out", str(large))
    found = {LARGE: large / name}
    try:
        return found | {LEGO: find(LEGO, data)}
    except UsageError:
        return found


def step_plans(sizes: Sizes) -> list[dict[str, Any]]:
    """See `memory.plans`."""
    order = {"format": memory.FORMAT, "version": memory.VERSION, "settings": list(sizes.settings)}
    order["pixels"] = memory.VIEWS * sizes.side**2
    with tempfile.TemporaryDirectory(prefix="koala-bench-") as folder:
        found = runner.answer_of("koala3d.reconstruct.bench.gpu.memory", order, Path(folder), PATIENCE_S, {}, name="memory")
    return found["plans"]


def rows_of(folder: Path) -> list[Row]:
    """The finished trainings in a folder."""
    return latest(Records(folder / runner.RECORDS).rows())


def text(found: dict[str, Any]) -> str:
    """What was measured, as a table."""
    head = f"{found['device']['text']}; {found['machine']}, {found['cores']} cores, jax {found['jax']}, commit {found['commit']}"
    parts = [head, _table(found["rows"])]
    if found["alone"]:
        parts += ["one of these devices", _table(found["alone"])]
    for name in found["absent"]:
        parts.append(f"{name} was not found; --data FOLDER says where it is")
    if found["failed"]:
        parts.append(f"{found['failed']} trainings failed, see the column 'status' of {runner.RECORDS}")
    return "\n".join([*parts, memory.text(found["plans"]), found["page"]])


def _table(rows: Sequence[Row]) -> str:
    lines = [f"{'':<18}{'pictures':>10}{'preset':>8}{'trained':>9}{'steps':>8}{'rays/s':>12}{'PSNR':>8}{'a view':>10}"]
    for row in rows:
        pictures, psnr = f"{row['width']:.0f}x{row['height']:.0f}", row.get("psnr")
        quality = "" if psnr is None else f"{psnr:.2f}"
        speed = f"{row['training_s']:>7.1f} s{row['steps']:>8.0f}{row['rays_per_s']:>12,.0f}"
        lines.append(f"{row['scene']:<18}{pictures:>10}{row['preset']:>8}{speed}{quality:>8}{row['seconds']:>8.3f} s")
    return "\n".join(lines)


def listing(todo: Sequence[Trial]) -> str:
    """The trainings, a line each."""
    return "\n".join([one.name for one in todo] + [f"{len(todo)} trainings, {sum(one.budget_s for one in todo):g} s"])
