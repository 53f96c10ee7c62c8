"""How a series is spread over workers: its steps are counted, not run, for the time that they once took.

    python -m tests.bench.series_scaling SERIES.yaml OUT --objects 48

OUT is the folder of a series that has run. A clock goes on from the end of one step to the end of the next, each worker runs one
step at a time, and steps are chosen as on a cluster. With `--ray` they are slept on a cluster that Ray simulates on this machine,
with so many nodes of one core each; what is then lost is also what Ray and this machine take for each step. A series cannot take
less than its work over the number of workers, nor less than its longest object; that is the best.
"""

import contextlib
import heapq
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Annotated

import typer
from ray.cluster_utils import Cluster

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments import on_ray
from koala3d.reconstruct.experiments.waiting import Batches, Needs, Waiting
from koala3d.reconstruct.series.file import read
from koala3d.reconstruct.series.plan import Piece, plan
from koala3d.reconstruct.series.run import Shelf, run
from koala3d.reconstruct.series.step import FORMAT, VERSION, Step

NODE = {"num_cpus": 1, "num_gpus": 0, "object_store_memory": 80_000_000, "include_dashboard": False}


@dataclass(frozen=True)
class Slept(Step):
    """A step that takes as long as another one did, less by a factor."""

    seconds: float = 0.0

    def attempt(self) -> str:
        """Sleep, and leave a result."""
        time.sleep(self.seconds)
        self.leave()
        return ""

    def leave(self) -> None:
        """Leave a result."""
        content = {"command": self.command, "seconds": self.seconds, "output": {}}
        files.write_json(self.result, {"format": FORMAT, "version": VERSION, **content})


def slept(piece: Piece, place: Path, faster: float) -> Piece:
    """An object like one that has run, in a folder of its own; pieces wait for nobody, and none is compared."""
    kept = [step for step in piece.steps if step.done and step.kind != "compare"]
    steps = tuple(
        Slept(place, step.kind, step.words, step.folder, needs=Needs(), seconds=step.read()["seconds"] / faster) for step in kept
    )
    return replace(piece, item=replace(piece.item, name=place.name), steps=steps, reference=None)


@contextlib.contextmanager
def cluster(workers: int) -> Iterator[str]:
    """Ray on this machine with so many nodes of one core; yields its address."""
    made = Cluster(initialize_head=True, head_node_args=NODE)
    try:
        for _ in range(workers - 1):
            made.add_node(**NODE)
        made.wait_for_nodes()
        yield made.address
    finally:
        made.shutdown()


def counted(batches: Batches[Slept], workers: int, clock: list[float]) -> Iterator[tuple[Slept, str | None]]:
    """Run steps by a clock; a `waiting.Runner`.

    Args:
        clock: gets the time at the end of each step [s].
    """
    waiting, running, now = Waiting(batches), list[tuple[float, str, Slept]](), 0.0
    while True:
        waiting.look()
        for step in sorted(waiting, key=lambda one: -one.left_s)[: workers - len(running)]:
            waiting.remove(step)
            heapq.heappush(running, (now + step.seconds, step.name, step))
            yield step, None
        if not running:
            return
        now, _, ended = heapq.heappop(running)
        clock.append(now)
        ended.leave()
        yield ended, ""


def measured(file: Path, out: Path, objects: int, workers: int, *, faster: float = 1.0, ray: bool = False) -> tuple[float, float]:
    """Time of the series with so many workers, and the best that is possible [s].

    Args:
        faster: with `ray`, factor by which steps are shorter than they were.
    """
    series = read(file)
    known = [piece for piece in plan(series, out).values() if any(step.done for step in piece.steps)]
    if not known:
        raise UsageError("has no finished steps", where=out, remedy="run the series first")
    with tempfile.TemporaryDirectory() as folder:
        shelf = Shelf(series, Path(folder) / "out")
        named = ((f"{piece.item.name}-{number}", piece) for number, piece in enumerate(cycle(known)))
        shelf.pieces = {name: slept(piece, shelf.out / name, faster if ray else 1.0) for name, piece in islice(named, objects)}
        alone = [sum(step.seconds for step in piece.steps if isinstance(step, Slept)) for piece in shelf.pieces.values()]
        best = max(sum(alone) / workers, max(alone))
        if not ray:
            clock: list[float] = []
            run(shelf, lambda batches: counted(batches, workers, clock))
            return clock[-1], best
        with cluster(workers) as address:
            began = time.monotonic()
            run(shelf, partial(on_ray.run_all, address=address, shared=[shelf.out]))
            return faster * (time.monotonic() - began), faster * best


def main(
    file: Annotated[Path, typer.Argument(metavar="SERIES.yaml")],
    out: Annotated[Path, typer.Argument(help="Folder of the series that has run.")],
    objects: Annotated[int, typer.Option(help="Objects, those of the series again and again.")] = 48,
    workers: Annotated[list[int] | None, typer.Option(help="Numbers of workers.")] = None,
    ray: Annotated[bool, typer.Option("--ray", help="Sleep on a cluster that Ray simulates.")] = False,
    faster: Annotated[float, typer.Option(help="With --ray, factor by which steps are shorter than they were.")] = 4.0,
) -> None:
    """Print a line for each number of workers."""
    typer.echo("workers  hours of the series  best  share of the best")
    for count in workers or [1, 2, 4, 8]:
        taken, best = measured(file, out, objects, count, faster=faster, ray=ray)
        typer.echo(f"{count:7}  {taken / 3600:19.3f}  {best / 3600:.3f}  {best / taken:17.0%}")


if __name__ == "__main__":
    typer.run(main)
