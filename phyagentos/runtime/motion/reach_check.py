"""Whether a robot can take hold of any object of a goal at all: checked before a run of a new robot or scene."""

from collections.abc import Collection
from pathlib import Path

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.capabilities.placed_scenes import place_scene
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.models.scene import draw_bodies
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import FindGrasps, NoPlan, World


def find_out_of_reach(
    profile: TargetProfile, file: Path, scene: SceneSpec, objects: Collection[str], seed: int
) -> list[Problem]:
    """Problems where no grasp of any of `objects` has a posture, or all are too wide, with nothing around them."""
    planner = MotionPlanner(profile, file.parent)
    placed = draw_bodies(place_scene(scene, profile.placement), seed)
    entities = [each.as_entity() for each in placed if each.name in objects]
    problems, far = list[Problem](), list[str]()
    for entity in entities:
        world, home = World((entity,)), planner.robot.home_rad
        answer = planner.answer(FindGrasps(world=world, object=entity.name, q_rad=home, seed=seed, count=1))
        if isinstance(answer, NoPlan) and answer.code == "NOT_GRASPABLE":
            hint = "Take smaller objects, or draft the robot anew with another --hand."
            problems.append(Problem(answer.code, str(file), answer.message, "an object that the hand encloses", hint))
        elif isinstance(answer, NoPlan) and answer.code == "NO_IK" and set(answer.rejected) == {"ik"}:
            far.append(entity.name)
        else:
            return []
    problem = Problem(
        "OUT_OF_REACH",
        str(file),
        found=f"no posture for any grasp of {format_names(far)}",
        expected="a tool whose z axis approaches, and objects within reach",
        hint=f"See where it reaches: paos robot try {profile.target}. Then change `tool` or `placement`, or the scene.",
    )
    return [*problems, *([problem] if far else [])]
