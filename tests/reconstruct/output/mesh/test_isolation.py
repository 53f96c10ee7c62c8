"""Grids of densities with an object and what reaches in from outside: 1 where there is matter, 0 elsewhere."""

import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.reconstruct.output.mesh.isolation import SIDES, fill_interior, isolate_object

SIZE = 60
X, Y, Z = np.meshgrid(*3 * [np.arange(SIZE)], indexing="ij")


def ball() -> NDArray[np.bool_]:
    """A ball in the middle that stands on the bottom by a leg, four cells thick."""
    leg = (np.abs(X - 30) < 2) & (np.abs(Y - 30) < 2) & (Z < 30)
    return ((X - 30) ** 2 + (Y - 30) ** 2 + (Z - 30) ** 2 < 15**2) | leg


def sheet() -> NDArray[np.bool_]:
    """A sheet in a corner of the bottom, six cells thick."""
    return (X < 20) & (Y < 20) & (Z < 6)


def bridge() -> NDArray[np.bool_]:
    """From the sheet to the ball's leg, two cells thick."""
    return (np.abs(X - Y) < 2) & (X >= 15) & (X < 30) & (Z < 2)


def density(*parts: NDArray[np.bool_]) -> NDArray[np.float32]:
    return np.any(parts, axis=0).astype(np.float32)


def kept(*parts: NDArray[np.bool_], stands_on: str = "-z") -> NDArray[np.bool_]:
    return isolate_object(density(*parts), 0.5, stands_on) > 0.5


def test_a_sheet_on_a_bridge_goes_and_the_object_stays_as_it_is() -> None:
    left = kept(ball(), sheet(), bridge())
    assert left[ball()].all(), "the thin leg leads to the side it stands on"
    assert not left[sheet() & ~bridge()].any()
    assert left[bridge()].sum() < bridge().sum()


def test_what_hangs_on_to_nothing_goes_too() -> None:
    np.testing.assert_array_equal(kept(ball(), sheet()), ball())


def test_another_side_may_be_the_one_it_stands_on() -> None:
    upside_down = [part[:, :, ::-1] for part in (ball(), sheet(), bridge())]
    assert kept(*upside_down, stands_on="+z")[upside_down[0]].all()
    assert not kept(*upside_down, stands_on="+z")[upside_down[1] & ~upside_down[2]].any()


@pytest.mark.parametrize("parts", [(ball(),), (ball(), (np.abs(X - 30) < 20) & (np.abs(Y - 30) < 20) & (Z < 2))])
def test_where_no_other_side_is_reached_nothing_changes(parts: tuple[NDArray[np.bool_], ...]) -> None:
    given = density(*parts)
    assert isolate_object(given, 0.5, "-z") is given


@pytest.mark.parametrize("side", SIDES)
def test_the_tables_top_goes_and_what_stands_on_it_stays(side: str) -> None:
    """The grid is so fine that two cells may be table; a plate of four is an object."""
    shape = (40, 40, 256)
    x, y, z = np.meshgrid(*map(np.arange, shape), indexing="ij")
    post = ((x - 20) ** 2 + (y - 20) ** 2 < 8**2) & (z < 100)
    beside = (x > 2) & (x < 37) & (y > 2) & (y < 37)  # and no other side is reached

    def turned(*parts: NDArray[np.bool_]) -> NDArray[np.float32]:
        upright = density(*parts)
        return np.moveaxis(upright if side[0] == "-" else upright[:, :, ::-1], 2, "xyz".index(side[1]))

    np.testing.assert_array_equal(isolate_object(turned(post, beside & (z < 2)), 0.5, side), turned(post))
    plate = turned(post, beside & (z < 4))
    assert isolate_object(plate, 0.5, side) is plate
    flat = turned(beside & (z < 2))
    assert isolate_object(flat, 0.5, side) is flat, "there is no telling what is table where nothing stands on it"


def test_an_object_that_the_box_cuts_through_stays_whole() -> None:
    given = density(np.roll(ball(), 25, axis=0) & (X > 25))
    assert isolate_object(given, 0.5, "-z") is given


def test_a_slab_that_is_thicker_than_the_object_goes() -> None:
    """The deepest place is in the slab then: the object's core is the deepest apart from it."""
    small = (X - 30) ** 2 + (Y - 30) ** 2 + (Z - 40) ** 2 < 8**2
    np.testing.assert_array_equal(kept(small, Z < 20, stands_on="+z"), small)


def test_a_hollow_object_is_one_with_its_inside() -> None:
    hollow = ball() & ~((X - 30) ** 2 + (Y - 30) ** 2 + (Z - 30) ** 2 < 12**2)
    left = kept(hollow, sheet(), bridge())
    assert left[hollow].all() and not left[30, 30, 35]


def test_filling_closes_what_surface_and_sides_shut_in() -> None:
    shell = ((X - 30) ** 2 + (Y - 30) ** 2 + Z**2 < 15**2) & ~((X - 30) ** 2 + (Y - 30) ** 2 + Z**2 < 12**2)
    solid = fill_interior(density(shell), 0.5) > 0.5
    np.testing.assert_array_equal(solid, (X - 30) ** 2 + (Y - 30) ** 2 + Z**2 < 15**2)


def test_there_are_six_sides() -> None:
    assert SIDES == ("-x", "+x", "-y", "+y", "-z", "+z")
