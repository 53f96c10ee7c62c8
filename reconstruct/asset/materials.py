"""From albedo and reflectance to the parameters of glTF 2.0's metallic-roughness material, and its textures.

    albedo = base (1 - metallic),  reflectance = 0.04 (1 - metallic) s + base metallic

with s = 1 but for what `KHR_materials_specular` says.
Both sums of a colour give base = albedo + reflectance - 0.04 (1 - metallic);
put into the first equation, metallic m solves 0.04 m^2 + (a + r - 0.08) m + 0.04 - r = 0, here for luminances a and r.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from koala3d.datasets.imaging import images
from koala3d.reconstruct.asset.bake import Baked
from koala3d.reconstruct.asset.texels import Texels

DIELECTRIC = 0.04  # reflectance of an index of refraction of 1.5, glTF's for everything that is no metal
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
WEAK, WEAK_SHARE = 0.9, 0.01
"""A specular factor below the first on more than this share of the surface is written; elsewhere 1 is meant."""

Texture = UInt8[np.ndarray, "size size channels"]


@dataclass(frozen=True)
class Textures:
    """Pictures of one size, first row at v = 1, as files have them."""

    base_colour: Texture
    """sRGB."""
    surface: Texture
    """Occlusion, roughness, metallic: linear, as glTF packs them."""
    normal: Texture
    """(n + 1) / 2 along tangent, bitangent and normal."""
    certainty: Texture
    """See `certainty.Certainty.channels`."""
    specular: Texture | None = None
    """Factor on the reflectance of what is no metal: its colour in sRGB. None where it is 1 nearly everywhere."""


def metallic_roughness(
    albedo: Float[np.ndarray, "n 3"], reflectance: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Base colour, metallic, and the specular factor s, all linear in 0..1."""
    a, r = albedo @ LUMINANCE, reflectance @ LUMINANCE
    middle = a + r - 2 * DIELECTRIC
    root = np.sqrt(np.maximum(middle**2 - 4 * DIELECTRIC * (DIELECTRIC - r), 0))
    metallic = np.where(r > DIELECTRIC, 2 * (r - DIELECTRIC) / np.maximum(middle + root, 1e-9), 0.0)
    metallic = np.clip(metallic, 0, 1)
    rest = DIELECTRIC * (1 - metallic)[:, None]
    base = np.where(metallic[:, None] > 0, np.clip(albedo + reflectance - rest, 0, 1), albedo)
    factor = np.where(rest > 1e-4, (reflectance - base * metallic[:, None]) / np.maximum(rest, 1e-4), 1.0)
    return base, metallic, np.clip(factor, 0, 1)


def textures(texels: Texels, baked: Baked) -> Textures:
    """The textures of a baked surface."""
    base, metallic, factor = metallic_roughness(baked.albedo, baked.reflectance)
    weak = (factor.max(-1) < WEAK) & (metallic < WEAK)
    picture = lambda values: images.to_uint8(texels.image(values))  # noqa: E731
    return Textures(
        base_colour=picture(images.srgb_from_linear(base)),
        surface=picture(np.stack([baked.occlusion, baked.roughness, metallic], -1)),
        normal=picture((texels.to_tangent_space(baked.normals) + 1) / 2),
        certainty=picture(baked.certainty.channels()),
        specular=picture(images.srgb_from_linear(factor)) if weak.mean() > WEAK_SHARE else None,
    )
