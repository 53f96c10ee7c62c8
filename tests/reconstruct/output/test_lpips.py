import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import correlate

from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError
from koala3d.reconstruct.experiments import tables
from koala3d.reconstruct.experiments.results import results_of, rows_of
from koala3d.reconstruct.output import evaluate
from koala3d.reconstruct.output.lpips import LAYERS, SMALLEST, WEIGHTS, Lpips
from koala3d.reconstruct.output.trained_model import TrainedModel

PUBLISHED = {(47, 40): 0.3724093, (31, 33): 0.3338005}
"""What lpips 0.1.4 on torch 2.15 gave in float32 for the weights and pictures of this file, by the pictures' height and width."""


@pytest.fixture(scope="module")
def random_weights() -> dict[str, np.ndarray]:
    """Kernels of the size that keeps a signal's size, biases, and shares from 0 to 1."""
    rng = np.random.default_rng(0)
    weights = {}
    for name, shape in WEIGHTS.items():
        drawn = rng.standard_normal(shape)
        if name.startswith("lin"):
            weights[name] = np.abs(drawn)
        else:
            weights[name] = drawn * (2 / np.prod(shape[1:])) ** 0.5 if len(shape) == 4 else 0.1 * drawn
    return {name: array.astype(np.float32) for name, array in weights.items()}


