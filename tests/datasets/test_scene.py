from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import find, load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene


def test_a_mask_becomes_the_alpha(make_scene: Callable[..., Scene]) -> None:
    view = make_scene(mask=True).views[0]
    picture = view.read()
    assert picture.shape == (72, 96, 4) and set(np.unique(picture[..., 3])) == {0.0, 1.0}
    assert np.array_equal(picture[..., :3], images.read(view.image)) and view.read_image().shape[-1] == 3


@pytest.mark.parametrize(
    "stored",
    [
        lambda disc: disc * 255,
        lambda disc: disc * 1,
        lambda disc: np.stack([disc * 255, disc * 0, disc * 0], -1),
        lambda disc: np.stack([disc * 0 + 200, disc * 255], -1),
        lambda disc: np.stack([disc * 0 + 90] * 3 + [disc * 255], -1),
        lambda disc: np.stack([disc * 255] * 3 + [disc * 0 + 255], -1),
        lambda disc: np.repeat(np.repeat(disc * 255, 2, 0), 2, 1),
    ],
    ids=["grey", "labels", "red", "grey and alpha", "cut out", "opaque", "twice the size"],
)
def test_masks_of_all_kinds_read_alike(make_scene: Callable[..., Scene], stored: Callable[[np.ndarray], np.ndarray]) -> None:
    view = make_scene(mask=True).views[0]
    disc = (view.read_mask()[..., 0] > 0).astype(np.uint8)
    assert view.mask is not None and 0.1 < disc.mean() < 0.9
    images.write(view.mask, stored(disc).astype(np.uint8))
    assert np.array_equal(view.read_mask()[..., 0], disc) and np.array_equal(view.read()[..., 3], disc)
    assert np.array_equal(replace(view, mask_inverted=True).read_mask()[..., 0], 1 - disc)
    for changed in (view, replace(view, mask_inverted=True)):  # what training reads
        whole = changed.read()
        assert np.array_equal(images.as_float(changed.read_resized(96, 72))[..., 3], whole[..., 3])
        small = images.resize(np.where(whole[..., 3:] > 0, whole, 0), 48, 36)
        assert np.abs(changed.read_resized(48, 36) - small).max() < 1e-6
        assert np.abs(changed.read_cover(48, 36) - small[..., 3]).max() < 1 / 255
        assert np.array_equal(changed.read_cover(96, 72), whole[..., 3])


def test_small_masks_come_from_alphas_and_lossy_files_too(make_scene: Callable[..., Scene]) -> None:
    view = make_scene(mask=True).views[0]
    assert view.mask is not None
    disc, lossy, cut_out = view.read_mask(), view.mask.with_suffix(".jpg"), view.mask.with_suffix(".cut.png")
    images.write(lossy, np.kron(disc[..., 0], np.ones((8, 8))))
    images.write(cut_out, images.to_uint16(np.concatenate([disc * 0.5] * 3 + [disc], -1)))
    exact = images.resize(disc, 24, 18, srgb=False)[..., 0]
    for same in (replace(view, mask=lossy), replace(view, image=cut_out, mask=None)):
        assert np.abs(same.read_cover(24, 18) - exact).max() < 0.01
    assert (replace(view, mask=None).read_cover(24, 18) == 1).all()
    images.write(view.mask, np.zeros((96, 72), np.uint8))
    with pytest.raises(DatasetError, match="it is 72x96, its camera says 96x72"):
        view.read_cover(24, 18)


def test_masks_of_another_shape_are_refused(make_scene: Callable[..., Scene]) -> None:
    view = make_scene(mask=True).views[0]
    assert view.mask is not None
    images.write(view.mask, np.zeros((96, 72), np.uint8))
    with pytest.raises(DatasetError, match="it is 72x96, its camera says 96x72"):
        view.read_mask()
    with pytest.raises(UsageError, match="view has no mask"):
        replace(view, mask=None).read_mask()


def test_sizes_are_compared(make_scene: Callable[..., Scene]) -> None:
    view = make_scene().views[0]
    images.write(view.truth["depth"], np.zeros((72, 95, 1), np.float32))
    with pytest.raises(DatasetError, match="it is 95x72, its camera says 96x72"):
        view.read_truth("depth")
    with pytest.raises(DatasetError, match="wrong size"):
        replace(view, camera=view.camera.scaled(48, 36)).read()


def test_normals_are_unit_or_nothing(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    """8-bit files hold (n + 1) / 2: (255, 128, 128) is nearly (1, 0, 0), (128, 128, 128) is no surface."""
    view = make_scene().views[0]
    stored = np.full((72, 96, 3), 128, np.uint8)
    stored[:36, :, 0] = 255
    images.write(tmp_path / "n.png", stored)
    normals = replace(view, truth={"normals": tmp_path / "n.png"}).read_truth("normals")
    assert np.abs(normals[:36] - [1, 0, 0]).max() < 0.01 and np.array_equal(normals[36:], np.zeros((36, 96, 3)))
    with pytest.raises(UsageError, match="no truth called 'specular'"):
        view.read_truth("specular")


def test_a_missing_split_names_the_existing_ones(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene()
    assert len(scene.split("test")) == 3
    with pytest.raises(UsageError, match=r"no val views.*it has test, train"):
        scene.split("val")


def test_names_are_looked_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a" / "koala" / "head").mkdir(parents=True)
    (tmp_path / "b" / "koala" / "head").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("KOALA_DATA", str(tmp_path / "b"))
    assert find("koala/head") == tmp_path / "b" / "koala" / "head"
    assert find("koala/head", tmp_path / "a") == tmp_path / "a" / "koala" / "head"
    assert find("a/koala/head") == Path("a/koala/head")
    with pytest.raises(UsageError, match=r"looked in .*none.*, .*b/none"):
        find("none")


def test_unknown_folders_and_formats(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="holds no scene in a known format"):
        load_scene(tmp_path)
    with pytest.raises(UsageError, match="did you mean 'blender'"):
        load_scene(tmp_path, format="blendr")
