"""Preflight finds everything that is wrong before anything moves."""

import math

import msgspec
import pytest

from phyagentos.protocol.capabilities.action_spaces import ActionSpace, GripperRange
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.skill_runtimes import AgentLoop, Needs, Parameter, SkillRuntime
from phyagentos.protocol.predicates.library import PredicateDefinition, get_predicate_library
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.protocol.settings.perception import read_perception
from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.environment import UNNAMED, Entity, Environment, Interior, Pose, Region
from phyagentos.runtime.preflight.arguments import iter_contradictions, iter_name_problems
from phyagentos.runtime.preflight.compatibility import Preflight
from phyagentos.runtime.preflight.settings import Settings
from phyagentos.runtime.targets.wire import WIRE_VERSION, Description, Kinematics

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
ROOT = find_shipped_root()
PROFILE = read_target(ROOT / "robots" / "panda" / "target.yaml")
SETTINGS = Settings(
    limits=read_safety(ROOT / "protocol/safety.yaml").targets["panda"],
    sensors=read_sensors(ROOT / "protocol/sensors.yaml"),
    perception=read_perception(ROOT / "protocol/perception.yaml"),
    contract=read_runtime_contract(ROOT / "protocol/runtime_contract.yaml"),
)

KINEMATICS = Kinematics(axes=((0.0, 0.0, 1.0),) * 7, anchors_m=((0.4, 0.0, 0.4),) * 7, tcp_m=(0.4, 0.0, 0.4))


def make_session(**changes) -> Session:
    facts = {
        "id": "g.a", "goal": "g", "node": "a", "objective": "o", "skill": "pick", "target": "panda",
        "parameters": {"object": "cube"}, "accept": (), "scene": Scene(name="s", seed=0, episode="e"), "seed": 0,
    }  # fmt: skip
    return Session(**{**facts, **changes})


def make_preflight(**needs) -> Preflight:
    skill = SKILL.model_copy(update={"needs": SKILL.needs.model_copy(update=needs)})
    return Preflight(skills={"pick": skill}, profile=PROFILE, settings=SETTINGS)


def describe(**changes) -> Description:
    limits = SETTINGS.limits
    facts = {
        "target": "panda", "n_joints": len(PROFILE.arm.joints), "steps_per_command": 10, "physics_step_s": 0.002,
        "q_min_rad": limits.joint_position_min.value, "q_max_rad": limits.joint_position_max.value,
        "observations": PROFILE.observations, "actions": PROFILE.actions, "cameras": (), "mode": "lockstep",
        "kinematics": KINEMATICS, "gripper_force_n": 70.0, "joints": PROFILE.arm.joints, "version": WIRE_VERSION,
        "driver": "mujoco",
    }  # fmt: skip
    return Description(**{**facts, **changes})


NOW = Environment(
    time_s=1.0, scene="s", episode="e", revision=1, sensing="truth",
    entities={"cube": Entity(name="cube", kind="cube", pose=Pose(), observed_at_s=1.0)},
    regions={"shelf": Region(name="shelf", pose=Pose(), half_m=(0.1, 0.1, 0.1))},
)  # fmt: skip


def codes(problems) -> list[str]:
    return [problem.label for problem in problems]


def test_a_sound_contract_has_no_problem_and_gets_a_plan():
    preflight, session = make_preflight(), make_session()

    assert preflight.find_contract_problems(session) == []
    assert preflight.find_target_problems(session, describe()) == []
    assert preflight.find_world_problems(session, describe(), NOW) == []
    plan, tools = preflight.plan(session, describe())
    assert plan.tree == "pick"
    assert plan.target_adapter == "target_adapter://simulation/panda"
    assert "guard" in plan.action_path
    assert "apply" in tools.expose


@pytest.mark.parametrize(
    ("changes", "code", "text"),
    [
        ({"target": "arm2"}, "UNKNOWN_NAME (target)", "expected panda"),
        ({"skill": "pikc"}, "UNKNOWN_NAME (skill)", "Did you mean 'pick'?"),
        ({"parameters": {}}, "MISSING_VALUE", "parameters.object"),
        ({"parameters": {"object": "cube", "sped": 1}}, "UNKNOWN_NAME (parameter)", "Did you mean 'speed'?"),
        ({"parameters": {"object": 3}}, "INVALID_VALUE", "a name"),
        ({"parameters": {"object": "cube", "speed": "fast"}}, "INVALID_VALUE", "number"),
        ({"parameters": {"object": "cube", "speed": 2.0}}, "INVALID_VALUE", "at most 1.0 m/s"),
        ({"parameters": {"object": "cube", "speed": -1.0}}, "INVALID_VALUE", "at least 0.0 m/s"),
        ({"parameters": {"object": "cube", "speed": True}}, "INVALID_VALUE", "number"),
        ({"parameters": {"object": "cube", "site": [1, 2]}}, "INVALID_VALUE", "three numbers"),
        ({"parameters": {"object": "cube", "style": "below"}}, "INVALID_VALUE", "'top' or 'side'"),
        ({"resources": ("tray",)}, "UNKNOWN_NAME (resource)", "runtime_contract.yaml"),
    ],
)
def test_a_broken_contract_is_told_with_what_would_have_been_possible(changes, code, text):
    problems = make_preflight().find_contract_problems(make_session(**changes))

    assert codes(problems) == [code]
    assert text in str(problems[0])


