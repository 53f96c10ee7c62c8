import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.structure.epipolar import Pairs, corrected

MATRICES = np.stack(
    [pose.look_at((4 * np.cos(a), 4 * np.sin(a), 1.5 * (k % 2)), (0, 0, 0)) for k, a in enumerate((0.0, 0.3, 0.6))]
)
PIXEL = 1 / 500


def seen(noise_px: float = 0.0, wrong: int = 0) -> Pairs:
    """Matches of 300 points between three cameras, the first `wrong` of each pair between different points."""
    random = np.random.default_rng(0)
    points = random.uniform(-1, 1, (300, 3))
    rays = []
    for matrix in MATRICES:
        local = (points - matrix[:3, 3]) @ matrix[:3, :3]
        flat = local / local[:, 2:]
        flat[:, :2] += random.normal(0, noise_px * PIXEL, (300, 2))
        rays.append(flat)
    first, second, a, b = [], [], [], []
    for i, j in ((0, 1), (1, 2), (0, 2)):
        order = np.concatenate([np.roll(np.arange(wrong), 7), np.arange(wrong, 300)])
        first += [i] * 300
        second += [j] * 300
        a.append(rays[i])
        b.append(rays[j][order])
    return Pairs(np.array(first), np.array(second), np.concatenate(a), np.concatenate(b), np.full(900, PIXEL))


def test_exact_matches_lie_on_their_lines() -> None:
    assert np.abs(seen().distances(MATRICES)).max() < 1e-9  # float64 algebra, in pixels of 1/500


def test_a_distance_is_in_pixels() -> None:
    """Noise of one pixel across the lines of both pictures adds up to the root of two."""
    assert seen(1.0).distances(MATRICES).std() == pytest.approx(np.sqrt(2), rel=0.1)  # 900 distances: 2 %, and lines differ
    assert seen(2.0).distances(MATRICES).std() / seen(1.0).distances(MATRICES).std() == pytest.approx(2, rel=0.05)


def test_a_pose_is_corrected_among_wrong_matches() -> None:
    pairs, change = seen(0.2, wrong=60).of_view(1), pose.from_rotation_vector((0.004, -0.008, 0.002))
    assert len(pairs.first) == 600
    off = MATRICES.copy()
    off[1] = off[1] @ change

    def distances(some: np.ndarray) -> np.ndarray:
        turned = off.copy()
        turned[1] = off[1] @ pose.from_rotation_vector(some[:3], some[3:])
        return pairs.distances(turned)

    fit = corrected(distances, [PIXEL] * 3 + [4 * PIXEL] * 3)
    assert fit.after_px < 0.3 and fit.before_px > 4 * fit.after_px and fit.inliers > 400
    assert np.rad2deg(pose.rotation_angle(change @ pose.from_rotation_vector(fit.change[:3]))) < 0.1  # it was 0.5


def test_nothing_is_corrected_where_nothing_is_wrong() -> None:
    pairs = seen(0.3)
    fit = corrected(lambda some: pairs.distances(MATRICES) + 0 * some.sum(), [PIXEL])
    assert abs(fit.change[0]) < 1e-12 and fit.after_px == fit.before_px
