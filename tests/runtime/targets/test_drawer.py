"""A drawer, a door or a lid is a body with a joint: it opens where the file says, and says how far it is open."""

import numpy as np
import pytest

from phyagentos.geometry import compute_matrix
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.mechanisms import compute_motion, measure_amount
from phyagentos.protocol.world.scenes import Body, SceneSpec, read_scene
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.execution.leaves.find_opening import compute_way
from phyagentos.runtime.models.scene import draw_bodies

pytestmark = pytest.mark.sim

SPEC = read_scene(Library.open().get_scene("tabletop/drawer"))


def start(panda, seed, spec=SPEC):
    physics = Physics.alone(*panda, spec, seed)
    physics.start(spec.settle_s)
    physics.queries.look()
    return physics


def start_alone(panda, settle_s=0.0, **bodies):
    """A scene of these bodies and nothing else."""
    cameras = {"top": {"position_m": [0, 0, 1], "target_m": [0.1, 0, 0]}}
    scene = {"scene": "x", "settle_s": settle_s, "bodies": bodies, "cameras": cameras}
    return start(panda, 1, SceneSpec.model_validate(scene))


def read(physics, name):
    return next(each for each in physics.queries.read_entities({}) if each.name == name)


def test_each_seed_opens_the_drawer_within_its_span_and_everything_else_stays(panda):
    openings = [read(start(panda, seed), "drawer").joint for seed in (1, 2, 3)]

    low, high = SPEC.bodies["drawer"].joint.opening
    assert all(low - 0.01 <= opening <= high + 0.01 for opening in openings)
    assert len(set(openings)) == 3
    drawer = SPEC.bodies["drawer"]
    wider = drawer.model_copy(update={"joint": drawer.joint.model_copy(update={"opening": (0.0, 1.0)})})
    other = SPEC.model_copy(update={"bodies": {**SPEC.bodies, "drawer": wider}})
    cubes = [{item.name: item.position_m for item in draw_bodies(spec, 4)}["green_cube"] for spec in (SPEC, other)]
    assert cubes[0] == cubes[1]


def test_the_handle_moves_with_its_drawer_and_the_fraction_is_that_of_the_travel(panda):
    physics = start(panda, 1)
    gaps, fractions = [], []
    for opening in (0.0, 0.5, 1.0):
        joint = physics.model.joint("drawer_joint")
        physics.data.qpos[joint.qposadr[0]] = opening * 0.13
        physics.queries.look()
        drawer, handle = read(physics, "drawer"), read(physics, "handle")
        gaps.append(np.subtract(handle.pose.position_m, drawer.pose.position_m))
        fractions.append(drawer.joint)
        (way,) = compute_way(drawer, drawer.mechanism, 0.25)
        np.testing.assert_allclose(way[:3, 3], [-(0.25 - opening) * 0.13, 0.0, 0.0], atol=1e-9)

    assert fractions == pytest.approx([0.0, 0.5, 1.0])
    np.testing.assert_allclose(gaps, [SPEC.bodies["handle"].place.position_m] * 3, atol=1e-9)
    assert (handle.part_of, handle.joint, drawer.movable) == ("drawer", None, True)


def test_a_hand_pushes_the_drawer_in_and_it_stays_where_it_is_left(panda):
    physics = start(panda, 2)
    wanted = np.array([0.6, 0.14, 0.008])
    for _ in range(400):
        physics.actuation.pull("drawer", wanted, 400.0, 40.0, spin_damping=1.0, carries_weight=False)
        physics.step()
    physics.actuation.let_go("drawer")
    before = physics.queries.find_position("drawer")
    physics.step(200)

    assert np.linalg.norm(before - wanted) < 0.01
    assert np.linalg.norm(physics.queries.find_position("drawer") - before) < 0.001


