"""What figures of merit are called where a person reads them; files keep the names of `metrics` and `surface_distance`."""

from reconstruct.output import metrics

NAMES = {
    "psnr": "PSNR", "ssim": "SSIM", "lpips": "LPIPS",
    "normal_mae_alpha_acc_deg": "normals, weighted with opacity", "normal_mae_deg": "normals, all of the object alike",
    "normal_pred_mae_alpha_acc_deg": "predicted normals, weighted with opacity", "normal_pred_mae_deg": "predicted normals, all of the object alike",
    "disparity_rmse": "disparity, RMS error", "depth_rmse_mm": "depth, RMS error", "depth_median_mm": "depth, median error",
    "diffuse_psnr": "diffuse part, PSNR", "specular_psnr": "specular part, PSNR", "seconds": "time to render a view",
    "chamfer_mm": "mesh, Chamfer distance", "accuracy_mm": "mesh, from it to the true surface",
    "completeness_mm": "mesh, from the true surface to it", "f_score": "mesh, F-score", "threshold_mm": "mesh, threshold of the F-score",
}  # fmt: skip
"""Of a view, then of the surface."""


def unit(name: str) -> str:
    """Unit of a figure, empty where it has none."""
    return metrics.DEFINITIONS[name][0] if name in metrics.DEFINITIONS else "mm" if name.endswith("_mm") else ""


def heading(name: str) -> str:
    """Name and unit, as "depth, median error [mm]"."""
    return f"{NAMES[name]} [{unit(name)}]" if unit(name) else NAMES[name]


def mesh_without(stands_on: str) -> str:
    """What the figures of a mesh leave out where it was said on which side the object stands, see `mesh.extract`."""
    return f"the mesh of what stands on {stands_on}, without what else reaches into the box"


def rounded(name: str, value: float) -> str:
    """A value with the digits that are worth reading; never fewer than two that are not zero."""
    digits = {"dB": 2, "deg": 1, "mm": 1, "s": 2}.get(unit(name), 3)
    return f"{value:.{digits}f}" if abs(value) >= 10.0 ** (1 - digits) or value == 0 else f"{value:.2g}"
