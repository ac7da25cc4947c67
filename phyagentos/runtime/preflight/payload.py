"""What a skill would lift against what the arm carries.

Upstream: the tree's grasps, the scene's inventory, the profile. Downstream: `examination`. Perception tells no weight;
the inventory declares it, and where it declares a span, the greatest counts.
"""

from collections.abc import Iterable, Iterator, Mapping

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.scenes import Body, SceneSpec
from phyagentos.runtime.preflight.findings import make_problem


def iter_payload_problems(
    grasped: Iterable[str], skill: SkillRuntime, spec: SceneSpec, profile: TargetProfile
) -> Iterator[Problem]:
    """Things that may weigh more than the arm carries, of those that the skill surely takes hold of."""
    carried_kg = profile.arm.payload_kg
    for name in grasped:
        load_kg = _compute_load_kg(name, spec.bodies) if name in spec.bodies else 0.0
        if load_kg > carried_kg:
            yield make_problem(
                "TOO_HEAVY",
                f"scene {spec.scene}: bodies.{name}.mass_kg",
                f"up to {load_kg:g} kg",
                f"at most {carried_kg:g} kg",
                triggered_by=f"skill {skill.skill}: its grasp",
                fix=f"Choose another thing or target; arm.payload_kg says what {profile.target} carries.",
            )


def _compute_load_kg(name: str, bodies: Mapping[str, Body]) -> float:
    """The greatest weight of a thing with all that is fixed to it; nothing of what stands fixed or runs in a joint."""
    while (whole := bodies[name].part_of) is not None:
        name = whole
    if bodies[name].fixed or bodies[name].joint is not None:
        return 0.0  # pulled or pushed, never lifted
    return _sum_up_kg(name, bodies)


def _sum_up_kg(name: str, bodies: Mapping[str, Body]) -> float:
    body = bodies[name]
    own_kg = body.mass_span_kg[1] if body.mass_span_kg else body.mass_kg
    return own_kg + sum(_sum_up_kg(part, bodies) for part, each in bodies.items() if each.part_of == name)
