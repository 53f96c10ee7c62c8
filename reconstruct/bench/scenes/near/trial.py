"""Renders a small picture of a near scene, then exits with 0. Run in a child, which may crash.

python -m koala3d.reconstruct.bench.scenes.near.trial llvm_ad_rgb
"""

import sys

import numpy as np

from koala3d.reconstruct.bench.scenes.near.scenes import half_mirror
from koala3d.reconstruct.bench.scenes.near.views import Lit
from koala3d.reconstruct.bench.scenes.stages import spiral_poses
from koala3d.reconstruct.bench.scenes.views import camera_of


def main(using: str) -> int:
    """Return 0 if the variant `using` shows a scene with finite values."""
    scene = half_mirror()
    maps = Lit(scene, scene.shape(), cells=12, using=using).maps(camera_of(8), spiral_poses(2, 0)[0])
    return 0 if all(np.isfinite(values).all() for values in maps.values()) and maps["specular"].max() > 0 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
