"""Whether anything of a goal can be grasped at all, asked before a run."""

import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.reach_check import find_out_of_reach


@pytest.mark.parametrize(
    ("x_m", "objects", "found"),
    [(0.0, {"red_cube"}, []), (-1.6, {"red_cube", "blue_cube"}, ["OUT_OF_REACH"]), (-1.6, {"no_such_cube"}, [])],
)
def test_only_where_no_object_has_a_grasp_with_a_posture_is_a_run_refused(x_m, objects, found):
    file = Library.open().get_target("panda")
    profile = read_profile(file)[0].model_copy(update={"mount_position_m": (x_m, 0.0, 0.0)})
    scene = read_scene(Library.open().get_scene("tabletop/cubes_and_trays"))
    problems = find_out_of_reach(profile, file, scene, objects, 1)
    assert [each.code for each in problems] == found
    assert all(f"no posture for any grasp of {', '.join(sorted(objects))}" in each.found for each in problems)