def test_no_gripper_is_asked_of_a_target_that_has_none():
    told = PROFILE.model_dump(exclude={"gripper"}) | {"end_effector": "none"}
    bare = type(PROFILE).model_validate(told)
    preflight = Preflight(skills={"pick": SKILL}, profile=bare, settings=SETTINGS)

    assert preflight.find_contract_problems(make_session()) == []


def test_all_problems_of_a_contract_are_told_at_once():
    preflight = make_preflight(observations=("lidar",), actions=("torque",), capabilities=("flight",))

    problems = preflight.find_contract_problems(make_session(parameters={"speed": 9}))

    assert codes(problems) == [
        "MISSING_VALUE",
        "INVALID_VALUE",
        "NOT_OFFERED (observation)",
        "NOT_OFFERED (action)",
        "NOT_OFFERED (capability)",
        "OBSERVATION_MISMATCH (missing)",
    ]


@pytest.mark.parametrize(
    "changes", [{"n_joints": 6}, {"physics_step_s": 0.001}, {"steps_per_command": 5}, {"target": "ur5e"}]
)
def test_a_live_target_that_is_not_what_it_was_said_to_be_is_refused(changes):
    problems = make_preflight().find_target_problems(make_session(), describe(**changes))

    assert codes(problems) == ["TARGET_MISMATCH"]
    assert next(iter(changes)) in problems[0].address


@pytest.mark.parametrize(
    ("untold", "code", "text"),
    [
        ({"gripper_force_n": math.nan}, "GRIPPER_FORCE", "whose force the target does not declare"),
        (
            {"kinematics": None},
            "LIMIT_INVALID (unenforceable)",
            "found none described; expected where each of 7 joints brings",
        ),
        ({"joints": ()}, "TARGET_MISMATCH", "target.joints: TARGET_MISMATCH: found (none)"),
        ({"version": 0}, "VERSION_MISMATCH", "found version 0"),
        ({"q_max_rad": (math.nan,) * 7}, "LIMIT_INVALID (too wide)", "joint_position_max[0]"),
    ],
)
def test_a_live_target_that_is_silent_about_itself_passes_no_check(untold, code, text):
    problems = make_preflight().find_target_problems(make_session(), describe(**untold))

    assert set(codes(problems)) == {code}
    assert text in str(problems[0])


@pytest.mark.parametrize("axes", [KINEMATICS.axes[:6], ()])
def test_kinematics_of_another_number_of_joints_are_no_kinematics(axes):
    told = msgspec.structs.replace(KINEMATICS, axes=axes)
    problems = make_preflight().find_target_problems(make_session(), describe(kinematics=told))

    assert codes(problems) == ["LIMIT_INVALID (unenforceable)"]
    assert f"found {len(axes)} axes, 7 anchors" in str(problems[0])


def test_names_and_preconditions_are_judged_on_the_live_world():
    session = make_session(parameters={"object": "cub"}, requires=("visible(cube)", "visible(ghost)", "near(cube"))

    problems = make_preflight().find_world_problems(session, describe(), NOW)

    assert codes(problems) == ["NOT_OBSERVED", "PRECONDITION_UNMET"]
    assert "Did you mean 'cube'?" in problems[0].hint
    assert codes(make_preflight().find_contract_problems(session)) == ["SYNTAX"]


@pytest.mark.parametrize("kind", ["requires", "hold", "accept"])
def test_nothing_moves_for_a_condition_whose_predicate_raises(monkeypatch, kind):
    def measure(_view):
        raise KeyError("gap")

    gap = PredicateDefinition(name="gap", arguments=(), measure=measure)
    monkeypatch.setitem(get_predicate_library()._definitions, "gap", gap)
    session = make_session(**{kind: ("gap()",)})
    (problem,) = make_preflight().find_world_problems(session, describe(), NOW)
    assert (problem.code, problem.address) == ("BROKEN_PYTHON", f"g.a: {kind}")
    assert f"{__file__}:{measure.__code__.co_firstlineno + 1}" in str(problem)


