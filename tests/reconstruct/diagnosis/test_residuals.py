import cv2
import numpy as np
import pytest

from koala3d.datasets.imaging import images
from koala3d.reconstruct.diagnosis import causes
from koala3d.reconstruct.diagnosis.residuals import Residual, relit, residual


def scenery(seed: int = 0) -> np.ndarray:
    """(80, 100, 3) smooth texture."""
    noise = np.random.default_rng(seed).random((80, 100, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    return np.clip(0.5 + 2.0 * (smooth - 0.5), 0.05, 0.9)


def lit(picture: np.ndarray, gains: tuple[float, ...]) -> np.ndarray:
    return images.srgb_from_linear(images.linear_from_srgb(picture) * np.array(gains, np.float32)).astype(np.float32)


def moved(picture: np.ndarray, right: float, down: float) -> np.ndarray:
    matrix = np.array([[1, 0, right], [0, 1, down]])
    return cv2.warpAffine(picture, matrix, picture.shape[1::-1], borderMode=cv2.BORDER_REFLECT)


def test_gains_shift_and_sharpness_are_measured() -> None:
    picture = scenery()
    same = residual("a", "train", picture, picture)
    assert same.psnr == 100 and np.abs(same.shift_px).max() < 1e-3 and same.sharper == 0
    assert residual("a", "train", lit(picture, (0.7, 0.7, 0.8)), picture).gains == pytest.approx([0.7, 0.7, 0.8], rel=0.03)
    assert residual("a", "train", moved(picture, 1.2, -0.7), picture).shift_px == pytest.approx([1.2, -0.7], abs=0.2)
    assert residual("a", "train", cv2.GaussianBlur(picture, (0, 0), 2.0), picture).sharper < -0.5


def test_black_pictures_have_no_gain() -> None:
    assert np.isnan(residual("a", "train", np.zeros((40, 40, 3), np.float32), scenery()[:40, :40]).gains).all()


def test_what_was_learned_of_a_pictures_light_is_not_found_again() -> None:
    picture = scenery()
    darker = lit(picture, (0.7, 0.7, 0.8))
    alike = residual("a", "train", darker, relit(picture, darker, colours=True))
    assert alike.gains == pytest.approx([1, 1, 1], rel=0.01)
    assert alike.psnr > residual("a", "train", darker, picture).psnr + 10
    even = residual("a", "train", darker, relit(picture, darker, colours=False))
    assert even.gains == pytest.approx(np.array([0.7, 0.7, 0.8]) / (0.7 * 0.7 * 0.8) ** (1 / 3), rel=0.03)
    assert relit(picture, np.zeros_like(picture), colours=True) is picture


def views(**changed: np.ndarray) -> list[Residual]:
    """Twelve renderings with a little noise; some pictures changed."""
    found = []
    for k in range(12):
        picture = scenery(k)
        rendered = picture + np.random.default_rng(k).normal(0, 0.01, picture.shape).astype(np.float32)
        found.append(residual(f"v{k}", "train", changed.get(f"v{k}", picture), rendered.astype(np.float32)))
    return found


def causes_of(found: list) -> set[tuple[str, str]]:
    return {(one.cause, one.where) for one in found}


def test_nothing_stands_out_among_good_views() -> None:
    assert causes.find(views()) == [] and causes.find(views()[:3]) == []


def test_each_cause_is_named_for_its_view() -> None:
    found = causes.find(views(v2=lit(scenery(2), (0.7, 0.7, 0.7)), v9=lit(scenery(9), (1.2, 1.0, 0.85))))
    assert ("exposure", "view v2") in causes_of(found) and ("white balance", "view v9") in causes_of(found)
    assert ("pose", "view v5") in causes_of(causes.find(views(v5=moved(scenery(5), 1.5, 0.5))))
    assert ("blur", "view v7") in causes_of(causes.find(views(v7=cv2.GaussianBlur(scenery(7), (0, 0), 1.5))))


def test_a_region_that_does_not_fit_is_named() -> None:
    picture = scenery(3).copy()
    picture[10:25, 60:80] = (0.9, 0.1, 0.1)
    (found,) = [one for one in causes.find(views(v3=picture)) if one.cause == "motion"]
    assert found.where == "view v3"
