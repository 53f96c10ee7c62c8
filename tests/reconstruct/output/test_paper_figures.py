import numpy as np
import pytest

from koala3d.reconstruct.output import paper_figures
from koala3d.reconstruct.output.trained_model import TrainedModel

RADIUS, DIFFUSE, SPECULAR = 0.08, [0.1, 0.2, 0.3], [0.2, 0.1, 0.05]
"""Of the ball in `conftest`: [m], and linear light."""


def test_shells_hold_as_many_samples_per_volume_as_counted() -> None:
    """One sample in the ball of radius 1/2, two in the shell around it."""
    shells, densities = paper_figures.shell_density(np.array([0.5, 1.0, 1.0]))
    ball = 4 / 3 * np.pi
    np.testing.assert_allclose(shells, [0.5, 1])
    np.testing.assert_allclose(densities, [1 / (ball / 8), 2 / (ball * 7 / 8)])


def test_angles_of_the_axes() -> None:
    azimuth, elevation = paper_figures.angles_of(np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]]))
    np.testing.assert_allclose(azimuth[:2], [0, 90])
    np.testing.assert_allclose(elevation, [0, 0, -90])


def test_the_sphere_and_the_graph_show_every_sample() -> None:
    assert [len(axes.collections) for axes in paper_figures.draw_sphere(32).axes] == [1, 1, 1, 0]
    figure = paper_figures.draw_graph(np.array([0.0, 0.6, 0.8]), 32, 3)
    above, below = figure.axes[0].collections
    offsets = np.concatenate([above.get_offsets(), below.get_offsets()])
    assert len(offsets) == 32 and (offsets[:, 1] >= 0).all(), "all directions are in the visible hemisphere"
    assert len(figure.axes[1].lines) == 32 * 3


def test_a_ball_s_points_lie_on_it_and_send_what_the_field_sends(ball: TrainedModel) -> None:
    points = paper_figures.surface_points(ball)
    scale = ball.run.normalisation.scale
    for position, normal in points:
        assert np.linalg.norm(position) == pytest.approx(RADIUS * scale, abs=0.02)
        assert normal @ position / np.linalg.norm(position) > 0.99
    seen = paper_figures.hemisphere_colours(ball, *points[0])
    assert (seen["outward"] @ points[0][1] > 0).all() and len(seen["outward"]) > 900
    np.testing.assert_allclose(seen["diffuse"], DIFFUSE, rtol=1e-5)
    np.testing.assert_allclose(seen["specular"], np.broadcast_to(SPECULAR, seen["specular"].shape), rtol=1e-5)
    assert len(paper_figures.draw_bias(ball).axes) == 5 * len(points)


def test_weights_are_drawn_with_their_first_surface() -> None:
    weights = np.array([[0.1, 0.1, 0.1, 0.1], [0.0, 0.0, 0.9, 0.05]])
    figure = paper_figures.draw_weights([1, 2], np.arange(4.0), weights, np.array([0, 2]))
    assert len(figure.axes) == 2 and figure.axes[1].lines[1].get_xdata()[0] == 2.0
