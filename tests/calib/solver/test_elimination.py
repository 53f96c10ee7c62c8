import numpy as np
import pytest

from koala3d.calib.handeye import model, refine
from koala3d.calib.solver.elimination import eliminate

FREE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


def problem(rng, views=5, p=4, counts=(3, 7, 4, 9, 5)):
    """Random rows of views of different length, as `eliminate` takes them."""
    view = np.repeat(np.arange(views), counts)
    rows = rng.normal(size=(len(view), 2, 6 + p + 1))
    own = np.zeros((views, 6, 7))
    own[:, range(6), range(6)], own[..., 6] = 0.5, rng.normal(size=(views, 6))
    known = np.concatenate([np.eye(p)[:1], rng.normal(size=(1, 1))], 1)
    return view, rows, own, known


def dense(view, rows, own, known):
    """(matrix, targets) of the whole problem, written out: global unknowns first."""
    views, p = len(own), rows.shape[-1] - 7
    matrix, targets = [], []
    for i in range(views):
        for row in [*own[i], *rows[view == i].reshape(-1, p + 7)]:
            line = np.zeros(p + 6 * views)
            line[p + 6 * i : p + 6 * i + 6] = row[:6]
            if len(row) > 7:
                line[:p] = row[6:-1]
            matrix.append(line)
            targets.append(row[-1])
    for row in known:
        matrix.append(np.concatenate([row[:-1], np.zeros(6 * views)]))
        targets.append(row[-1])
    return np.array(matrix), np.array(targets)


def test_elimination_equals_the_dense_solution():
    view, rows, own, known = problem(np.random.default_rng(0))
    system = eliminate(view, rows, own, known)
    matrix, targets = dense(view, rows, own, known)
    expected = np.linalg.lstsq(matrix, targets, rcond=None)[0]
    step, own_steps = system.step(0.0)
    np.testing.assert_allclose(np.concatenate([step, own_steps.ravel()]), expected, atol=1e-12)
    covariance = np.linalg.inv(matrix.T @ matrix)
    np.testing.assert_allclose(np.linalg.inv(system.information), covariance[:4, :4], atol=1e-12)
    of_views = system.own_covariances(covariance[:4, :4])
    for i in range(5):
        np.testing.assert_allclose(of_views[i], covariance[4 + 6 * i :, 4 + 6 * i :][:6, :6], atol=1e-12)


def test_views_without_corners_do_no_harm():
    rng = np.random.default_rng(1)
    view, rows, own, known = problem(rng, views=3, counts=(6, 0, 6))
    matrix, targets = dense(view, rows, own, known)
    step, own_steps = eliminate(view, rows, own, known).step(0.0)
    expected = np.linalg.lstsq(matrix, targets, rcond=None)[0]
    np.testing.assert_allclose(np.concatenate([step, own_steps.ravel()]), expected, atol=1e-12)


def test_damping_shortens_the_step():
    system = eliminate(*problem(np.random.default_rng(2)))
    free, damped, stiff = (np.linalg.norm(system.step(d)[0]) for d in (0.0, 1.0, 1e6))
    assert free > damped > stiff and stiff < 1e-5 * free


def test_an_unknown_that_no_row_touches_is_singular():
    view, rows, own, known = problem(np.random.default_rng(3))
    rows[:, :, 8] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        eliminate(view, rows, own, known).step(0.0)


def test_certain_corners_cost_no_digits(small):
    """Corners a million times more certain than the arm: the information on the hand-eye pose is then that of the arm alone."""
    session = small.session(free=())
    sigmas = [refine.Sigmas(pixel, 1e-3, 1e-3) for pixel in (1e-6, 1e-8)]
    found = [refine.linear_system(session, small.state(), chosen).information for chosen in sigmas]
    scale = np.sqrt(np.diag(found[0]))
    # a view seen to 1e-4 px is known to 1e-5 of the arm: at 1e-6 px the corners add 1e-9 to the variance
    np.testing.assert_allclose(found[1] / np.outer(scale, scale), found[0] / np.outer(scale, scale), atol=1e-6)


def test_step_of_the_refinement_solves_the_dense_problem(small):
    session, sigmas = small.session(free=FREE), refine.Sigmas(0.1, 5e-5, 2e-4, refine.HUBER)
    pixels, by_global, by_view = model.predict(session, small.state())
    residuals = session.pixels - pixels
    p, views = by_global.shape[-1], len(small.reported)
    rows = np.zeros((len(session.view), 2, p + 6 * views))
    rows[..., :p] = by_global
    for k, i in enumerate(session.view):
        rows[k, :, p + 6 * i : p + 6 * i + 6] = by_view[k]
    prior = np.hstack([np.zeros((6 * views, p)), np.diag(np.tile(1 / sigmas.correction, views))])
    distance = np.linalg.norm(residuals, axis=1) / sigmas.pixel
    weight = np.minimum(1, refine.HUBER / distance)[:, None]
    weighted = np.sqrt(weight) / sigmas.pixel
    matrix = np.vstack([(rows * weighted[..., None]).reshape(-1, p + 6 * views), prior])
    targets = np.concatenate([(residuals * weighted).ravel(), np.zeros(6 * views)])
    scale = np.linalg.norm(matrix, axis=0)
    expected = np.linalg.lstsq(matrix / scale, targets, rcond=None)[0]
    step, own = refine.linear_system(session, small.state(), sigmas).step(0.0)
    np.testing.assert_allclose(np.concatenate([step, own.ravel()]) * scale, expected, atol=1e-8)
