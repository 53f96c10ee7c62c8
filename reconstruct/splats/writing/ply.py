"""PLY as 3D Gaussian Splatting's own program writes it, which all viewers read (Kerbl et al. 2023).

One vertex per splat, little-endian floats: `x y z`, the normal, `f_dc_0..2` (the first coefficient of red, green, blue),
`f_rest_0..44` (the other fifteen of red, then of green, then of blue), `opacity` (its logit), `scale_0..2` (natural logarithms
of standard deviations), `rot_0..3` (a quaternion, w first).
"""

from pathlib import Path

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.reconstruct.splats.splats import Splats


def save(splats: Splats, path: Path) -> None:
    """Write splats as FILE.ply, with comments that name frame and unit."""
    values = splats.coefficients
    normals = pose.from_quaternion(splats.quaternions)[:, :3, 2]
    columns = {
        ("x", "y", "z"): splats.points,
        ("nx", "ny", "nz"): normals,
        tuple(f"f_dc_{k}" for k in range(3)): values[:, 0],
        tuple(f"f_rest_{k}" for k in range(3 * (values.shape[1] - 1))): values[:, 1:].transpose(0, 2, 1).reshape(len(values), -1),
        ("opacity",): np.log(splats.opacities / (1 - splats.opacities))[:, None],
        tuple(f"scale_{k}" for k in range(3)): np.log(splats.scales),
        tuple(f"rot_{k}" for k in range(4)): splats.quaternions,
    }
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame: world of the scene, the robot's base for a capture; unit: {'m' if splats.metric else 'unknown'}",
        f"element vertex {len(splats.points)}",
        *(f"property float {name}" for names in columns for name in names),
        "end_header\n",
    ]
    files.write_bytes(path, "\n".join(header).encode() + np.concatenate(list(columns.values()), 1).astype("<f4").tobytes())
