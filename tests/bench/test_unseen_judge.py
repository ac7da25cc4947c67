"""The judge of unseen worlds, on worlds made by hand: each predicate met and unmet, and what is left open."""

import mujoco
import numpy as np
import pytest

from benchmarks.oracle.acceptance import list_places
from benchmarks.oracle.moment import Moment
from benchmarks.oracle.predicates import Judge
from benchmarks.worlds.forms import Form, Solid, make_box, make_vessel
from benchmarks.worlds.rooms import Room, SceneObject, Spot

pytestmark = pytest.mark.sim

TRAY = make_vessel(0.12, 0.16, 0.02, "tray")
CAN = Form("can", (Solid("cylinder", (0.02, 0.04)),), 0.04, 0.02, True)
FORMS = {
    "cube": make_box(0.04, 0.04, 0.04),
    "block": make_box(0.06, 0.06, 0.02),
    "can": CAN,
    "ball": Form("ball", (Solid("sphere", (0.02,)),), 0.04),
    "rod": Form("rod", (Solid("capsule", (0.01, 0.03), euler_rad=(0, np.pi / 2, 0)),), 0.02),
}


def render(name, form, fixed=False):
    geoms = "".join(
        f'<geom type="{s.kind}" size="{" ".join(map(str, s.size_m))}" pos="{" ".join(map(str, s.at_m))}" '
        f'euler="{" ".join(map(str, s.euler_rad))}" mass="0.05"/>'
        for s in form.solids
    )
    return f'<body name="{name}" pos="0.5 0.3 0">{geoms}</body>' if fixed else (
        f'<body name="{name}"><freejoint/>{geoms}</body>'
    )  # fmt: skip


MODEL = mujoco.MjModel.from_xml_string(
    "<mujoco><compiler angle='radian' eulerseq='xyz'/><option timestep='0.002'/><worldbody>"
    "<body name='table' pos='0.4 0 -0.02'><geom type='box' size='0.6 0.7 0.02'/></body>"
    "<body name='hand' pos='-0.5 0 0.5'><geom type='box' size='0.01 0.01 0.01'/></body>"
    "<body name='left_finger' pos='-0.5 0 0.3'><joint name='l' type='slide' axis='0 1 0'/>"
    "<geom type='box' size='0.01 0.01 0.03' friction='2 0.1 0.1'/></body>"
    "<body name='right_finger' pos='-0.5 -0.06 0.3'><joint name='r' type='slide' axis='0 1 0'/>"
    "<geom type='box' size='0.01 0.01 0.03' friction='2 0.1 0.1'/></body>"
    "<body name='drawer' pos='-0.8 0 0'><joint name='d' type='slide' axis='1 0 0' range='0 0.2'/>"
    "<geom type='box' size='0.05 0.05 0.05' mass='1'/></body>"
    + render("tray", TRAY, fixed=True)
    + "".join(render(name, form) for name, form in FORMS.items())
    + "</worldbody><actuator><motor joint='l'/><motor joint='r'/></actuator></mujoco>"
)
OBJECTS = {name: SceneObject(name, form, (0, 0, 0), None, "red", (1, 0, 0)) for name, form in FORMS.items()}
OBJECTS["tray"] = SceneObject("tray", TRAY, (0.5, 0.3, 0), 0.0, "blue", (0, 0, 1), fixed=True)
ROOM = Room(0, OBJECTS, {"spot": Spot("spot", (0.5, -0.3, 0.06), (0.06, 0.06, 0.06))}, ())
HOME = {
    "cube": (0.4, 0.0, 0.02),
    "block": (0.6, 0.0, 0.01),
    "can": (0.5, -0.1, 0.04),
    "ball": (0.3, 0.2, 0.02),
    "rod": (0.3, -0.2, 0.01),
}
ON_SIDE = (np.cos(np.pi / 4), 0, np.sin(np.pi / 4), 0)


