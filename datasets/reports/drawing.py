"""Drawings for reports: matplotlib figures as SVG with a transparent background, legible on white and on black."""

import io

from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

COLOURS = ("#2f6fde", "#d98324", "#2a9d5c", "#c0392b", "#8e5bbf", "#7f6a4f")
"""Of curves, distinguishable on both backgrounds."""
GREY = "#808080"


def blank(width: float, height: float) -> Figure:
    """An empty figure of a size in inches."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="none")


def svg_of(figure: Figure) -> str:
    """A figure as SVG with grey axes and text on a transparent background. The same figure gives the same text."""
    for axes in figure.axes:
        axes.set_facecolor("none")
        legend = axes.get_legend()
        words = [axes.title, axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels(), *axes.get_yticklabels()]
        for text in [*words, *(legend.get_texts() if legend else [])]:
            text.set_color(GREY)
        for line in (*axes.spines.values(), *axes.xaxis.get_ticklines(), *axes.yaxis.get_ticklines()):
            line.set_color(GREY)
    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": "koala"}):  # else its ids are random
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    return buffer.getvalue()
