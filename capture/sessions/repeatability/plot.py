"""A drawing of the visits: how far each component was from its view's mean, against time, with the drift."""

from typing import TYPE_CHECKING

import numpy as np

from koala3d.capture.sessions.repeatability.spread import AXES, Repeatability
from koala3d.datasets.reports.drawing import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UM_LABELS = {"mm": "position [mm]", "mdeg": "turn [mdeg]"}


def drawn(found: Repeatability) -> "Figure":
    """Six panels: position along x, y, z above turns about them; a colour for each view, the drift as a line."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 3, sharex=True)
    minutes = found.times_s / 60
    for number, (axes, name) in enumerate(zip(panels.ravel(), AXES, strict=True)):
        for view in np.unique(found.views):
            mine = found.views == view
            colour = COLOURS[int(view) % len(COLOURS)]
            axes.plot(minutes[mine], found.deviations[mine, number], ".", color=colour, label=f"view {view}")
            axes.plot(minutes[mine], found.curve[mine, number], "-", color=colour, linewidth=0.8)
        axis, unit = name.split("_")
        limit = 2 * found.spread_error[number]
        axis, digits = (axis, 3) if number < 3 else (f"about {axis}", 1)
        axes.set_title(f"{axis}: spread {found.spread[number]:.{digits}f} ± {limit:.{digits}f} {unit}", fontsize=10)
        axes.axhline(0.0, color="#808080", linewidth=0.6)
        if number % 3 == 0:
            axes.set_ylabel(UM_LABELS[unit])
        if number >= 3:
            axes.set_xlabel("time [min]")
    panels[0, 0].legend(fontsize=8, ncols=2)
    return figure
