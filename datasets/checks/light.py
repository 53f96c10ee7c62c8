"""Lamps that move with the camera, or stand still while the object turns."""

import numpy as np

from koala3d.datasets.checks.evidence import Evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.structure.light_frame import light_frames

LEAST = 0.12
"""Least share of the variation of colours that a moving frame explains beyond the world's; still light reaches 0.02."""
CERTAIN = 4.0
"""Least margin in standard deviations."""
WORDS = {"camera": "the light moves with the camera", "turntable": "the object turns before a light that stands still"}


def find(evidence: Evidence) -> list[Finding]:
    """A finding where the colours of points follow lamps that do not stand still with the object."""
    found = light_frames(evidence.matches, evidence.cloud, evidence.matrices)
    if not found.margin > max(LEAST, CERTAIN * found.std):
        return []
    shares = {name: float(np.round(share, 3)) for name, share in found.explained.items()}
    why = f"of the variation of {found.points} points' colours between views, lamps in the frame of the {found.best} explain "
    why += f"{100 * found.explained[found.best]:.0f}%, lamps that stand still {100 * max(found.explained['world'], 0):.0f}%"
    figures = {"frame": found.best, "explained": shares, "margin": found.margin, "std": found.std, "axis": found.axis.tolist()}
    remedy = "let the lamps stand still with the object; training decides the frame of reflections by itself, or takes "
    remedy += f"--set light.frame={found.best}"
    return [Finding("warning", WORDS[found.best], "all views", why, remedy, "light", figures)]
