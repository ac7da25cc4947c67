"""Every bridge of the registry: what it converts comes back, by its own inverse or by one that is computed here."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace, GripperRange
from phyagentos.runtime.actions.bridges.chain import BridgeChain, Bridged, compile_chain, list_bridges
from phyagentos.runtime.actions.bridges.columns import ClampBridge, ProjectionBridge
from phyagentos.runtime.actions.bridges.resampling import ResampleBridge
from phyagentos.runtime.actions.bridges.rotations import ToAbsoluteBridge, decode_rotation, encode_rotation
from phyagentos.runtime.actions.bridges.tool_poses import ToolPoseBridge
from phyagentos.runtime.actions.violations import ViolationCode
from tests.packages import install

FORMS = ("quaternion_wxyz", "quaternion_xyzw", "axis_angle", "rotation_6d", "euler")
RATES = (5.0, 10.0, 15.0, 25.0, 50.0, 100.0)
FRAMES = {
    "base": np.array([[0.0, -1.0, 0.0, 0.3], [1.0, 0.0, 0.0, -0.2], [0.0, 0.0, 1.0, 0.8], [0.0, 0.0, 0.0, 1.0]]),
    "tilted": np.block(
        [
            [Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix(), np.array([[0.1], [0.2], [-0.4]])],
            [np.zeros((1, 3)), np.ones((1, 1))],
        ]
    ),
}
JOINTS = ("j1", "j2", "j3", "j4", "j5")


@st.composite
def draw_pair(draw):
    """Two action spaces that can be bridged."""
    joint_space = draw(st.booleans())
    gripper = draw(st.booleans())
    common = {"representation": "joint_position" if joint_space else "tool_pose"}
    sides = []
    for _ in range(2):
        side = {
            **common,
            "delta": not sides and draw(st.booleans()),
            "interpolation": draw(st.sampled_from(("linear", "cubic"))),
            "angle_unit": draw(st.sampled_from(("rad", "deg"))),
            "rate_hz": draw(st.sampled_from(RATES)),
            "gripper": draw(st.sampled_from(((0.0, 0.08), (1.0, 0.0), (0.0, 1.0), (-1.0, 1.0)))) if gripper else None,
        }
        if side["gripper"] is not None:
            side["gripper"] = GripperRange(closed=side["gripper"][0], open=side["gripper"][1])
        if joint_space:
            side["joints"] = tuple(draw(st.permutations(JOINTS)))
        else:
            side |= {
                "frame": draw(st.sampled_from(("world", *FRAMES))),
                "length_unit": draw(st.sampled_from(("m", "cm", "mm"))),
                "rotation": draw(st.sampled_from(FORMS)),
                "euler_order": draw(st.sampled_from(("xyz", "ZYX", "zyz", "YXZ"))),
            }
        sides.append(side)
    source, target = sides
    if joint_space and draw(st.booleans()):
        target["joints"] = tuple(joint for joint in target["joints"] if joint != "j2")
        source["drop"] = ("j2",)
        source["joints"] = tuple(joint for joint in source["joints"] if joint != "j4")
        source["fixed"] = {"j4": 0.5}
    if draw(st.booleans()):
        columns = len(target["joints"]) if joint_space else 3
        source["clamp"] = True
        target |= {"minimum": (-0.5,) * columns, "maximum": (0.7,) * columns}
    return ActionSpace(**source, chunk_length=40), ActionSpace(**target, chunk_length=4000)


def draw_rows(space, count, rng):
    """Rows of a space: moderate values, any rotation (small ones where rows are changes)."""
    rows = rng.uniform(-1.0, 1.0, (count, space.width))
    if space.representation == "tool_pose":
        spread = 0.3 if space.delta else 3.0
        turns = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, (count, 3)) * spread / np.sqrt(3.0))
        rows[:, POSITION_WIDTH : space.arm_width] = encode_rotation(turns, space)
    return rows


def measure_distance(space, first, second):
    """Largest difference of two chunks: of numbers, or of rotations by their angle."""
    if first.shape != second.shape:
        return np.inf
    if space.representation == "joint_position":
        return float(np.abs(first - second).max(initial=0.0))
    columns = slice(POSITION_WIDTH, space.arm_width)
    rest = np.delete(first - second, np.r_[columns], axis=1)
    turn = decode_rotation(first[:, columns], space) * decode_rotation(second[:, columns], space).inv()
    return float(max(np.abs(rest).max(initial=0.0), turn.magnitude().max(initial=0.0)))


TOLERANCE = 1e-8
PAIRS = st.tuples(draw_pair(), st.integers(1, 12), st.integers(0, 2**32 - 1))


def differentiate(rows, before, space):
    """Changes from row to row."""
    known = np.concatenate((before[None], rows))
    linear = space.arm_width if space.representation == "joint_position" else POSITION_WIDTH
    out = rows.copy()
    out[:, :linear] = np.diff(known[:, :linear], axis=0)
    if space.representation == "tool_pose":
        turns = decode_rotation(known[:, POSITION_WIDTH : space.arm_width], space)
        out[:, POSITION_WIDTH : space.arm_width] = encode_rotation(turns[1:] * turns[:-1].inv(), space)
    return out


def check_link(link, count, rng):
    """The property of one bridge."""
    before = draw_rows(link.target, 1, rng)[0]
    rows = draw_rows(link.source, count, rng)
    converted = link.apply(rows, before)
    assert converted.shape[1] == link.target.width
    assert np.isfinite(converted).all()
    if isinstance(link, ResampleBridge):
        assert np.array_equal(converted[link.rises - 1 :: link.rises], rows[link.falls - 1 :: link.falls])
    elif isinstance(link, ToAbsoluteBridge):
        assert measure_distance(link.source, differentiate(converted, before, link.source), rows) < TOLERANCE
    elif isinstance(link, ClampBridge | ProjectionBridge):
        assert measure_distance(link.target, link.apply(link.invert(converted), before), converted) < TOLERANCE
    else:
        assert measure_distance(link.source, link.invert(converted), rows) < TOLERANCE


PAIRED = {kind for kind in list_bridges() if kind is not ToolPoseBridge}  # which needs an arm: test_tool_poses.py


@pytest.mark.slow
def test_every_bridge_of_any_chain_is_undone_or_is_a_projection_and_is_needed_by_some_pair_of_spaces():
    found = Counter()

    @given(PAIRS)
    @settings(max_examples=300, deadline=None, database=None, derandomize=True)
    def check(drawn):
        (source, target), count, seed = drawn
        chain = compile_chain(source, target, FRAMES)
        assert isinstance(chain, BridgeChain), chain
        for link in chain.links:
            check_link(link, count, np.random.default_rng(seed))
            found[type(link)] += 1

    check()
    assert {kind for kind, links in found.items() if links >= 20} >= PAIRED, "draw_pair never needs them"


@pytest.mark.slow
@given(PAIRS)
@settings(max_examples=75, deadline=None)
def test_a_whole_chain_speaks_the_targets_language_and_its_set_point_leads_back(drawn):
    (source, target), count, seed = drawn
    rng = np.random.default_rng(seed)
    chain = compile_chain(source, target, FRAMES)
    before = draw_rows(target, 1, rng)[0]
    rows = draw_rows(source, count, rng)
    bridged = chain.apply(rows, before)
    expected = int(count / source.rate_hz * target.rate_hz + 1e-9)
    if not expected:
        assert bridged.code is ViolationCode.WRONG_SHAPE
        return
    assert isinstance(bridged, Bridged)
    assert len(bridged.rows) == expected
    assert bridged.rows.shape[1] == target.width
    if not any(isinstance(link, ClampBridge | ProjectionBridge | ToAbsoluteBridge) for link in chain.links):
        there, back = before, before
        for link in reversed(chain.links):
            back = link.invert(back[None])[0]
        for link in chain.links:
            back = link.apply(back[None], there)[-1] if not isinstance(link, ResampleBridge) else back
        assert measure_distance(target, back[None], there[None]) < 1e-6
    assert bool(bridged.interventions) <= source.clamp


MIRROR = """
from phyagentos.runtime.actions.bridges.columns import ProjectionBridge


class Mirror(ProjectionBridge):
    BEFORE = "gripper"
"""


def test_a_bridge_of_another_package_takes_the_place_that_it_names(monkeypatch, tmp_path):
    install(tmp_path, "mirror", MIRROR, {"phyagentos.bridges": {"mirror": "mirror:Mirror"}})
    monkeypatch.syspath_prepend(tmp_path)

    names = [kind.__name__ for kind in list_bridges()]
    assert names[names.index("Mirror") + 1] == "GripperBridge"
    assert names[-1] == "ClampBridge"
