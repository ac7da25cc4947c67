"""The number that decided, in a picture and over time: a cube slides into a region, and perception sees it."""

import math
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

from phyagentos.geometry import Pose
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, encode_json
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.workspace.array_files import encode_arrays
from phyagentos.protocol.world.environment import Region
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.distance import draw_distance
from phyagentos.view.judged import find_judged
from phyagentos.view.quantities import find_deciding, format_measure
from tests.view.test_page import read, see

pytestmark = pytest.mark.sim

SCENE = """<mujoco><worldbody>
  <camera name="overview" pos="0.3 0 1" fovy="45"/>
  <body name="red_cube" pos="0.1 0 0.02"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
</worldbody></mujoco>"""
ID, FIRST_X, LAST_X, MOMENTS = SessionId("tidy-7.a"), 0.1, 0.3, 41
TRAY = Region(name="tray", pose=Pose((0.3, 0.0, 0.05)), half_m=(0.1, 0.1, 0.05))


@pytest.fixture
def bundle(documents):
    """A cube slides from x = 0.1 to 0.3 m in two seconds; perception sees it 2 mm off."""
    folder = documents.workspace.evidence_of(ID)
    model = mujoco.MjModel.from_xml_string(SCENE)
    mujoco.mj_saveModel(model, str(folder / "scene.mjb"))
    qpos = np.tile(model.qpos0, (MOMENTS, 1))
    qpos[:, 0] = np.linspace(FIRST_X, LAST_X, MOMENTS)
    time_s = np.linspace(1.0, 3.0, MOMENTS)
    (folder / "motion.npz").write_bytes(encode_arrays({"time_s": time_s, "qpos": qpos}))
    (folder / "terminal.npz").write_bytes(encode_arrays({"time": np.array(3.0), "qpos": qpos[-1]}))
    Image.new("RGB", (640, 480)).save(folder / PICTURE_AFTER)
    found = documents.read_bundle(documents.ledger.sessions[ID])
    worlds = []
    for world, time, x in ((found.before, 1.0, FIRST_X), (found.after, 3.0, LAST_X)):
        seen = {"observed_at_s": time, "movable": True, "visible": True, "confidence": 1.0}
        cube = replace(world.entities["red_cube"], pose=Pose((x + 0.002, 0.0, 0.02)), **seen)
        worlds.append(replace(world, time_s=time, entities={"red_cube": cube}, regions={"tray": TRAY}, sensing="truth"))
    for world, name in zip(worlds, ("before", "after"), strict=True):
        (folder / f"environment_{name}.json").write_bytes(encode_json(world))
    return replace(found, before=worlds[0], after=worlds[1])


def judge(bundle, text):
    found = parse_predicate(text).evaluate(bundle.session.make_view(bundle.after, bundle.before))
    return Criterion(text=text, kind="accept", truth=found.truth, measured=found.measured, because=found.because)


def read_heights(plot):
    points = " ".join(plot.curves).split()
    return [float(point.split(",")[1]) for point in points]


@pytest.mark.parametrize(
    ("text", "limit", "met"),
    [
        ("inside(red_cube, tray)", "limit 0 mm", "met above"),
        ("at(red_cube, (0.3, 0, 0.02), 0.05)", "limit 50 mm", "met below"),
        ("distance(red_cube, (0.3, 0, 0.02)) < 0.1", "limit 100 mm", "met below"),
        ("not at(red_cube, (0.1, 0, 0.02), 0.05)", "limit 50 mm", "met above"),
    ],
)
def test_the_distance_is_drawn_with_the_limit_at_which_the_criterion_turns_over(bundle, text, limit, met):
    plot = draw_distance(bundle, judge(bundle, text))
    ((height, said),) = plot.limits
    assert said == limit
    assert f"simulated at {MOMENTS} moments, perceived at 2; {met} the limit" in plot.words
    heights, (first, last) = read_heights(plot), [y for _, y, _ in plot.dots]
    assert (heights[0] < height) != (heights[-1] < height), "it crosses the limit once"
    assert sum((a < height) != (b < height) for a, b in pairwise(heights)) == 1
    assert abs(first - heights[0]) < 5 > abs(last - heights[-1]), "perception was 2 mm off"
    assert (heights[-1] < height) == met.endswith("above"), "y grows downwards, and it is met in the end"


@pytest.mark.parametrize("text", ["holding(target, red_cube)", "metric(x) < 1", "no predicate at all", "human Is it?"])
def test_what_poses_do_not_decide_is_not_computed(bundle, text):
    assert draw_distance(bundle, Criterion(text=text, kind="accept", truth=Truth.FALSE)) is None


def test_without_a_simulated_world_only_what_was_perceived_is_shown(bundle):
    (bundle.folder / "motion.npz").unlink()
    plot = draw_distance(bundle, judge(bundle, "inside(red_cube, tray)"))
    assert (plot.curves, len(plot.dots)) == ((), 2)
    assert "simulated at 0 moments, perceived at 2" in plot.words


def test_unknown_moments_leave_a_gap(bundle):
    unseen = replace(bundle.after, entities={})
    plot = draw_distance(replace(bundle, after=unseen), judge(bundle, "inside(red_cube, tray)"))
    assert len(plot.dots) == 1


def test_the_number_stands_beside_the_object_in_the_picture(bundle):
    criterion = judge(bundle, "at(red_cube, (0.3, 0, 0.02), 0.05)")
    judged = find_judged(bundle, criterion)
    (spot,) = judged.spots
    focal = 240 / math.tan(math.radians(22.5))
    assert spot.middle == pytest.approx((320 + focal * 0.002 / 0.98, 240), abs=1.0), "the camera looks down on x = 0.3"
    assert spot.width == pytest.approx(focal * 0.04 / 0.96, abs=1.0)
    assert judged.label == "distance 2 mm"
    left, top, width, height = judged.window
    assert left <= spot.left
    assert top <= spot.top
    assert spot.left + spot.width <= left + width <= 640
    assert spot.top + spot.height <= top + height <= 480


def test_what_no_picture_shows_has_no_number_in_it(bundle):
    away = {"red_cube": replace(bundle.after.entities["red_cube"], pose=Pose((9.0, 0.0, 0.02)))}
    criterion = judge(bundle, "at(red_cube, (0.3, 0, 0.02), 0.05)")
    assert find_judged(replace(bundle, after=replace(bundle.after, entities=away)), criterion) is None
    assert find_judged(replace(bundle, after=None), criterion) is None
    assert find_judged(bundle, replace(criterion, measured={})) is None
    assert find_judged(bundle, None) is None


def test_the_number_that_decided_is_the_one_that_the_sentence_says():
    measured = {"side_x_m": 0.03653, "side_y_m": 0.0705, "below_rim_m": 0.02606, "above_floor_m": 0.01094}
    because = "red_cube is inside red_tray, 37 mm from its tightest bound (side)"
    known = {"text": "inside(a, b)", "kind": "accept", "truth": Truth.TRUE, "measured": measured}
    assert find_deciding(Criterion(**known, because=because)) == "side_x_m"
    assert find_deciding(Criterion(**known, because="137 mm")) == "above_floor_m"
    assert format_measure(-0.2276, "side_x_m") == "−228 mm"
    assert find_deciding(Criterion(text="x", kind="accept", truth=Truth.TRUE, measured={"held": True})) == ""


def test_damaged_evidence_is_named_where_it_is_shown(documents, bundle):
    (bundle.folder / "scene.mjb").write_bytes(b"no model")
    assert 'role="alert"' in read(documents, "distance", session=ID)
    assert "Tidy." in see(read(documents, "headline", session=ID))
