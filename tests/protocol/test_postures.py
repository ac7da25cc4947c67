"""Whether a robot is in a posture that its profile names: by the joints as measured, and within their uncertainty."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.predicates.predicate import iter_entities, iter_postures, parse_predicate
from phyagentos.protocol.world.environment import Pose, TargetState
from phyagentos.protocol.world.truth import Truth
from tests.protocol.predicate_worlds import value, world


def look(*q_rad, std_rad=0.0):
    state = TargetState(
        q_rad=q_rad,
        qd_rad_s=(0.0, 0.0),
        gripper_width_m=0.0,
        tcp=Pose(),
        postures={"fist": (0.5, 1.0)},
        q_std_rad=std_rad,
    )
    return world(targets={"arm": state})


def test_a_posture_is_reached_when_every_measured_joint_is_within_the_tolerance():
    assert value("in_posture(target, fist)", look(0.46, 1.04)).truth is Truth.TRUE
    missed = value("in_posture(arm, fist)", look(0.5, 1.06))
    assert missed.truth is Truth.FALSE
    assert missed.measured == {"joint": 2, "off_rad": pytest.approx(0.06)}
    assert "joint 2 of arm is 3.4° from fist; up to 2.9° is allowed" in missed.because
    assert value("in_posture(arm, fist, 0.1)", look(0.5, 1.06)).truth is Truth.TRUE


def test_what_the_noise_of_the_joints_may_turn_over_is_unknown():
    assert value("in_posture(arm, fist)", look(0.5, 1.045, std_rad=0.001)).truth is Truth.TRUE
    for q_rad in (1.045, 1.055):
        assert value("in_posture(arm, fist)", look(0.5, q_rad, std_rad=0.004)).truth is Truth.UNKNOWN


def test_a_posture_that_a_target_does_not_have_is_unknown_and_says_which_there_are():
    found = value("in_posture(arm, fits)", look(0.5, 1.0))
    assert (found.truth, found.because) == (Truth.UNKNOWN, "arm has no posture 'fits'; it has fist")
    assert value("in_posture(other, fist)", look(0.5, 1.0)).truth is Truth.UNKNOWN
    assert value("in_posture(arm, fist)", look(0.5)).truth is Truth.UNKNOWN  # a joint that was not measured


def test_a_posture_is_no_object_of_the_world_and_passes():
    predicate = parse_predicate("in_posture(arm, fist) and not visible(cube)")
    assert list(iter_entities(predicate)) == ["cube"]
    assert list(iter_postures(predicate.text)) == [("arm", "fist")]
    assert not parse_predicate("in_posture(arm, fist)").is_lasting
    with pytest.raises(DefinitionError, match="posture 'posture'"):
        parse_predicate("in_posture(arm, 3)")


def test_where_a_base_stands_is_no_part_of_a_posture():
    state = TargetState(
        q_rad=(2.0, 0.0, 1.5, 0.5, 1.06),
        qd_rad_s=(0.0,) * 5,
        gripper_width_m=0.0,
        tcp=Pose(),
        postures={"fist": (0.5, 1.0)},
        base=(2.0, 0.0, 1.5),
    )
    found = value("in_posture(walker, fist, 0.1)", world(targets={"walker": state}))
    assert found.truth is Truth.TRUE
    assert found.measured == {"joint": 5, "off_rad": pytest.approx(0.06)}


@pytest.mark.parametrize(
    ("trunk", "truth"),
    [
        (Pose((0.0, 0.0, 0.75), (0.995, 0.0998, 0.0, 0.0)), Truth.TRUE),  # leans by 11.5 degrees
        (Pose((0.0, 0.0, 0.75), (0.985, 0.1726, 0.0, 0.0)), Truth.FALSE),  # by 20 degrees
        (Pose((0.0, 0.0, 0.15), (0.707, 0.0, 0.707, 0.0)), Truth.FALSE),  # lies on its face
        (Pose((0.0, 0.0, 0.45), (1.0, 0.0, 0.0, 0.0)), Truth.FALSE),  # upright, on its knees
        (None, Truth.UNKNOWN),
    ],
)
def test_a_body_stands_when_its_trunk_is_upright_and_high_enough(trunk, truth):
    state = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.0, tcp=Pose(), trunk=trunk)
    assert value("standing(walker, 0.65)", world(targets={"walker": state})).truth is truth
    assert value("standing(other, 0.65)", world(targets={"walker": state})).truth is Truth.UNKNOWN
