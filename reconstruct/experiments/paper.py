"""The paper's ablations, as settings of a sweep."""

from collections.abc import Sequence

from koala3d.reconstruct.config import Config, LossConfig, SurfaceConfig

LOSSES = ("density", "normal", "bias", "variation")
PUBLISHED, REFNERF = SurfaceConfig(), LossConfig()  # their default weights
NO_PASS = "surface.enabled=false"
Settings = dict[str, tuple[str, ...]]
"""Overrides by the name of a setting."""


def ablations(base: Config) -> Settings:
    """The paper's ablations around a configuration, by name, without those that would repeat it.

    Sampling of the sphere, frequency of the second pass, form of the density smoothness, each loss disabled (or, if the base
    disables it, enabled with the published weight), and no hollowness. "no second pass" disables the four regularisers;
    "no regulariser" leaves the losses of Ref-NeRF at its weights.
    """
    settings: Settings = {}
    surface = base.surface
    for kind in ("lattice", "fibonacci", "random"):
        settings[f"sampling {kind}"] = (f"surface.sampling={kind}",)
    for first, last in ((2048, 16), (512, 4), (256, 2), (16, 16)):
        settings[f"every {first}/{last}"] = (f"surface.first_period={first}", f"surface.last_period={last}")
    for form in ("tangent", "published"):
        weight = surface.density or PUBLISHED.density
        settings[f"{form} density"] = (f"surface.density_form={form}", f"surface.density={weight}")
    settings = {name: changes for name, changes in settings.items() if not _repeats(surface, changes)}
    for loss in LOSSES:
        weight = getattr(surface, loss)
        if weight:
            settings[f"without {loss}"] = (f"surface.{loss}=0",)
        elif loss != "density":  # its forms are settings
            settings[f"with {loss}"] = (f"surface.{loss}={getattr(PUBLISHED, loss)}",)
    if base.losses.hollowness:
        settings["without hollowness"] = ("losses.hollowness=0",)
    settings["no second pass"] = (NO_PASS,)
    normals = [f"losses.{name}={getattr(REFNERF, name)}" for name in ("predicted_normals", "density_normals")]
    return settings | {"no regulariser": (NO_PASS, "losses.hollowness=0", *normals, "losses.last_density_normals=null")}


def _repeats(surface: SurfaceConfig, changes: Sequence[str]) -> bool:
    pairs = (change.removeprefix("surface.").split("=") for change in changes)
    return all(str(getattr(surface, name)) == value for name, value in pairs)
