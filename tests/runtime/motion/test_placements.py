"""Where a held object may go: between deep walls, along them, and beside what stands there."""

import msgspec
import numpy as np
import pytest

from phyagentos.geometry import compute_heading, compute_inverse, compute_matrix, compute_pose, to_child
from phyagentos.protocol.world.environment import Interior, Pose, Region, Shape, ShapeKind
from phyagentos.runtime.motion.poses import point_tool_down, tilt_tool
from phyagentos.runtime.motion.requests import Approaches, Destination, FindGrasps, FindPlacements, Payload, World
from tests.runtime.motion.conftest import TABLE, build_box, build_cube, build_fixed, replace_entity

pytestmark = pytest.mark.motion

DOWN = Pose(quaternion_wxyz=(0.0, 1.0, 0.0, 0.0))  # of an object in the hand that stands upright


def deep(depth_m, *more, half_m=0.015, x=0.05, y=0.065, is_open=False):
    """A table, a bin at a yaw, its inner half sides `x` and `y`, its walls `depth_m` high, and a cube."""
    walls = [build_box((s * (x + 0.0025), 0, depth_m / 2), (0.0025, y + 0.005, depth_m / 2)) for s in (-1, 1)]
    walls += [build_box((0, s * (y + 0.0025), depth_m / 2), (x, 0.0025, depth_m / 2)) for s in (-1, 1)]
    floor = build_box((0, 0, 0.0025), (x, y, 0.0025))
    interior = Interior((0, 0, (depth_m + 0.005) / 2), (x, y, (depth_m - 0.005) / 2))
    vessel = build_fixed("bin", (0.5, 0.3, 0), floor, *walls[is_open:], interior=interior)
    turned = Pose((0.5, 0.3, 0.0), (float(np.cos(0.2)), 0.0, 0.0, float(np.sin(0.2))))
    vessel = msgspec.structs.replace(vessel, pose=turned)
    return World((TABLE, vessel, build_cube("cube0", 0.4, -0.2, half=half_m), *more))


@pytest.fixture
def ask(planner, home):
    """The answer to a request for places of the cube of a world in its bin."""

    def ask(world, width_m, tcp_T_entity=DOWN, **changes):
        held = Payload("cube0", tcp_T_entity, width_m=width_m)
        return planner.answer(
            FindPlacements(world=world, payload=held, destination="bin", q_rad=home, seed=1, **changes)
        )

    return ask


@pytest.fixture
def place(ask):
    """The places for the cube of a world, of which there is one at least."""

    def place(world, width_m, **changes):
        answer = ask(world, width_m, **changes)
        assert isinstance(answer, Approaches), answer
        return answer.approaches

    return place


def test_an_object_falls_into_a_bin_that_is_too_deep_for_the_hand_and_no_further_than_is_needed(planner, place):
    falling = place(deep(0.1), 0.03)
    for approach in falling:
        assert 0.0 < approach.fall_m < 0.1
        assert f"fall+{round(1e3 * approach.fall_m):03d}" in approach.label
        lowest_m = planner._chain.compute_tcp(approach.line_rad[-1])[2, 3] - 0.015
        assert lowest_m == pytest.approx(0.005 + 0.004 + approach.fall_m, abs=2e-4)
    assert place(deep(0.06), 0.03)[0].fall_m < min(approach.fall_m for approach in falling)
    assert place(deep(0.02), 0.03)[0].fall_m == 0.0


def test_walls_round_about_a_wide_basin_keep_what_falls_into_it(place):
    """The square within it is further from its walls than in a box: no site could be reached, and nothing fell."""
    turns, radius_m = np.radians(range(0, 360, 36)), 0.08
    halves = [Pose(quaternion_wxyz=(float(np.cos(a / 2)), 0.0, 0.0, float(np.sin(a / 2)))) for a in turns]
    walls = [
        Shape(
            ShapeKind.BOX,
            (0.002, 0.03, 0.04),
            Pose((*(radius_m * np.array((np.cos(a), np.sin(a)))), 0.04), at.quaternion_wxyz),
        )
        for a, at in zip(turns, halves, strict=True)
    ]
    interior = Interior((0, 0, 0.0425), (0.056, 0.056, 0.0375))
    basin = build_fixed(
        "bin", (0.5, 0.3, 0), build_box((0, 0, 0.0025), (0.07, 0.07, 0.0025)), *walls, interior=interior
    )
    table, _, cube = deep(0.1, half_m=0.01).entities
    assert 0.0 < place(World((table, basin, cube)), 0.02)[0].fall_m < 0.08


