"""Renders a small picture with all features that the simulation uses, then exits with 0. Run in a child, which may crash.

python -m koala3d.capture.sim.laboratory.renderer_trial llvm_ad_rgb
"""

import sys

import numpy as np

from koala3d.capture.sim.laboratory.renderer import Renderer
from koala3d.capture.sim.laboratory.scenes import stage
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera


def main(variant: str) -> int:
    """Return 0 if `variant` renders the shiny ball with finite values."""
    renderer = Renderer(stage("shiny_ball", centre=(0.4, 0, 0.1), size=(0.2, 0.2, 0.2), seed=0), using=variant)
    camera, view = Camera(16, 16, 20, 20, 8, 8), pose.look_at((0, 0, 0.3), (0.4, 0, 0.1))
    light = renderer.radiance(camera, view, samples=2, seed=0)
    return 0 if np.isfinite(light).all() and renderer.surfaces(camera, view, seed=0).hit.any() else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
