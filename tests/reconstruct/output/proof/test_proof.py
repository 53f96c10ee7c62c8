"""The painted ball's asset beside its photographs: what is read, what is measured, and where it is written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.core.mitsuba_variant import SURE
from koala3d.datasets.imaging import images
from koala3d.reconstruct.asset import asset as assets
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.light import Light
from koala3d.reconstruct.asset.writing import environment, glb
from koala3d.reconstruct.output.evaluate import FORMAT, METRICS, VERSION
from koala3d.reconstruct.output.proof import proof
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.path_tracing import reading
from tests.reconstruct.conftest import CENTRE, RADIUS

_made: list[tuple[Asset, Light]] = []


@pytest.fixture
def written(ball: TrainedModel, tmp_path: Path) -> tuple[TrainedModel, Path, Path]:
    """The ball of one colour, its asset and its light."""
    pytest.importorskip("xatlas", reason="xatlas is absent: pip install 'koala-capture[asset]'")
    if not _made:
        surface = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
        surface.apply_translation(CENTRE)
        _made.append(assets.bake(ball, surface, size=64))
    asset, light = _made[0]
    glb.save(asset, tmp_path / "ball.glb")
    environment.save(light, asset.base_from_asset, tmp_path / "light.exr", height=64)
    return ball, tmp_path / "ball.glb", tmp_path / "light.exr"


def test_what_is_read_is_what_was_written(written: tuple[TrainedModel, Path, Path]) -> None:
    read, asset = reading.read(written[1]), _made[0][0]
    assert np.allclose(read.vertices[read.faces], asset.mesh.vertices[asset.mesh.faces], atol=1e-6)  # single precision
    assert np.allclose(read.normals[read.faces], asset.mesh.normals[asset.mesh.faces], atol=1e-3)
    assert np.allclose(read.uv[read.faces], (asset.mesh.uv * [1, -1] + [0, 1])[asset.mesh.faces], atol=1e-6)
    assert np.allclose(read.base_from_asset, asset.base_from_asset)
    assert np.allclose(images.srgb_from_linear(read.base_colour) * 255, asset.textures.base_colour, atol=1e-2)
    assert np.allclose(np.concatenate([read.roughness, read.metallic], -1) * 255, asset.textures.surface[..., 1:], atol=1e-4)
    assert (read.specular is None) == (asset.textures.specular is None)


def test_files_that_are_no_assets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="there is no such asset"):
        reading.read(tmp_path / "none.glb")
    (tmp_path / "text.glb").write_text("not a GLB at all, only text")
    with pytest.raises(DatasetError, match="not an asset of 'reconstruct asset'"):
        reading.read(tmp_path / "text.glb")
    trimesh.creation.box().export(tmp_path / "box.glb")
    with pytest.raises(DatasetError, match="not an asset of 'reconstruct asset'"):
        reading.read(tmp_path / "box.glb")


def test_figures_are_added_to_the_metrics(written: tuple[TrainedModel, Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("mitsuba", reason="Mitsuba is absent: pip install 'koala-capture[sim]'")
    trained, asset, light = written
    before = {"format": FORMAT, "version": VERSION, "steps": trained.step, "mean": {"psnr": 40.0}, "per_view": []}
    files.write_json(trained.run.path / METRICS, before)
    found = proof.prove(trained, asset, light, paths=16, out=tmp_path / "shown", using=SURE)
    stored = files.read_json(trained.run.path / METRICS)
    assert stored == before | {"asset": stored["asset"]} and stored["asset"]["mean"] == found["mean"]
    assert set(found["mean"]) == set(found["definitions"]) and len(found["per_view"]) == 2
    assert found["mean"]["model_psnr"] > 25  # the model is the truth, but for the edge
    assert found["mean"]["coverage_iou"] > 0.95  # a ring of half a pixel around a disc of 20
    # The ball sends the same light everywhere, which no material under a sky does exactly: a shift of 0.08 in sRGB is 22 dB.
    assert found["mean"]["psnr_inside"] > 22
    views = sorted(path.name for path in (tmp_path / "shown").iterdir())
    assert views == ["000.png", "003.png"] and images.size(tmp_path / "shown/000.png") == (3 * 48, 40)
    assert "asset" in proof.text(found) and "PSNR inside" in proof.text(found)


def test_among_surroundings_only_the_object_is_compared(written: tuple[TrainedModel, Path, Path]) -> None:
    pytest.importorskip("mitsuba", reason="Mitsuba is absent: pip install 'koala-capture[sim]'")
    trained, asset, light = written
    facts = replace(trained.run.facts, normalisation=replace(trained.run.normalisation, bounded=False))
    among = replace(trained, run=replace(trained.run, facts=facts))
    view = trained.scene.split("test")[0]
    shown = proof.shown(among, proof.Stage(reading.read(asset), light, using=SURE), view, paths=4, seed=0)
    assert shown.metrics["psnr"] is None and shown.metrics["model_psnr"] is None
    assert shown.metrics["coverage_iou"] > 0.9 and shown.metrics["psnr_inside"] > 20


def test_without_masks_only_what_the_asset_covers_is_compared(written: tuple[TrainedModel, Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("mitsuba", reason="Mitsuba is absent: pip install 'koala-capture[sim]'")
    trained, asset, light = written
    view = trained.scene.split("test")[0]
    images.write(tmp_path / "opaque.png", images.read(view.image)[..., :3])
    bare = replace(view, image=tmp_path / "opaque.png", truth={})
    shown = proof.shown(trained, proof.Stage(reading.read(asset), light, using=SURE), bare, paths=4, seed=0)
    assert shown.metrics["psnr"] is None and shown.metrics["coverage_iou"] is None and shown.metrics["psnr_inside"] > 20
