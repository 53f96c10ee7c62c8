"""Lens models: which coefficients are estimated, and which models are tried."""

from dataclasses import dataclass
from typing import Literal

from koala3d.calib.intrinsics import projection
from koala3d.datasets.spline import Grid


@dataclass(frozen=True)
class Lens:
    """A distortion model: which coefficients are estimated."""

    coefficients: tuple[str, ...]
    fisheye: bool = False
    grid: Grid | None = None  # the knots of a splined lens, which are estimated

    @property
    def free(self) -> tuple[str, ...]:
        """All intrinsics that are estimated."""
        return ("fx", "fy", "cx", "cy", *self.coefficients, *projection.knot_names(self.grid))

    @property
    def form(self) -> projection.Form:
        """What the lens is beside its numbers."""
        return projection.Form(self.fisheye, self.grid)


BROWN = tuple(Lens(names) for names in ((), ("k1",), ("k1", "k2"), ("k1", "k2", "p1", "p2"), ("k1", "k2", "p1", "p2", "k3")))
USUAL = BROWN[3]
RATIONAL = Lens(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"))
FISHEYE = (Lens(("k1", "k2"), True), Lens(("k1", "k2", "k3", "k4"), True))
EVERY = (*BROWN, RATIONAL, *FISHEYE)
LENSES = {"auto": EVERY, "brown": BROWN, "rational": (*BROWN, RATIONAL), "fisheye": FISHEYE, "splined": EVERY}
"""Candidates by the name of the `--lens` option."""
Spline = Literal["never", "if better", "always"]
SPLINES: dict[str, Spline] = {"auto": "if better", "splined": "always"}
"""When knots are added to the best candidate, by the same name; else never."""
