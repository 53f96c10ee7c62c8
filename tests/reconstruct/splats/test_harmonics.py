"""Spherical harmonics against their definition, and fits of functions that they can and cannot follow."""

import math

import numpy as np
from scipy.special import lpmv

from koala3d.datasets.pose import directions
from koala3d.reconstruct.splats import harmonics

SINGLE = 1e-5  # normal equations in single precision


def defined(towards: np.ndarray) -> np.ndarray:
    """(n, 16) real functions with the Condon-Shortley phase, from associated Legendre functions, which have it in SciPy."""
    angle, columns = np.arctan2(towards[:, 1], towards[:, 0]), []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            k = abs(order)
            scale = math.sqrt((2 * degree + 1) / (4 * np.pi) * math.factorial(degree - k) / math.factorial(degree + k))
            turned = np.sin(k * angle) if order < 0 else np.cos(k * angle)
            columns.append((math.sqrt(2) if k else 1) * scale * lpmv(k, degree, towards[:, 2]) * turned)
    return np.stack(columns, -1)


def test_the_functions_are_those_of_their_definition() -> None:
    towards = directions(50)
    assert np.abs(harmonics.basis(towards) - defined(towards)).max() < 1e-12
    assert harmonics.degrees().tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3]


def test_a_function_that_they_can_follow_is_found_from_half_a_sphere() -> None:
    wanted = np.random.default_rng(0).uniform(-0.1, 0.1, (2, 16, 3))
    towards = directions(600)
    towards = np.stack([towards[towards[:, 2] > 0][:250]] * 2)
    colours = np.stack([harmonics.basis(t) @ w + 0.5 for t, w in zip(towards, wanted, strict=True)])
    found = harmonics.solved(*harmonics.sums(towards, colours, np.ones((2, 250))), stiffness=0)
    assert np.abs(found - wanted).max() < 1e-2  # half a sphere tells some of them badly apart
    shown = harmonics.colour(found, towards[:, 7])
    assert np.abs(shown - colours[:, 7]).max() < SINGLE


def test_without_weight_a_colour_counts_for_nothing() -> None:
    towards = directions(64)[None]
    colours = np.full((1, 64, 3), 0.25)
    colours[:, ::2] = 1.0
    weights = np.ones((1, 64))
    weights[:, ::2] = 0
    found = harmonics.solved(*harmonics.sums(towards, colours, weights), stiffness=1e-5)
    assert np.abs(harmonics.colour(found, towards[:, 0]) - 0.25).max() < 1e-3


def test_where_nothing_was_seen_the_colour_bends_little() -> None:
    """One narrow look: the whole sphere gets its colour, however it changes inside."""
    near = directions(4000)
    near = near[near[:, 2] > 0.97]
    colours = np.clip(0.5 + 4 * near[:, :1] + np.zeros(3), 0, 1)[None]
    looks = near[None], colours, np.ones((1, len(near)))
    far = np.array([[0, 0, -1.0]])
    stiff = harmonics.solved(*harmonics.sums(*looks), stiffness=1e-3)
    loose = harmonics.solved(*harmonics.sums(*looks), stiffness=0)
    assert np.abs(harmonics.basis(far) @ stiff[0]).max() < 0.5 < np.abs(harmonics.basis(far) @ loose[0]).max()