def test_one_placement_is_asked_for_by_who_wants_to_know_whether_there_is_any(ask):
    four, one = (ask(deep(0.02), 0.03, count=count) for count in (4, 1))
    assert len(four.approaches) == 4
    assert len(one.approaches) == 1
    assert one.stages.screening.solved < four.stages.screening.solved
    assert ask(deep(0.1, is_open=True), 0.03, count=1).code == "NO_IK"


def test_nothing_falls_where_it_must_not_or_where_no_wall_keeps_it(ask):
    assert ask(deep(0.1), 0.03, may_fall=False).code == "NO_IK"
    assert ask(deep(0.1, is_open=True), 0.03).code == "NO_IK"


def test_an_object_goes_onto_what_fills_its_container_where_walls_keep_it_there(ask, place):
    """A basket whose floor was taken by the first object had no room for the second one, and was 12 cm deep."""
    filling = build_fixed("filling", (0.5, 0.3, 0.025), build_box((0, 0, 0), (0.035, 0.045, 0.02)))
    filling = msgspec.structs.replace(filling, movable=True)
    for approach in place(deep(0.1, filling), 0.03):
        assert approach.site.position_m[2] == pytest.approx(0.045 + 0.015, abs=2e-4)
    assert ask(deep(0.1, filling), 0.03, may_fall=False).code == "NO_FREE_SITE"
    assert ask(deep(0.055, filling), 0.03).code == "NO_FREE_SITE", "no wall keeps it"
    fixed = msgspec.structs.replace(filling, movable=False)
    assert ask(deep(0.1, fixed), 0.03).code == "NO_SPACE", "it was not put there"


def test_what_fits_at_one_yaw_only_is_turned_along_the_walls(place):
    shape = build_box((0, 0, 0), (0.05, 0.012, 0.012))
    bar = msgspec.structs.replace(build_cube("cube0", 0.4, -0.2), shapes=(shape,))
    askew = Pose(quaternion_wxyz=(0.0, float(np.cos(0.17)), float(np.sin(0.17)), 0.0))
    for approach in place(replace_entity(deep(0.04, x=0.025), bar), 0.024, tcp_T_entity=askew):
        w, _, _, z = approach.site.quaternion_wxyz
        off_rad = (2.0 * np.arctan2(z, w) - 0.4) % np.pi
        assert off_rad == pytest.approx(np.pi / 2, abs=0.02)


def test_an_object_is_put_down_at_a_heading_in_a_place_that_is_turned_itself(place):
    askew = Pose(quaternion_wxyz=(0.0, float(np.cos(0.17)), float(np.sin(0.17)), 0.0))
    for approach in place(deep(0.04), 0.03, tcp_T_entity=askew, heading_rad=1.0):
        assert compute_heading(approach.site.quaternion_wxyz) == pytest.approx(1.0, abs=0.01)


def test_a_mug_goes_where_its_handle_is_over_the_wall(ask, place):
    """`There is no room for white_mug in teal_tray`: the box around mug and handle was wider than the tray."""
    body = Shape(ShapeKind.CYLINDER, (0.03, 0.035))
    mug = msgspec.structs.replace(
        build_cube("cube0", 0.4, -0.2), shapes=(body, build_box((0.043, 0, 0.01), (0.013, 0.005, 0.012)))
    )
    for approach in place(replace_entity(deep(0.02, x=0.037, y=0.04), mug), 0.06):
        local = np.subtract(approach.site.position_m[:2], (0.5, 0.3)) @ np.array(
            ((np.cos(0.4), -np.sin(0.4)), (np.sin(0.4), np.cos(0.4)))
        )
        assert np.all(np.abs(local) < np.array((0.007, 0.01)) - 0.002), approach.label
    assert ask(replace_entity(deep(0.05, x=0.037, y=0.04), mug), 0.06).code == "NO_SPACE"


def test_an_object_that_was_grasped_with_a_tilted_hand_is_put_down_upright(planner, find, home):
    """The hand was turned upright over its place, and the object by as much."""
    tilted = tilt_tool(point_tool_down(0.3, np.array((0.4, -0.2, 0.2))), np.radians(20.0))
    q = planner._chain.solve(tilted, home)
    item = np.eye(4)
    item[:3, 3] = tilted[:3, 3]
    held = Payload("cube0", compute_pose(compute_inverse(tilted) @ item), width_m=0.03)
    for approach in find(FindPlacements(world=deep(0.02), payload=held, destination="bin", q_rad=q, seed=1)):
        assert compute_matrix(approach.site)[2, 2] == pytest.approx(1.0, abs=1e-4)
        assert compute_matrix(approach.tcp_end)[2, 2] == pytest.approx(-np.cos(np.radians(20.0)), abs=1e-3)


