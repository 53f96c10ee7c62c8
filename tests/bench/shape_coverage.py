"""Whether the stated errors of shapes hold: share of true errors inside the 95 % band, on scenes that did not calibrate it.

    python -m tests.bench.shape_coverage RUN...

Each run is of a rendered scene whose true surface is known. For each, the numbers of `uncertainty` are fitted to the others, and
the share of its surface whose true error is less than 1.96 standard deviations is measured; 90 to 97 % is right. The last lines
have the numbers from all runs, to be written into `uncertainty`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from jaxtyping import Float

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import find
from koala3d.reconstruct.backend import configure_process
from koala3d.reconstruct.output.evaluate import TRUE_SURFACE
from koala3d.reconstruct.output.mesh import extraction, reading
from koala3d.reconstruct.output.mesh.nearest import Nearest
from koala3d.reconstruct.output.mesh.surface_distance import FLOOR
from koala3d.reconstruct.output.shape import evidence, uncertainty
from koala3d.reconstruct.output.trained_model import TrainedModel

TAIL = 4.0
"""Degrees of freedom of Student's distribution that errors are taken to have while numbers are fitted: some are far off."""
WANTED = 0.95
"""Mean share of errors inside the band, over the scenes that calibrate it."""
MOST = 4000
"""Vertices of a scene that take part in a fit."""
RIGHT = (0.90, 0.97)


@dataclass(frozen=True)
class Measured:
    """The known surface of a run that can be compared with the truth."""

    name: str
    terms: Float[np.ndarray, "k v"]
    """What the numbers multiply [m]."""
    errors: Float[np.ndarray, " v"]
    """Distance from the true surface [m]."""
    areas: Float[np.ndarray, " v"]
    known: float
    """Share of the compared surface that is known."""

    def inside(self, numbers: Float[np.ndarray, " k"]) -> float:
        """Share of the area whose error is inside the 95 % band."""
        return float(np.average(self.errors < uncertainty.BAND * self.std(numbers), weights=self.areas))

    def std(self, numbers: Float[np.ndarray, " k"]) -> Float[np.ndarray, " v"]:
        """Standard deviations [m]."""
        return np.sqrt(np.sum((np.asarray(numbers)[:, None] * self.terms) ** 2, 0))

    def ratio(self, numbers: Float[np.ndarray, " k"]) -> float:
        """Mean error over mean standard deviation."""
        return float(np.average(self.errors, weights=self.areas) / np.average(self.std(numbers), weights=self.areas))


def measured(path: Path, resolution: int = extraction.RESOLUTION) -> Measured:
    """Measure a run. Raises UsageError where its scene has no true surface."""
    trained = TrainedModel.open(path)
    truth = find(trained.run.scene_path) / TRUE_SURFACE
    if not truth.is_file():
        raise UsageError("the scene has no true surface", where=path, remedy="give runs of rendered scenes")
    mesh = extraction.extract(trained, resolution=resolution)
    found, points = evidence.of(trained, mesh), np.asarray(mesh.vertices)
    nearest = Nearest(reading.read(truth, process=True))
    feet = nearest.feet(points)
    low, high = trained.scene.box
    compared = ((points >= low) & (points <= high)).all(-1) & (points[:, 2] > low[2] + FLOOR * (high[2] - low[2]))
    compared &= (found.views > 0) & ~nearest.on_an_edge(feet)
    known = compared & uncertainty.is_known(found)
    areas = np.bincount(mesh.faces.reshape(-1), np.repeat(mesh.area_faces / 3, 3), minlength=len(points))
    terms = np.stack(uncertainty.terms(found))[:, known]
    return Measured(path.name, terms, feet.distance[known], areas[known], float(areas[known].sum() / areas[compared].sum()))


def fitted(scenes: list[Measured]) -> Float[np.ndarray, " k"]:
    """Numbers under which the errors of all scenes, each with the same weight, are most likely, scaled so that `WANTED` holds."""
    from scipy.optimize import brentq, minimize

    parts = []
    for scene in scenes:
        some = np.random.default_rng(0).choice(len(scene.errors), MOST, p=scene.areas / scene.areas.sum())
        parts.append((scene.terms[:, some], scene.errors[some]))

    def unlikely(logarithms: Float[np.ndarray, " k"]) -> float:
        total = 0.0
        for terms, errors in parts:
            std = np.sqrt(np.sum((np.exp(logarithms)[:, None] * terms) ** 2, 0)) + 1e-12
            total += float(np.mean(np.log(std) + (TAIL + 1) / 2 * np.log1p((errors / std) ** 2 / TAIL)))
        return total

    start = np.log(np.asarray(uncertainty.NUMBERS))
    bounds = [(-7.0, 3.0)] * len(start)
    shape = np.exp(minimize(unlikely, start, method="Nelder-Mead", bounds=bounds, options={"maxiter": 600}).x)
    missing = lambda factor: float(np.mean([scene.inside(np.exp(factor) * shape) for scene in scenes])) - WANTED  # noqa: E731
    return np.exp(brentq(missing, -5, 5, xtol=1e-3)) * shape


def table(scenes: list[Measured]) -> str:
    """The result by leaving one scene out at a time, a line each."""
    lines = [f"{'held out':<22}{'inside 95 %':>12}{'right':>7}{'mean error':>12}{'of std':>8}{'known':>8}   numbers"]
    ratios = []
    for scene in scenes:
        numbers = fitted([other for other in scenes if other is not scene])
        inside = scene.inside(numbers)
        ratios.append(scene.ratio(numbers))
        error = 1e3 * float(np.average(scene.errors, weights=scene.areas))
        right = "yes" if RIGHT[0] <= inside <= RIGHT[1] else "low" if inside < RIGHT[0] else "high"
        values = " ".join(f"{number:.3g}" for number in numbers)
        lines.append(f"{scene.name:<22}{inside:>12.1%}{right:>7}{error:>9.3f} mm{ratios[-1]:>8.2f}{scene.known:>8.1%}   {values}")
    values, found = ", ".join(f"{number:.3g}" for number in fitted(scenes)), np.log(ratios)
    return "\n".join([*lines, f"NUMBERS = ({values})", f"EXPECTED, SPREAD = {np.exp(found.mean()):.2f}, {found.std(ddof=1):.2f}"])


def main(
    runs: Annotated[list[Path], typer.Argument(help="At least two runs of rendered scenes.")],
    resolution: Annotated[int, typer.Option(help="Grid points along the longest side of the object's box.")] = 256,
) -> None:
    """Print the coverage of each run by numbers from the others."""
    if len(runs) < 2:
        raise typer.BadParameter("at least two runs")
    configure_process()
    print(table([measured(run, resolution) for run in runs]))


if __name__ == "__main__":
    typer.run(main)