@pytest.mark.parametrize(
    ("promises", "found"),
    [(("visible(${object})",), []), (("holding(target, ${object})",), ["NOT_OBSERVED"]), ((), ["NOT_OBSERVED"])],
)
def test_only_a_skill_that_looks_may_name_what_the_inventory_knows_and_no_look_has_shown(promises, found):
    skill, session = SKILL.model_copy(update={"guarantees": promises}), make_session(parameters={"object": "ghost"})
    now = msgspec.structs.replace(NOW, never_seen=("ghost",))
    assert codes(list(iter_name_problems(session, skill, now, is_fresh=False))) == found


def test_a_rejection_tells_who_asked_for_what_and_what_would_help():
    problem = make_preflight(actions=("torque",)).find_contract_problems(make_session())[0]

    assert msgspec.to_builtins(problem) == {
        "code": "NOT_OFFERED",
        "address": "g.a: skill.needs.actions",
        "found": "'torque'",
        "expected": "gripper_width, joint_position",
        "triggered_by": "skill pick: needs.actions",
        "hint": "Choose a target that offers it; panda does not.",
        "subject": "torque",
        "kind": "action",
    }


def test_conditions_may_name_what_is_gone_once_the_world_has_changed():
    session = make_session(hold=("upright(bottle)",))
    preflight = make_preflight()

    assert codes(preflight.find_world_problems(session, describe(), NOW, is_fresh=True)) == ["NOT_OBSERVED"]
    assert preflight.find_world_problems(session, describe(), NOW, is_fresh=False) == []


def test_what_was_checked_once_for_a_skill_is_told_again_of_every_session():
    preflight = make_preflight(actions=("torque",))

    first, second = (preflight.find_contract_problems(make_session(id=id)) for id in ("g.a", "g.b"))

    assert first[0].address == "g.a: skill.needs.actions"
    assert second[0].address == "g.b: skill.needs.actions"


def test_a_skill_whose_actions_can_be_bridged_gets_the_bridges_into_its_plan():
    space = ActionSpace(
        representation="joint_position",
        joints=tuple(reversed(PROFILE.arm.joints)),
        angle_unit="deg",
        rate_hz=10.0,
        chunk_length=16,
        gripper=GripperRange(closed=1.0, open=0.0),
    )
    preflight = Preflight(
        skills={"pick": SKILL.model_copy(update={"action_space": space})}, profile=PROFILE, settings=SETTINGS
    )
    assert preflight.find_contract_problems(make_session()) == []
    plan, _ = preflight.plan(make_session(), describe())
    assert plan.action_bridges[0] == "units deg->rad"
    assert plan.action_bridges[-1] == "resample 10->50 Hz"


def test_a_skill_whose_actions_cannot_be_bridged_is_rejected_with_every_reason():
    space = ActionSpace(representation="joint_position", joints=("elbow",), rate_hz=7.77777)
    preflight = Preflight(
        skills={"pick": SKILL.model_copy(update={"action_space": space})}, profile=PROFILE, settings=SETTINGS
    )
    problems = preflight.find_contract_problems(make_session())
    assert {problem.label for problem in problems} == {
        "UNKNOWN_NAME (joint)",
        "ACTION_SPACE_MISMATCH (gripper)",
        "ACTION_SPACE_MISMATCH (rate)",
    }
    assert all(problem.address.startswith("g.a: skill.action_space.") for problem in problems)


ALIKE = {
    "cube": Entity(name="cube", kind="cube", pose=Pose(), observed_at_s=1.0, alternatives=("other",)),
    "other": Entity(name="other", kind="cube", pose=Pose((0.3, 0.0, 0.0)), observed_at_s=1.0, alternatives=("cube",)),
}


@pytest.mark.parametrize(
    ("accept", "agreed", "is_refused"),
    [
        (("at(cube, (0.6, 0, 0))",), (), True),
        (("at(cube, (0.6, 0, 0))",), (("cube", "other"),), False),
        (("at(cube, (0.3, 0, 0))",), (), False),  # the other one is there: afterwards both are
        (("count(at(*, (0.6, 0, 0))) >= 1",), (), False),
        (("exists(cube)",), (), False),
    ],
)
def test_a_session_that_asks_which_of_two_alike_objects_is_which_is_refused(accept, agreed, is_refused):
    session = make_session(accept=accept, interchangeable=agreed)
    now = msgspec.structs.replace(NOW, entities=ALIKE)

    problems = make_preflight().find_world_problems(session, describe(), now)

    assert codes(problems) == (["AMBIGUOUS"] if is_refused else [])
    assert all("nothing tells cube and other apart" in problem.found for problem in problems)