def test_what_is_too_large_is_told_from_what_finds_the_destination_full(ask):
    """A bottle does not go into 45 x 50 mm: objects were moved out of a tray that it would not fit alone."""
    large = build_cube("cube0", 0.4, -0.2, half=0.035)
    other = build_cube("other", 0.5, 0.3, half=0.03, z=0.035)
    assert ask(replace_entity(deep(0.02, other, half_m=0.03), large), 0.07).code == "NO_FREE_SITE"
    assert ask(replace_entity(deep(0.02, x=0.03, y=0.03), large), 0.07).code == "NO_SPACE"


def test_a_bowl_in_the_middle_of_a_tray_is_no_floor_to_stand_on(ask, place):
    """Its base is as low as the floor: objects were to stand in it, and found no room, empty as the tray may be."""
    base = Shape(ShapeKind.CYLINDER, (0.022, 0.002), Pose((0, 0, -0.016)))
    walls = [build_box((s * 0.022, 0, 0), (0.002, 0.02, 0.018)) for s in (-1, 1)]
    walls += [build_box((0, s * 0.022, 0), (0.02, 0.002, 0.018)) for s in (-1, 1)]
    bowl = msgspec.structs.replace(build_cube("bowl", 0.5, 0.3, z=0.023), shapes=(base, *walls))
    assert place(deep(0.03, bowl, y=0.08), 0.03)
    assert ask(deep(0.03, bowl, x=0.04, y=0.04), 0.03).code == "NO_FREE_SITE"


def test_objects_are_packed_along_walls_so_that_the_next_one_fits(place):
    """Two cubes of 40 mm in 100 x 120 mm fit only when the first does not stand in the middle."""
    world, places = deep(0.03, y=0.06, half_m=0.02), []
    for number in range(2):
        site = place(world, 0.04)[0].site
        places.append(site.position_m)
        world = World((*world.entities, msgspec.structs.replace(build_cube(f"in{number}", 0, 0), pose=site)))
    gaps = [np.linalg.norm(np.subtract(a, b)) for k, a in enumerate(places) for b in places[:k]]
    assert min(gaps) > 0.04


def make_bar(name, x, y, half_x, half_y, yaw=0.0):
    pose = Pose((x, y, 0.015), (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))))
    return msgspec.structs.replace(
        build_cube(name, 0, 0), pose=pose, shapes=(build_box((0, 0, 0), (half_x, half_y, 0.015)),)
    )


def test_room_is_left_for_what_still_comes(planner, place, home):
    """Alone, the first cube went where the bar that followed had no room any more."""
    bar = make_bar("bar", 0.4, 0.0, 0.05, 0.02, yaw=0.7)
    world = deep(0.02, bar, half_m=0.02, x=0.08, y=0.05)
    places = {}
    for coming in ((), ("bar",)):
        site = place(world, 0.04, coming=coming)[0].site
        there = msgspec.structs.replace(build_cube("there", 0, 0, half=0.02), pose=site)
        held = Payload("bar", DOWN, width_m=0.04)
        later = World((*(each for each in world.entities if each.name != "cube0"), there))
        places[coming] = planner.answer(
            FindPlacements(world=later, payload=held, destination="bin", q_rad=home, seed=1)
        )
    assert places[()].code == "NO_FREE_SITE"
    assert isinstance(places["bar",], Approaches), places["bar",]


def test_the_fewest_objects_are_found_that_have_to_go(planner, home):
    """What filled a tray was moved out by a repair only, after a session had been refused."""
    large = build_cube("cube0", 0.4, -0.2, half=0.025)
    others = [build_cube("other", 0.5, 0.3, half=0.02, z=0.025), build_cube("beside", 0.5, 0.1, half=0.02)]
    full = replace_entity(deep(0.02, *others, half_m=0.03, y=0.05), large)
    request = FindGrasps(
        world=full, object="cube0", then=Destination("bin"), removable=("beside", "other"), q_rad=home, seed=1
    )
    assert planner.answer(request).gone == ("other",)
    assert planner.answer(msgspec.structs.replace(request, removable=("beside",))).code == "NO_FREE_SITE"
    wide = replace_entity(deep(0.02, *others, half_m=0.03, x=0.1, y=0.1), large)
    assert planner.answer(msgspec.structs.replace(request, world=wide)).gone == ()


