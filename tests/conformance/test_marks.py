"""Boxes that another simulator marks, as regions in which its own check finds an object as well."""

import importlib

import numpy as np
import pytest

from tests.served_kit import KIT

UP = np.array((0.0, 0.0, 1.0))


@pytest.fixture
def objects(monkeypatch):
    monkeypatch.syspath_prepend(str(KIT))
    return importlib.import_module("target_server.mujoco_objects")


def floor_at(objects, top_m):
    half_m = np.array((0.1, 0.1, 0.005))
    return objects.Solid("box", half_m, np.array((0.0, 0.0, top_m - 0.005)), np.eye(3), half_m)


def mark(objects, top_m, half_height_m):
    half_m = np.array((0.05, 0.05, half_height_m))
    return objects.make_mark("a", np.zeros(3), np.eye(3), half_m, UP, [floor_at(objects, top_m)])


def bounds(found):
    return [round(float(found.center_m[2] + sign * found.half_m[2]), 6) for sign in (-1.0, 1.0)]


def test_a_room_ends_on_what_carries_objects_in_it_but_never_below_its_mark(objects):
    """A book on the floor of a compartment, 11 mm below its mark, was inside for us and not for the scorer."""
    assert bounds(mark(objects, -0.05, 0.06)) == [-0.05, 0.06]
    assert bounds(mark(objects, -0.071, 0.06)) == [-0.06, 0.06]


def test_the_room_above_a_surface_ends_where_that_above_its_mark_does(objects):
    assert bounds(mark(objects, 0.02, 0.005)) == [0.02, 0.105]
    assert bounds(mark(objects, -0.02, 0.005)) == [-0.02, 0.08]


@pytest.mark.parametrize("turn_deg", [0, 90, 180, 5, 30, -20])
@pytest.mark.parametrize("tilt_deg", [0, 4, -20])
def test_a_turned_room_is_no_larger_than_a_check_along_the_axes_of_the_world_finds_it(objects, turn_deg, tilt_deg):
    half_m = np.array((0.06, 0.05, 0.07))
    (c, s), (k, t) = ((np.cos(each), np.sin(each)) for each in np.radians((turn_deg, tilt_deg)))
    R = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))) @ np.array(((k, 0.0, t), (0.0, 1.0, 0.0), (-t, 0.0, k)))

    narrow_m = objects.narrow_turned(half_m, R)

    assert np.all(np.abs(R) @ narrow_m <= np.abs(R @ half_m) + 1e-9)
    assert np.all(narrow_m >= 0.0)
    assert np.all(narrow_m > 0.005) or abs(tilt_deg) == 20, "something is left where it stands nearly upright"
    if turn_deg % 90 == 0 and tilt_deg == 0:
        assert narrow_m == pytest.approx(half_m)
