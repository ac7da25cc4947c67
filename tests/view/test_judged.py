"""The number that decided, in a picture and over time: a cube slides into a region, and perception sees it."""

import math
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

from phyagentos.geometry import Pose
from phyagentos.pictures.playback import Playback, read_playback
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.sessions.evidence import INITIAL, MOTION, PICTURE_AFTER, SCENE_MODEL, TERMINAL, TRAJECTORY
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.workspace.array_files import encode_arrays
from phyagentos.protocol.world.environment import Region
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.distance import read_distance
from phyagentos.view.judged import find_judged
from phyagentos.view.quantities import find_deciding, format_measure

pytestmark = pytest.mark.sim

SCENE = """<mujoco><worldbody>
  <camera name="overview" pos="0.3 0 1" fovy="45"/>
  <body name="red_cube" pos="0.1 0 0.02"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
</worldbody></mujoco>"""
ID, FIRST_X, LAST_X, MOMENTS = SessionId("tidy-7.a"), 0.1, 0.3, 41
TRAY = Region(name="tray", pose=Pose((0.3, 0.0, 0.05)), half_m=(0.1, 0.1, 0.05))


@pytest.fixture(scope="module")
def playback():
    """A cube slides from x = 0.1 to 0.3 m in two seconds."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    qpos = np.tile(model.qpos0, (MOMENTS, 1))
    qpos[:, 0] = np.linspace(FIRST_X, LAST_X, MOMENTS)
    time_s, nowhere = np.linspace(1.0, 3.0, MOMENTS), np.empty((0, 3))
    return Playback(model=model, time_s=time_s, qpos=qpos, measured_m=nowhere, planned_m=nowhere, bundle=None)


@pytest.fixture
def bundle(documents):
    """Perception sees it 2 mm off."""
    found = documents.read_bundle(documents.ledger.sessions[ID])
    Image.new("RGB", (640, 480)).save(found.folder / PICTURE_AFTER)
    worlds = []
    for world, time, x in ((found.before, 1.0, FIRST_X), (found.after, 3.0, LAST_X)):
        seen = {"observed_at_s": time, "movable": True, "visible": True, "confidence": 1.0}
        cube = replace(world.entities["red_cube"], pose=Pose((x + 0.002, 0.0, 0.02)), **seen)
        worlds.append(replace(world, time_s=time, entities={"red_cube": cube}, regions={"tray": TRAY}, sensing="truth"))
    return replace(found, before=worlds[0], after=worlds[1])


def judge(bundle, text):
    found = parse_predicate(text).evaluate(bundle.session.make_view(bundle.after, bundle.before))
    return Criterion(text=text, kind="accept", truth=found.truth, measured=found.measured, because=found.because)


@pytest.mark.parametrize(
    ("text", "limit", "is_met_above"),
    [
        ("inside(red_cube, tray)", "0 mm", True),
        ("at(red_cube, (0.3, 0, 0.02), 0.05)", "50 mm", False),
        ("distance(red_cube, (0.3, 0, 0.02)) < 0.1", "100 mm", False),
        ("not at(red_cube, (0.1, 0, 0.02), 0.05)", "50 mm", True),
    ],
)
def test_the_limit_is_where_the_criterion_turns_over(bundle, playback, text, limit, is_met_above):
    found = read_distance(bundle, judge(bundle, text), playback)
    assert (format_measure(found.limit, found.quantity), found.is_met_above) == (limit, is_met_above)
    assert (len(found.simulated), len(found.perceived)) == (MOMENTS, 2)
    values = [value for _, value, _ in found.simulated]
    assert sum((a > found.limit) != (b > found.limit) for a, b in pairwise(values)) == 1, "it crosses the limit once"
    assert (values[-1] > found.limit) == is_met_above, "and is met in the end"
    assert [value for _, value, _ in found.perceived] == pytest.approx([values[0], values[-1]], abs=0.0025)


@pytest.mark.parametrize(
    "text",
    [
        "holding(target, red_cube)",
        "speed(red_cube) < 1",
        "open(red_cube)",
        "visible(red_cube)",
        "metric(x) < 1",
        "no predicate at all",
        "human Is it?",
    ],
)
def test_what_poses_do_not_decide_is_not_computed(bundle, playback, text):
    assert read_distance(bundle, Criterion(text=text, kind="accept", truth=Truth.FALSE), playback) is None


def test_without_a_simulated_world_only_what_was_perceived_is_shown(bundle):
    found = read_distance(bundle, judge(bundle, "inside(red_cube, tray)"), None)
    assert (len(found.simulated), len(found.perceived)) == (0, 2)


def test_moments_of_which_the_value_is_unknown_are_left_out(bundle, playback):
    criterion, unseen = judge(bundle, "inside(red_cube, tray)"), replace(bundle.after, entities={})
    found = read_distance(replace(bundle, after=unseen), criterion, playback)
    assert len(found.perceived) == 1
    assert read_distance(replace(bundle, after=unseen), criterion, None) is None


def test_the_number_stands_beside_the_object_in_the_picture(bundle, playback):
    judged = find_judged(bundle, judge(bundle, "at(red_cube, (0.3, 0, 0.02), 0.05)"), playback)
    ((left, top, width, height),) = judged.boxes.values()
    focal = 240 / math.tan(math.radians(22.5))
    middle = (left + width / 2, top + height / 2)
    assert middle == pytest.approx((320 + focal * 0.002 / 0.98, 240), abs=1.0), "the camera looks down on x = 0.3"
    assert width == pytest.approx(focal * 0.04 / 0.96, abs=1.0)
    assert judged.quantity == "distance_m"
    assert judged.picture.file == PICTURE_AFTER


def test_what_no_picture_shows_has_no_number_in_it(bundle, playback):
    away = {"red_cube": replace(bundle.after.entities["red_cube"], pose=Pose((9.0, 0.0, 0.02)))}
    criterion = judge(bundle, "at(red_cube, (0.3, 0, 0.02), 0.05)")
    assert find_judged(replace(bundle, after=replace(bundle.after, entities=away)), criterion, playback) is None
    assert find_judged(replace(bundle, after=None), criterion, playback) is None
    assert find_judged(bundle, replace(criterion, measured={}), playback) is None
    assert find_judged(bundle, criterion, None) is None, "and no camera has seen it"


def test_the_number_that_decided_is_the_one_that_the_sentence_says():
    measured = {"side_x_m": 0.03653, "side_y_m": 0.0705, "below_rim_m": 0.02606, "above_floor_m": 0.01094}
    because = "red_cube is inside red_tray, 37 mm from its tightest bound (side)"
    known = {"text": "inside(a, b)", "kind": "accept", "truth": Truth.TRUE, "measured": measured}
    assert find_deciding(Criterion(**known, because=because)) == "side_x_m"
    assert find_deciding(Criterion(**known, because="137 mm")) == "above_floor_m"
    assert format_measure(-0.2276, "side_x_m") == "−228 mm"
    assert [format_measure(each, "stone") for each in (2.0, 0.12345)] == ["2", "0.123"]
    assert find_deciding(Criterion(text="x", kind="accept", truth=Truth.TRUE, measured={"held": True})) == ""


def test_a_session_whose_runner_was_lost_is_played_from_what_the_world_recorded(documents, playback):
    folder = documents.workspace.evidence_of(ID)
    tcp = get_registered_target(documents.workspace.target_registry, "panda").tcp
    model = mujoco.MjModel.from_xml_string(SCENE.replace("</worldbody>", f'<site name="{tcp}"/></worldbody>'))
    mujoco.mj_saveModel(model, str(folder / SCENE_MODEL))
    moved = {"time_s": playback.time_s, "qpos": playback.qpos}
    for name, at in ((INITIAL, 0), (TERMINAL, -1)):
        (folder / name).write_bytes(encode_arrays({"time": playback.time_s[at], "qpos": playback.qpos[at]}))
    (folder / MOTION).write_bytes(encode_arrays(moved))
    (folder / TRAJECTORY).unlink()

    found = read_playback(documents.workspace, documents.ledger.sessions[ID])

    assert found.pose(2.0).body("red_cube").xpos[0] == pytest.approx((FIRST_X + LAST_X) / 2)
    assert found.measured_m.shape == (0, 3)
