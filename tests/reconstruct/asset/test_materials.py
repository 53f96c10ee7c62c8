"""The parameters of glTF against the colours that they are made from."""

import numpy as np
import pytest

from koala3d.reconstruct.asset.materials import metallic_roughness


@pytest.mark.parametrize(
    ("base", "metallic"),
    [([0.5, 0.2, 0.1], 0.0), ([0.9, 0.7, 0.3], 1.0), ([0.9, 0.7, 0.3], 0.5), ([0.02, 0.02, 0.02], 0.0)],
)
def test_materials_that_gltf_describes_are_found_again(base: list[float], metallic: float) -> None:
    colour = np.array([base])
    albedo, reflectance = colour * (1 - metallic), 0.04 * (1 - metallic) + colour * metallic
    found, share, factor = metallic_roughness(albedo, reflectance)
    assert np.allclose(found, colour, atol=1e-9) and np.allclose(share, metallic, atol=1e-9)  # solved in closed form
    assert np.allclose(factor, 1, atol=1e-9)


def test_what_mirrors_less_than_glass_is_a_factor_of_the_extension() -> None:
    base, metallic, factor = metallic_roughness(np.array([[0.5, 0.2, 0.1]]), np.array([[0.01, 0.02, 0.03]]))
    assert np.allclose(base, [0.5, 0.2, 0.1]) and metallic == 0 and np.allclose(factor, [[0.25, 0.5, 0.75]])