@pytest.fixture(scope="module")
def weights_file(random_weights: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lpips") / "alex.npz"
    np.savez(path, **random_weights, **{"scaling_layer.shift": np.zeros((1, 3, 1, 1), np.float32)})
    return path


@pytest.fixture(scope="module")
def lpips(weights_file: Path) -> Lpips:
    return Lpips.load(weights_file)


def pictures(height: int, width: int) -> np.ndarray:
    """Two of them: noise, and the same with something else in a corner."""
    first = np.random.default_rng(1).random((height, width, 3))
    second = first.copy()
    second[: height // 2, : width // 2] = np.random.default_rng(2).random((height // 2, width // 2, 3))
    return np.stack([first, second]).astype(np.float32)


def reference(weights: dict[str, np.ndarray], first: np.ndarray, second: np.ndarray) -> float:
    """The distance in float64, layer after layer, by correlations and loops."""
    shift, scale = np.array([-0.030, -0.088, -0.188]), np.array([0.458, 0.448, 0.450])
    maps = [(((2 * picture.astype(np.float64) - 1) - shift) / scale).transpose(2, 0, 1) for picture in (first, second)]
    total = 0.0
    for index, layer in enumerate(LAYERS):
        kernel, bias = (weights[f"{layer.name}.{part}"].astype(np.float64) for part in ("weight", "bias"))
        for each in range(2):
            around = maps[each]
            if layer.pooled:
                rows, columns = ((side - 3) // 2 + 1 for side in around.shape[1:])
                around = np.stack([[around[:, 2 * i : 2 * i + 3, 2 * j : 2 * j + 3].max((1, 2)) for j in range(columns)]
                                   for i in range(rows)]).transpose(2, 0, 1)  # fmt: skip
            around = np.pad(around, ((0, 0), (layer.padding,) * 2, (layer.padding,) * 2))
            sums = np.stack(
                [correlate(around, one, "valid", method="direct")[0, :: layer.stride, :: layer.stride] for one in kernel]
            )
            maps[each] = np.maximum(sums + bias[:, None, None], 0)
        unit = [features / np.maximum(np.linalg.norm(features, axis=0), 1e-10) for features in maps]
        share = weights[f"lin{index}.model.1.weight"].reshape(-1, 1, 1)
        total += (share * (unit[0] - unit[1]) ** 2).sum(0).mean()
    return float(total)


@pytest.mark.parametrize("size", PUBLISHED)
def test_it_is_the_distance_written_out(lpips: Lpips, random_weights: dict[str, np.ndarray], size: tuple[int, int]) -> None:
    """Sums of up to 3456 products in float32, five of them one after the other: 1e-5."""
    first, second = pictures(*size)
    assert lpips(first, second) == pytest.approx(reference(random_weights, first, second), rel=1e-5)


@pytest.mark.parametrize("size", PUBLISHED)
def test_it_is_that_of_the_published_program(lpips: Lpips, size: tuple[int, int]) -> None:
    """Both sum in float32, in another order: 2e-6."""
    assert lpips(*pictures(*size)) == pytest.approx(PUBLISHED[size], rel=2e-6)


def test_it_is_a_distance(lpips: Lpips) -> None:
    first, second = pictures(47, 40)
    assert lpips(first, first) == 0
    assert lpips(first, second) == pytest.approx(lpips(second, first), rel=1e-6)
    near = (0.9 * first + 0.1 * second).astype(np.float32)
    assert 0 < lpips(first, near) < lpips(first, second)
    assert lpips(np.where(first > 0.5, 7.0, -7.0), (first > 0.5).astype(np.float32)) == 0, "pictures are clipped first"


def test_black_pictures_have_a_distance(lpips: Lpips) -> None:
    """Features of no length are divided by next to nothing, not by zero."""
    dark = np.zeros((47, 40, 3), np.float32)
    assert np.isfinite(lpips(dark, 1 - dark)) and lpips(dark, dark) == 0


def test_what_cannot_be_compared_is_told(lpips: Lpips) -> None:
    first, second = pictures(SMALLEST, 33)
    assert lpips(first, second) is not None
    assert lpips(first[1:], second[1:]) is None, "the last layer would have no pixel"
    for other in (first[1:], first[..., :1], first[..., 0]):
        with pytest.raises(UsageError, match="two colour images of the same size"):
            lpips(first, other)


@pytest.mark.parametrize(("change", "message"), [
    ({"net.slice3.6.bias": None}, r"does not hold the weights of LPIPS with AlexNet \(no array net.slice3.6.bias\)"),
    ({"net.slice1.0.weight": np.zeros((64, 3, 3, 3), np.float32)}, r"another shape .*\(64, 3, 3, 3\).*not \(64, 3, 11, 11\)"),
    ({"net.slice1.0.bias": np.zeros(64, int)}, r"another shape than AlexNet's.*int64"),
    ({"net.slice1.0.bias": np.full(64, np.nan)}, "values that are not finite"),
    ({"lin2.model.1.weight": -np.ones((1, 384, 1, 1))}, "weighs differences with negative numbers"),
    ({"net.slice1.0.bias": np.array([{}] * 64)}, "holds Python objects"),
])  # fmt: skip
def test_other_weights_are_refused(random_weights: dict, tmp_path: Path, change: dict, message: str) -> None:
    weights = {name: array for name, array in (random_weights | change).items() if array is not None}
    np.savez(tmp_path / "w.npz", **weights)
    with pytest.raises(KoalaError, match=message):
        Lpips.load(tmp_path / "w.npz")


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "alex.pth").write_bytes(b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.")
    with pytest.raises(DatasetError, match="not a file of plain arrays"):
        Lpips.load(tmp_path / "alex.pth")
    with pytest.raises(UsageError, match="no such file"):
        Lpips.load(tmp_path / "none.npz")


def test_a_run_is_measured_with_it(ball: TrainedModel, weights_file: Path, lpips: Lpips, without_mesh: None) -> None:
    """Stored with its definition and the weights that it depends on, and shown in tables."""
    result = evaluate.evaluate(ball, lpips=lpips)
    written = json.loads((ball.run.path / "metrics.json").read_text())
    view = ball.scene.split("test")[0]
    expected = lpips(ball.picture(view).rgb, evaluate.read_truth(view, view.camera)["rgb"])
    assert written["per_view"][0]["lpips"] == pytest.approx(expected, rel=1e-6)
    assert written["mean"]["lpips"] == pytest.approx(np.mean([each["lpips"] for each in written["per_view"]]))
    assert "AlexNet, version 0.1" in written["definitions"]["lpips"]
    assert written["lpips_weights"] == {"file": weights_file.name, "sha256": lpips.sha256} and len(lpips.sha256) == 64
    assert "LPIPS" in evaluate.table(result)
    rows = rows_of(results_of([ball.run.path]))
    assert "LPIPS" in tables.markdown(rows, tables.chosen_columns(rows))
