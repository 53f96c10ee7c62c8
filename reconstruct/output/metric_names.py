"""Names, units and definitions of all metrics for people; files keep the keys of `metrics` and `surface_distance`."""

from koala3d.reconstruct.output import metrics
from koala3d.reconstruct.output.mesh import surface_distance

# Key, name on its own, name as the heading of a column.
_NAMES = (
    ("psnr",                          "PSNR",                                           "PSNR"),
    ("ssim",                          "SSIM",                                           "SSIM"),
    ("psnr_inside",                   "PSNR inside the mask, less its edge",            "PSNR inside"),
    ("ssim_inside",                   "SSIM inside the mask, less its edge",            "SSIM inside"),
    ("lpips",                         "LPIPS",                                          "LPIPS"),
    ("normal_mae_alpha_acc_deg",      "normals, weighted by opacity",                   "MAE (alpha × opacity)"),
    ("normal_mae_deg",                "normals, over the whole object",            "MAE (alpha)"),
    ("normal_pred_mae_alpha_acc_deg", "predicted normals, weighted by opacity",         "predicted MAE (alpha × opacity)"),
    ("normal_pred_mae_deg",           "predicted normals, over the whole object",  "predicted MAE (alpha)"),
    ("disparity_rmse",                "disparity, RMS error",                           "RMSE"),
    ("depth_rmse_mm",                 "depth, RMS error",                               "depth RMSE"),
    ("depth_median_mm",               "depth, median error",                            "depth median"),
    ("diffuse_psnr",                  "diffuse part, PSNR",                             "diffuse PSNR"),
    ("specular_psnr",                 "specular part, PSNR",                            "specular PSNR"),
    ("seconds",                       "time to render a view",                          "time per view"),
    ("chamfer_mm",                    "mesh, Chamfer distance",                         "Chamfer"),
    ("accuracy_mm",                   "mesh, accuracy",                           "accuracy"),
    ("completeness_mm",               "mesh, completeness",                       "completeness"),
    ("f_score",                       "mesh, F-score",                                  "F-score"),
    ("threshold_mm",                  "mesh, threshold of the F-score",                 "F-score threshold"),
)  # fmt: skip
NAMES = {key: name for key, name, _ in _NAMES}
SHORT_NAMES = {key: short for key, _, short in _NAMES}
HIGHER_IS_BETTER = frozenset({"psnr", "ssim", "psnr_inside", "ssim_inside", "diffuse_psnr", "specular_psnr", "f_score"})


def unit(key: str) -> str:
    """Unit of a metric; empty if it has none."""
    return metrics.DEFINITIONS[key][0] if key in metrics.DEFINITIONS else "mm" if key.endswith("_mm") else ""


def definition(key: str) -> str:
    """What a metric means."""
    return metrics.DEFINITIONS[key][1] if key in metrics.DEFINITIONS else surface_distance.DEFINITIONS[key]


def heading(key: str) -> str:
    """Name and unit, as "depth, median error [mm]"."""
    return _with_unit(NAMES[key], key)


def column_heading(key: str) -> str:
    """Short name and unit, as "depth median [mm]"."""
    return _with_unit(SHORT_NAMES[key], key)


def _with_unit(name: str, key: str) -> str:
    return f"{name} [{unit(key)}]" if unit(key) else name


def mesh_note(stands_on: str) -> str:
    """What a mesh comprises that was extracted with `stands_on`, see `mesh.extraction`."""
    return f"the mesh of the object that stands on {stands_on}, without whatever else enters the box"


def rounded(key: str, value: float) -> str:
    """A value with the digits that are worth reading; never fewer than two that are not zero."""
    digits = {"dB": 2, "deg": 1, "mm": 1, "s": 2}.get(unit(key), 3)
    return f"{value:.{digits}f}" if abs(value) >= 10.0 ** (1 - digits) or value == 0 else f"{value:.2g}"
