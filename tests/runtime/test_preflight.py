"""Preflight finds everything that is wrong before anything moves."""

import pytest

from phyagentos.protocol.environment import Entity, Environment, Pose, Region
from phyagentos.protocol.library import find_shipped_root
from phyagentos.protocol.registries import read_target
from phyagentos.protocol.sessions import Scene, Session
from phyagentos.protocol.skill_runtimes import Needs, Parameter, SkillRuntime
from phyagentos.runtime.preflight import Preflight
from phyagentos.runtime.targets.wire import Description

SKILL = SkillRuntime(
    skill="pick",
    description="d",
    tree="pick",
    parameters={
        "object": Parameter(type="entity"),
        "speed": Parameter(type="number", unit="m/s", minimum=0.0, maximum=1.0, optional=True),
        "site": Parameter(type="point", optional=True),
        "style": Parameter(type="string", choices=("top", "side"), optional=True),
    },
    needs=Needs(observations=("entity_poses",), actions=("joint_position",), capabilities=("manipulation",)),
)
PROFILE = read_target(find_shipped_root() / "robots" / "panda" / "target.yaml")


def make_session(**changes) -> Session:
    facts = {
        "id": "g.a", "goal": "g", "node": "a", "objective": "o", "skill": "pick", "target": "panda",
        "parameters": {"object": "cube"}, "accept": (), "scene": Scene(name="s", seed=0, episode="e"), "seed": 0,
    }  # fmt: skip
    return Session(**{**facts, **changes})


def make_preflight(**needs) -> Preflight:
    skill = SKILL.model_copy(update={"needs": SKILL.needs.model_copy(update=needs)})
    return Preflight(skills={"pick": skill}, profile=PROFILE)


def describe(**changes) -> Description:
    n = len(PROFILE.arm.joints)
    facts = {
        "target": "panda", "n_joints": n, "steps_per_command": 10, "physics_step_s": 0.002, "q_min_rad": (-3.0,) * n,
        "q_max_rad": (3.0,) * n, "observations": PROFILE.observations, "actions": PROFILE.actions, "cameras": (),
        "mode": "lockstep",
    }  # fmt: skip
    return Description(**{**facts, **changes})


NOW = Environment(
    time_s=1.0, scene="s", episode="e", revision=1, sensing="truth",
    entities={"cube": Entity(name="cube", kind="cube", pose=Pose(), observed_at_s=1.0)},
    regions={"shelf": Region(name="shelf", pose=Pose(), half_m=(0.1, 0.1, 0.1))},
)  # fmt: skip


def codes(problems) -> list[str]:
    return [problem.code for problem in problems]


def test_a_sound_contract_has_no_problem_and_gets_a_plan():
    preflight, session = make_preflight(), make_session()

    assert preflight.find_contract_problems(session) == []
    assert preflight.find_target_problems(session, describe()) == []
    assert preflight.find_world_problems(session, NOW) == []
    plan, tools = preflight.plan(session, describe())
    assert plan.tree == "pick"
    assert plan.target_adapter == "target_adapter://simulation/panda"
    assert "guard" in plan.action_path
    assert "apply" in tools.expose


@pytest.mark.parametrize(
    ("changes", "code", "text"),
    [
        ({"target": "arm2"}, "TARGET_UNKNOWN", "expected panda"),
        ({"skill": "pikc"}, "UNKNOWN_SKILL", "Did you mean 'pick'?"),
        ({"parameters": {}}, "PARAMETER_MISSING", "parameters.object"),
        ({"parameters": {"object": "cube", "sped": 1}}, "PARAMETER_UNKNOWN", "Did you mean 'speed'?"),
        ({"parameters": {"object": 3}}, "PARAMETER_INVALID", "a name"),
        ({"parameters": {"object": "cube", "speed": "fast"}}, "PARAMETER_INVALID", "number"),
        ({"parameters": {"object": "cube", "speed": 2.0}}, "PARAMETER_INVALID", "at most 1.0 m/s"),
        ({"parameters": {"object": "cube", "speed": -1.0}}, "PARAMETER_INVALID", "at least 0.0 m/s"),
        ({"parameters": {"object": "cube", "speed": True}}, "PARAMETER_INVALID", "number"),
        ({"parameters": {"object": "cube", "site": [1, 2]}}, "PARAMETER_INVALID", "three numbers"),
        ({"parameters": {"object": "cube", "style": "below"}}, "PARAMETER_INVALID", "'top' or 'side'"),
    ],
)
def test_a_broken_contract_is_told_with_what_would_have_been_possible(changes, code, text):
    problems = make_preflight().find_contract_problems(make_session(**changes))

    assert codes(problems) == [code]
    assert text in str(problems[0])


def test_all_problems_of_a_contract_are_told_at_once():
    preflight = make_preflight(observations=("lidar",), actions=("torque",), capabilities=("flight",))

    problems = preflight.find_contract_problems(make_session(parameters={"speed": 9}))

    assert codes(problems) == [
        "OBSERVATION_UNAVAILABLE",
        "ACTION_UNAVAILABLE",
        "CAPABILITY_UNAVAILABLE",
        "PARAMETER_MISSING",
        "PARAMETER_INVALID",
    ]


@pytest.mark.parametrize(
    "changes", [{"n_joints": 6}, {"physics_step_s": 0.001}, {"steps_per_command": 5}, {"target": "ur5e"}]
)
def test_a_live_target_that_is_not_what_it_was_said_to_be_is_refused(changes):
    problems = make_preflight().find_target_problems(make_session(), describe(**changes))

    assert codes(problems) == ["TARGET_MISMATCH"]
    assert next(iter(changes)) in problems[0].address


def test_names_and_preconditions_are_judged_on_the_live_world():
    session = make_session(parameters={"object": "cub"}, requires=("visible(cube)", "visible(ghost)", "near(cube"))

    problems = make_preflight().find_world_problems(session, NOW)

    assert codes(problems)[:2] == ["ENTITY_UNKNOWN", "PRECONDITION_UNMET"]
    assert "Did you mean 'cube'?" in problems[0].hint
    assert len(problems) == 3