@pytest.mark.parametrize(
    ("forms", "code", "text"),
    [
        (("box", "box"), "AMBIGUOUS", "described as 'a red box', and unknown_1: red box; unknown_2: red box"),
        (("box", "box or can"), "AMBIGUOUS", "unknown_2: red box or can"),
        (("box or can", "can"), "NOT_OBSERVED", "and perhaps unknown_1: red box or can"),
        (("can", "ball"), "NOT_OBSERVED", "and unknown_1: red can; unknown_2: red ball"),
        ((), "NOT_OBSERVED", "nothing unnamed"),
    ],
)
def test_a_name_by_description_that_nothing_got_is_refused_with_what_there_is(forms, code, text):
    scene = Scene(name="s", seed=0, episode="e", described={"parcel": "a red box"})
    session = make_session(scene=scene, parameters={"object": "parcel"})
    names = [f"unknown_{number}" for number in (1, 2)]
    objects = [
        Entity(name=n, kind=UNNAMED, pose=Pose(), color="red", form=f) for n, f in zip(names, forms, strict=False)
    ]
    now = msgspec.structs.replace(NOW, entities={each.name: each for each in objects})

    problems = make_preflight().find_world_problems(session, describe(), now)

    assert codes(problems) == [code]
    assert text in problems[0].found


@pytest.mark.parametrize(
    ("accept", "apart"),
    [
        (("inside(cube, left) and inside(cube, tray)",), True),
        (("inside(cube, left)", "inside(cube, tray)"), True),
        (("inside(cube, left)", "inside(ball, tray)"), False),
        (("inside(cube, left) or inside(cube, tray)",), False),
        (("inside(cube, left)", "inside(cube, near_left)"), False),
        (("inside(cube, left)", "inside(cube, nowhere)"), False),
    ],
)
def test_an_object_that_is_wanted_in_two_places_at_once_is_refused(accept, apart):
    half, interior = (0.1, 0.1, 0.1), Interior((0.0, 0.0, 0.05), (0.1, 0.05, 0.05))
    regions = {
        name: Region(name=name, pose=Pose((x, 0.0, 0.0)), half_m=half)
        for name, x in (("left", 0.0), ("near_left", 0.19))
    }
    tray = Entity(name="tray", kind="tray", pose=Pose((0.16, 0.0, 0.0), (0.7071, 0.0, 0.0, 0.7071)), interior=interior)
    now = Environment(
        time_s=0.0, scene="s", episode="e", revision=1, sensing="truth", entities={"tray": tray}, regions=regions
    )
    problems = list(iter_contradictions(make_session(accept=accept), now))

    assert [problem.code for problem in problems] == ["CRITERIA_CONTRADICT"] * apart
    assert all("0.010 m apart" in problem.found for problem in problems)


def make_directed(*tools: str) -> Preflight:
    loop = SkillRuntime(skill="find", description="d", kind="agent_loop", loop=AgentLoop(tools=tools))
    return Preflight(skills={"pick": SKILL, "find": loop}, profile=PROFILE, settings=SETTINGS)


def test_the_tools_of_an_agent_stand_in_its_manifest():
    preflight, session = make_directed("pick"), make_session(skill="find", parameters={})

    assert preflight.find_contract_problems(session) == []
    plan, tools = preflight.plan(session, describe())
    assert plan.agent_tools == ("pick",)
    assert plan.action_path[:2] == ("agent", "guard")
    assert [tool.name for tool in tools.tools][-1] == "pick"
    assert "pick" not in tools.expose


@pytest.mark.parametrize("tool", ["pikc", "find"])
def test_a_tool_that_is_no_skill_with_a_tree_is_refused(tool):
    (problem,) = make_directed(tool).find_contract_problems(make_session(skill="find", parameters={}))
    assert (problem.label, problem.address) == ("UNKNOWN_NAME (skill)", "g.a: skill.loop.tools")


def test_an_agent_may_look_for_what_no_look_has_shown():
    unseen = msgspec.structs.replace(NOW, entities={}, never_seen=("cube",))
    session = make_session(skill="find", parameters={}, accept=("inside(cube, shelf)",))
    assert list(iter_name_problems(session, make_directed("pick").skills["find"], unseen, is_fresh=True)) == []
    assert codes(iter_name_problems(session, SKILL, unseen, is_fresh=True)) == ["NOT_OBSERVED"]