def test_a_door_turns_about_its_anchor(panda):
    door = {
        "kind": "door",
        "place": {"position_m": [0.6, 0.4, 0.1]},
        "joint": {
            "kind": "hinge",
            "axis": [0, 0, 1],
            "anchor_m": [0.0, 0.1, 0.0],
            "travel": 1.57079633,
            "opening": [0.5, 0.5],
        },
        "shapes": [{"kind": "box", "size_m": [0.005, 0.1, 0.05]}],
    }
    physics = start_alone(panda, door=door)
    ajar = read(physics, "door")
    physics.data.qpos[physics.model.joint("door_joint").qposadr[0]] = 0.0
    physics.queries.look()
    closed = read(physics, "door")

    assert (ajar.joint, closed.joint) == (pytest.approx(0.5), 0.0)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(ajar.pose.position_m, [0.6 + 0.1 * half, 0.5 - 0.1 * half, 0.1], atol=1e-6)
    np.testing.assert_allclose(closed.pose.position_m, ajar.mechanism.closed.position_m, atol=1e-6)
    np.testing.assert_allclose(closed.pose.position_m, [0.6, 0.4, 0.1], atol=1e-6)


@pytest.mark.parametrize("level", [False, True])
def test_a_hinge_starts_as_wide_as_the_file_says_whatever_its_axis(panda, level):
    """The simulator's own pose of a half-open object is that which its mechanism gives for half of the travel."""
    axis = [0, 1, 0] if level else [0, 0, -1]
    joint = {"kind": "hinge", "axis": axis, "anchor_m": [0.1, 0.0, 0.0], "travel": 1.6, "opening": [0.5, 0.5]}
    lid = {"kind": "lid", "place": {"position_m": [0.6, 0.4, 0.1], "yaw_rad": [0.3, 0.3]}}
    lid["joint"] = joint | {"friction": 9}
    tab = {"kind": "handle", "part_of": "lid", "place": {"position_m": [-0.12, 0.0, 0.0]}}
    shapes = {"shapes": [{"kind": "box", "size_m": [0.1, 0.1, 0.005]}]}
    physics = start_alone(panda, lid=lid | shapes, tab=tab | shapes)
    lid, tab = (read(physics, name) for name in ("lid", "tab"))

    np.testing.assert_allclose(
        compute_motion(lid.mechanism, 0.8) @ compute_matrix(lid.mechanism.closed), compute_matrix(lid.pose), atol=1e-6
    )
    assert measure_amount(lid.mechanism, np.array([-0.12, 0, 0]), np.array(tab.pose.position_m)) == pytest.approx(0.8)
    np.testing.assert_allclose(lid.mechanism.closed.position_m, [0.6, 0.4, 0.1], atol=1e-6)


@pytest.mark.parametrize(("spring", "least", "most"), [(60.0, 0.0, 0.01), (400.0, 0.5, 1.0)])
def test_a_pressed_button_stays_where_friction_holds_its_spring_and_comes_out_where_it_does_not(
    panda, spring, least, most
):
    """It crept by ten millimetres a second under its own weight."""
    joint = {"kind": "slide", "axis": [0, 0, 1], "travel": 0.04, "friction": 6.0, "spring": spring}
    shapes = [{"kind": "cylinder", "size_m": [0.03, 0.006]}]
    button = {"kind": "button", "mass_kg": 0.06, "place": {"position_m": [0.6, 0.4, 0.1]}, "shapes": shapes}

    assert least <= read(start_alone(panda, 1.0, button=button | {"joint": joint}), "button").joint <= most


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ({"joint": {"kind": "slide", "axis": [1, 1, 0], "travel": 0.1}}, "length 1"),
        ({"joint": {"kind": "slide", "axis": [1, 0, 0], "travel": -0.1}}, "greater than 0"),
        ({"joint": {"kind": "slide", "axis": [1, 0, 0], "travel": 0.1, "opening": [0.5, 1.5]}}, "two fractions of"),
        ({"joint": {"kind": "slide", "axis": [1, 0, 0], "travel": 0.1}, "fixed": True}, "neither fixed"),
        ({"part_of": "drawer", "fixed": True}, "a place by position_m alone"),
        ({"part_of": "drawer", "place": {"jitter_m": [0.1, 0, 0]}}, "a place by position_m alone"),
    ],
)
def test_a_joint_that_cannot_be_is_refused(body, says):
    shapes = [{"kind": "sphere", "size_m": [0.1]}]
    with pytest.raises(ValueError, match=says):
        Body.model_validate({"kind": "thing", "shapes": shapes, **body})