def test_an_object_falls_between_walls_around_a_region_that_stand_on_each_other(place):
    """A compartment of a rack is a region; the lowest walls beside its middle end where others begin."""
    table, vessel, cube0 = deep(0.1).entities
    low = [build_box(s.pose.position_m, (*s.size_m[:2], s.size_m[2] / 2)) for s in vessel.shapes[1:]]
    low = [msgspec.structs.replace(s, pose=Pose((*s.pose.position_m[:2], 0.025))) for s in low]
    high = [msgspec.structs.replace(s, pose=Pose((*s.pose.position_m[:2], 0.075))) for s in low]
    rack = msgspec.structs.replace(vessel, name="rack", shapes=(vessel.shapes[0], *low, *high), interior=None)
    slot = Region(name="bin", pose=Pose((0.5, 0.3, 0.0525), vessel.pose.quaternion_wxyz), half_m=(0.05, 0.065, 0.0475))
    assert place(World((table, rack, cube0), (slot,)), 0.03)[0].fall_m > 0.0


def test_an_object_is_dropped_into_the_hollow_of_what_it_is_put_on(ask, place):
    """Between the walls of a bowl there is no room for the fingers."""
    table, _, cube0 = deep(0.1).entities
    walls = [build_box((s * 0.04, 0, 0.03), (0.003, 0.04, 0.03)) for s in (-1, 1)]
    walls += [build_box((0, s * 0.04, 0.03), (0.04, 0.003, 0.03)) for s in (-1, 1)]
    vessel = build_fixed("bin", (0.5, 0.3, 0.0), build_box((0, 0, 0.003), (0.02, 0.02, 0.003)), *walls)
    assert place(World((table, vessel, cube0)), 0.03, relation="on")[0].fall_m > 0.0
    open_side = msgspec.structs.replace(vessel, shapes=vessel.shapes[:-1])
    through = ask(World((table, open_side, cube0)), 0.03, relation="on")
    assert not isinstance(through, Approaches) or all(each.fall_m == 0.0 for each in through.approaches)


def test_where_no_arrangement_of_rectangles_is_found_the_first_object_goes_into_a_corner(place):
    """Two cans of 60 mm stand in 110 x 110 mm across, and not side by side."""
    can = msgspec.structs.replace(
        build_cube("cube0", 0.4, -0.2, half=0.03), shapes=(Shape(ShapeKind.CYLINDER, (0.03, 0.03)),)
    )
    table, vessel, _ = deep(0.1, x=0.055, y=0.055).entities
    world = World((table, vessel, can, msgspec.structs.replace(can, name="next", pose=Pose((0.4, 0.0, 0.03)))))
    x, y, _ = to_child(vessel.pose, place(world, 0.06, coming=("next",))[0].site.position_m)
    assert (abs(x), abs(y)) == pytest.approx((0.02, 0.02), abs=1e-3)


def test_the_datum_of_what_is_larger_than_its_place_is_put_within_it_as_well(ask, place):
    """Its middle was, and its datum was not: what is asked of it did not hold afterwards."""
    shapes = (Shape(ShapeKind.CYLINDER, (0.03, 0.035)), build_box((0.043, 0, 0.01), (0.013, 0.005, 0.012)))
    mug = msgspec.structs.replace(build_cube("cube0", 0.4, -0.2), shapes=shapes)  # its handle is over the wall
    marked = msgspec.structs.replace(mug, datum_m=(0.055, 0.0, 0.01))
    world = deep(0.02, x=0.037, y=0.04)
    assert place(replace_entity(world, mug), 0.06)
    assert ask(replace_entity(world, marked), 0.06).code in {"NO_SPACE", "NO_FREE_SITE"}


def test_an_object_is_put_across_the_slats_of_a_floor_where_a_circle_around_it_finds_none(place):
    table, vessel, cube = deep(0.055, half_m=0.0105, x=0.092, y=0.057).entities
    slats = [build_box((0, y, 0.0025), (0.092, 0.0082, 0.0025)) for y in (-0.0492, -0.0164, 0.0164, 0.0492)]
    slatted = msgspec.structs.replace(vessel, shapes=(*slats, *vessel.shapes[1:]))
    assert place(World((table, slatted, cube)), 0.021, count=1)