def make_state(*, settles_s=0.3, opening_m=0.0, quats=None, speeds=None, grips=False, **places):
    """(n,) state vector after objects have been put somewhere and come to rest."""
    data = mujoco.MjData(MODEL)
    for name, at in (HOME | places).items():
        first = MODEL.jnt_qposadr[MODEL.body(name).jntadr[0]]
        data.qpos[first : first + 7] = (*at, *(quats or {}).get(name, (1, 0, 0, 0)))
    if grips:
        data.ctrl[:] = (-5.0, 5.0)
        data.qpos[MODEL.jnt_qposadr[MODEL.joint("l").id]] = -0.001
    else:
        data.qpos[MODEL.jnt_qposadr[MODEL.joint("l").id]] = 0.3
        MODEL.opt.gravity[2] = -9.81
    data.qpos[MODEL.jnt_qposadr[MODEL.joint("d").id]] = opening_m
    fingers = [MODEL.jnt_dofadr[MODEL.joint(name).id] for name in "lr"]
    for _ in range(round(settles_s / 0.002)):
        if not grips:
            data.qvel[fingers] = 0.0
        mujoco.mj_step(MODEL, data)
    for name, speed in (speeds or {}).items():
        first = MODEL.jnt_dofadr[MODEL.body(name).jntadr[0]]
        data.qvel[first : first + 3] = speed
    mujoco.mj_forward(MODEL, data)
    state = np.zeros(mujoco.mj_stateSize(MODEL, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(MODEL, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    return state


START = make_state()
IN_TRAY = {"cube": (0.5, 0.3, 0.026)}
ON_BLOCK = {"cube": (0.6, 0.0, 0.041)}


def judge(text, now=None, before=None, *broken, is_live=False):
    moments = (Moment(MODEL, START if state is None else state) for state in (now, before))
    return Judge(*list_places(ROOM), *moments, frozenset(broken), is_live=is_live).judge(text)


@pytest.mark.parametrize(
    ("text", "places", "more"),
    [
        ("inside(cube, tray)", IN_TRAY, {}),
        ("inside(cube, spot)", {"cube": (0.52, -0.32, 0.02)}, {}),
        ("on(cube, table)", {}, {}),
        ("on(cube, block)", ON_BLOCK, {}),
        ("on(cube, table) or on(cube, block)", ON_BLOCK, {}),
        ("at(cube, (0.4, 0.0, 0.02), 0.03)", {}, {}),
        ("at(cube, spot, 0.03)", {"cube": (0.5, -0.22, 0.02)}, {}),
        ("near(cube, block, 0.21)", {}, {}),
        ("upright(can)", {}, {}),
        ("fallen(can)", {"can": (0.5, -0.1, 0.02)}, {"quats": {"can": ON_SIDE}}),
        ("moved(cube)", IN_TRAY, {}),
        ("exists(ball) and visible(ball)", {}, {}),
        ("closed(drawer)", {}, {"opening_m": 0.018}),
        ("open(drawer)", {}, {"opening_m": 0.182}),
        ("visible(ball)", {"ball": (0.74, 0.64, 0.02)}, {}),  # at the side of one picture, which is wider than high
        ("tilt(can) <= 0.1", {}, {}),
        ("height(cube) >= 0.01", ON_BLOCK, {}),
        ("distance(cube, block) >= 0.15", {}, {}),
        ("speed(ball) <= 0.02", {}, {}),
        ("count(inside(*, tray)) >= 1", IN_TRAY, {}),
        ("count(inside(*, tray)) == 1", IN_TRAY, {}),
        ("count(inside(*, tray)) <= 1", IN_TRAY, {}),
        ("not moved(*)", {}, {}),
        ("not inside(*, tray)", {}, {}),
    ],
)
def test_what_is_so_is_true_and_its_negation_false(text, places, more):
    state = make_state(**places, **more)
    assert type(judge(text, state)) is float
    assert judge(text, state) >= 1
    if "*" not in text:
        assert judge(f"not ({text})", state) <= -1


@pytest.mark.parametrize(
    ("text", "places", "more"),
    [
        ("inside(cube, tray)", {}, {}),
        ("inside(cube, tray)", {"cube": (0.565, 0.3, 0.05)}, {}),  # on the rim, its middle past the side
        ("inside(cube, tray)", {"block": (0.5, 0.3, 0.016), "cube": (0.5, 0.3, 0.047)}, {}),  # on what fills it
        ("inside(cube, spot)", {"cube": (0.5, -0.23, 0.02)}, {}),
        ("on(cube, block)", {}, {}),
        ("on(cube, table)", ON_BLOCK, {}),  # it stands on what stands on it
        ("on(cube, block)", {"cube": (0.6, 0.056, 0.02)}, {}),  # close beside
        ("on(ball, table)", {}, {"speeds": {"ball": (0.1, 0, 0)}}),  # it rolls
        ("at(cube, (0.4, 0.04, 0.02), 0.03)", {}, {}),
        ("near(cube, block, 0.19)", {}, {}),
        ("upright(can)", {"can": (0.5, -0.1, 0.02)}, {"quats": {"can": ON_SIDE}}),
        ("fallen(can)", {}, {}),
        ("moved(cube)", {"cube": (0.41, 0.0, 0.02)}, {}),
        ("visible(ball)", {"ball": (0.3, 0.2, -0.5)}, {"settles_s": 0.0}),
        ("visible(ball)", {"ball": (0.95, 0.5, 0.02)}, {}),  # beside every picture
        ("exists(nothing)", {}, {}),
        ("closed(drawer)", {}, {"opening_m": 0.022}),
        ("open(drawer)", {}, {"opening_m": 0.178}),
        ("tilt(can) >= 0.1", {}, {}),
        ("height(cube) >= 0.01", {}, {}),
        ("distance(cube, block) >= 0.25", {}, {}),
        ("speed(ball) <= 0.02", {}, {"speeds": {"ball": (0.1, 0, 0)}}),
        ("count(inside(*, tray)) >= 2", IN_TRAY, {}),
        ("count(inside(*, tray)) <= 0", IN_TRAY, {}),
        ("not moved(*)", IN_TRAY, {}),
        ("not inside(*, tray)", IN_TRAY, {}),
        ("holding(target, cube)", {}, {}),
        ("count(holding(target, *)) == 1", {}, {}),
    ],
)
def test_what_is_not_so_is_false(text, places, more):
    state = make_state(**places, **more)
    before = state if text.startswith("visible") else None
    assert judge(text, state, before) <= -1


def test_held_is_what_both_fingers_press_and_it_is_in_no_place_yet():
    held = make_state(cube=(-0.5, -0.03, 0.3), grips=True, settles_s=0.1)
    assert judge("holding(target, cube)", held) >= 1
    assert judge("count(holding(target, *)) == 1", held) >= 1
    assert judge("on(cube, table)", held) <= -1
    assert judge("not holding(target, can)", held) >= 1


def test_what_two_honest_judges_may_differ_about_is_open():
    near = make_state(cube=(0.4154, 0.0, 0.02))  # moved by 15.4 mm, the limit is 15
    assert abs(judge("moved(cube)", near)) < 1
    assert abs(judge("not moved(cube)", near)) < 1


@pytest.mark.parametrize(("broken", "low", "high"), [((), 1, 99), (("left", "right"), 1, 99), (("*",), 0, 0)])
def test_what_only_a_broken_camera_has_in_view_is_open(broken, low, high):
    assert low <= judge("visible(ball)", START, START, *broken) <= high


@pytest.mark.parametrize(("is_live", "answer"), [(False, 0), (True, -99)])
def test_what_was_in_view_before_is_open_unless_this_moment_alone_is_asked_about(is_live, answer):
    gone = make_state(ball=(0.3, 0.2, -0.5), settles_s=0.0)
    assert judge("visible(ball)", gone, START, is_live=is_live) == answer


def test_how_a_cube_stands_is_open_where_another_of_its_faces_is_down():
    turned = make_state(quats={"cube": ON_SIDE, "can": ON_SIDE}, can=(0.5, -0.1, 0.02))
    assert judge("upright(cube)", turned) == judge("fallen(cube)", turned) == 0
    assert abs(judge("tilt(cube) <= 0.2", turned)) < 1
    assert judge("fallen(can)", turned) >= 1
    assert judge("upright(cube)") >= 1


def test_a_lying_rod_that_has_rolled_is_open_and_one_on_its_end_is_not_upright():
    rolled = make_state(quats={"rod": (np.cos(0.6), np.sin(0.6), 0, 0)})
    assert judge("upright(rod)", rolled) == 0
    on_end = make_state(quats={"rod": ON_SIDE}, rod=(0.3, -0.2, 0.04), settles_s=0.01)
    assert judge("upright(rod)", on_end) <= -1


def test_whether_a_ball_that_turned_in_its_place_has_moved_is_open():
    rolled = make_state(quats={"ball": ON_SIDE, "cube": ON_SIDE})
    assert judge("moved(ball)", rolled) == 0
    assert judge("moved(cube)", rolled) >= 1
    assert judge("moved(ball)", make_state(ball=(0.33, 0.2, 0.02))) >= 1


def test_what_it_cannot_read_is_said():
    with pytest.raises(ValueError, match="cannot read"):
        judge("metric(ticks) <= 3")
    with pytest.raises(ValueError, match="has no 'ghost'"):
        judge("upright(ghost)")
