"""What a skill would lift is held against what the arm carries."""

import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.world.body_shapes import Solid
from phyagentos.protocol.world.scenes import Body, Contents, Inside, Joint, SceneSpec
from phyagentos.runtime.preflight.needs import iter_payload_problems

PROFILE = read_target(find_shipped_root() / "robots" / "panda" / "target.yaml")
HOLLOW = Inside(center_m=(0.0, 0.0, 0.0), half_m=(0.05, 0.05, 0.05))
SHOT = Contents(count=20, radius_m=0.01, mass_kg=0.02, material="lead")
SLIDE = Joint(kind="slide", axis=(1.0, 0.0, 0.0), travel=0.1)
SKILL = SkillRuntime(skill="pick", description="d", tree="pick")


def make_body(**facts) -> Body:
    return Body(kind="thing", shapes=(Solid(kind="box", size_m=(0.1, 0.1, 0.1)),), **facts)


@pytest.mark.parametrize(
    ("bodies", "found"),
    [
        ({"handle": make_body(mass_kg=2.2)}, []),
        ({"handle": make_body(mass_kg=2.3)}, ["up to 2.3 kg"]),  # the hand of 0.73 kg is a part of the load of 3 kg
        ({"handle": make_body(mass_kg=3.1)}, ["up to 3.1 kg"]),
        ({"handle": make_body(mass_kg=0.1, mass_span_kg=(0.1, 4.0))}, ["up to 4 kg"]),
        ({"pot": make_body(mass_kg=3.0), "handle": make_body(mass_kg=0.5, part_of="pot")}, ["up to 3.5 kg"]),
        ({"handle": make_body(mass_kg=2.0), "lid": make_body(mass_kg=2.0, part_of="handle")}, ["up to 4 kg"]),
        ({"handle": make_body(mass_kg=2.0, interior=HOLLOW, contents=SHOT)}, ["up to 2.4 kg"]),
        ({"drawer": make_body(mass_kg=9.0, joint=SLIDE), "handle": make_body(part_of="drawer")}, []),
        ({"handle": make_body(mass_kg=9.0, fixed=True)}, []),
        ({"other": make_body(mass_kg=9.0)}, []),
        ({"handle": make_body(mass_kg=2.0, grip_span=(0.05, 0.14))}, ["at least 19.6 N of weight"]),
        ({"handle": make_body(mass_kg=2.0, mass_span_kg=(1.1, 2.0), grip_span=(0.05, 0.14))}, []),
        ({"handle": make_body(mass_kg=2.0, grip_span=(0.05, 0.14), interior=HOLLOW)}, []),
        (
            {"pot": make_body(mass_kg=1.5), "handle": make_body(mass_kg=0.5, part_of="pot", grip_span=(0.1, 0.2))},
            ["at least 19.6 N of weight"],
        ),
    ],
)
def test_what_may_weigh_more_than_the_arm_carries_is_refused(bodies, found):
    spec = SceneSpec(scene="s", bodies=bodies, cameras={})
    problems = list(iter_payload_problems(["handle"], SKILL, spec, PROFILE))

    assert [problem.found for problem in problems] == found
    assert {problem.code for problem in problems} <= {"NOT_GRASPABLE"}
