"""Textures of the painted ball against what it is known to be."""

import numpy as np
import pytest
import trimesh

from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.materials import LUMINANCE
from koala3d.reconstruct.asset.texels import Texels, texels_of
from koala3d.reconstruct.output.trained_model import TrainedModel
from tests.reconstruct.conftest import CENTRE, RADIUS

SIZE = 128


@pytest.fixture
def texels(asset: Asset) -> Texels:
    """Of the ball, in the scene's frame."""
    return texels_of(asset.mesh.moved(asset.base_from_asset), SIZE)


def at(picture: np.ndarray, texels: Texels) -> np.ndarray:
    """0..1 at the texels."""
    return picture[texels.rows, texels.columns] / 255


def test_the_asset_stands_on_its_origin_with_y_up(asset: Asset) -> None:
    low, high = asset.mesh.vertices.min(0), asset.mesh.vertices.max(0)
    assert abs(low[1]) < 1e-9  # the lowest vertex is the origin's height by definition
    assert np.allclose((low + high)[[0, 2]], 0, atol=1e-9)
    world = asset.mesh.vertices @ asset.base_from_asset[:3, :3].T + asset.base_from_asset[:3, 3]
    assert np.allclose(np.linalg.norm(world - CENTRE, axis=-1), RADIUS, atol=1e-7)  # xatlas works on single precision
    assert np.allclose(asset.base_from_asset[:3, :3] @ [0, 1, 0], [0, 0, 1]) and np.linalg.det(asset.base_from_asset) > 0


def test_texels_lie_on_the_surface_with_axes_along_the_texture(texels: Texels, asset: Asset) -> None:
    assert len(texels.points) > 0.3 * SIZE**2  # charts of a sphere fill at least a third
    away = np.linalg.norm(texels.points - CENTRE, axis=-1)
    assert np.all(away < RADIUS + 1e-7) and np.all(away > 0.98 * RADIUS)  # a triangle's middle is 1 % nearer to the centre
    at_place = {place: index for index, place in enumerate(zip(texels.rows.tolist(), texels.columns.tolist(), strict=True))}
    pairs = [(i, at_place[r, c + 1]) for (r, c), i in at_place.items() if (r, c + 1) in at_place]
    step = np.array([texels.points[j] - texels.points[i] for i, j in pairs])
    along = np.sum(step * texels.tangents[[i for i, _ in pairs]], -1)
    near = np.linalg.norm(step, axis=-1) < 2 * np.median(np.linalg.norm(step, axis=-1))  # in one chart
    assert np.mean(along[near] > 0) > 0.99  # one column on is one step along growing u
    pairs = [(i, at_place[r - 1, c]) for (r, c), i in at_place.items() if (r - 1, c) in at_place]
    step = np.array([texels.points[j] - texels.points[i] for i, j in pairs])
    near = np.linalg.norm(step, axis=-1) < 2 * np.median(np.linalg.norm(step, axis=-1))
    assert np.mean((np.sum(step * texels.bitangents[[i for i, _ in pairs]], -1) > 0)[near]) > 0.99  # v grows upwards


def test_certainty_counts_the_views_that_see_a_texel(asset: Asset, texels: Texels, ball_scene: tuple[Scene, object]) -> None:
    views = ball_scene[0].split("train")
    outward = (texels.points - CENTRE) / np.linalg.norm(texels.points - CENTRE, axis=-1, keepdims=True)
    cosines = []
    for view in views:
        towards = view.world_from_camera[:3, 3] - texels.points
        cosines.append(np.sum(outward * towards, -1) / np.linalg.norm(towards, axis=-1))
    cosines = np.array(cosines)
    found = at(asset.textures.certainty, texels)
    counts = np.rint(found[:, 0] * 255)
    # Pictures of 48 pixels have a depth map of 4 mm: whether they see a texel at a flat angle is not decided there.
    between = (counts >= (cosines > 0.5).sum(0)) & (counts <= (cosines > 0.05).sum(0))
    assert between.mean() > 0.99
    seen = (counts > 0) & (cosines > 0.5).any(0)
    assert np.abs(found[seen, 1] - cosines.max(0)[seen]).max() < 0.06  # 3 degrees of normal
    assert (counts == 0).any() and not found[counts == 0].any()


def test_luminance_of_the_albedo_is_that_of_the_paint(asset: Asset, texels: Texels, painted: TrainedModel) -> None:
    seen = at(asset.textures.certainty, texels)[:, 0] > 0
    normalisation = painted.run.normalisation
    points = CENTRE + (texels.points - CENTRE) / np.linalg.norm(texels.points - CENTRE, axis=-1, keepdims=True) * RADIUS
    points = ((points - normalisation.centre) * normalisation.scale)[seen].T
    waves = 0.3 + 0.15 * np.sin(np.array([[9.0], [11.0], [13.0]]) * points) + 0.1 * np.cos(7 * points[::-1])
    base = images.linear_from_srgb(at(asset.textures.base_colour, texels))[seen]
    metallic = at(asset.textures.surface, texels)[seen, 2:]
    # Matte and mirrored light of different hues share the one base colour: luminance is what they are told apart by.
    albedo, paint = (base * (1 - metallic)) @ LUMINANCE, LUMINANCE @ waves
    # The ball's mirrored light does not grow at flat views as Schlick's does: the light that explains it is uneven by a quarter.
    ratio = albedo / paint
    assert np.std(ratio) < 0.25 * np.mean(ratio), ratio
    assert np.corrcoef(albedo, paint)[0, 1] > 0.8  # a texture laid out wrongly has none


def test_a_ball_hides_nothing_of_the_sky_and_is_as_round_as_its_normals_say(asset: Asset, texels: Texels) -> None:
    assert at(asset.textures.surface, texels)[:, 0].min() > 0.9  # of 192 directions those at the horizon may be missed
    normal = at(asset.textures.normal, texels) * 2 - 1
    world = normal[:, :1] * texels.tangents + normal[:, 1:2] * texels.bitangents + normal[:, 2:] * texels.normals
    outward = (texels.points - CENTRE) / np.linalg.norm(texels.points - CENTRE, axis=-1, keepdims=True)
    seen = at(asset.textures.certainty, texels)[:, 0] > 0
    assert np.sum(world * outward, -1)[seen].min() > np.cos(np.deg2rad(1.5))  # a step of 8 bits is 0.45 degrees in each axis


def test_the_surface_is_closed_in_the_texture(asset: Asset) -> None:
    whole = trimesh.Trimesh(asset.mesh.vertices, asset.mesh.faces, process=False)
    whole.merge_vertices(merge_tex=True, merge_norm=True)
    assert whole.is_watertight and whole.volume > 0
