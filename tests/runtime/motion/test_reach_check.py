"""Whether anything of a goal can be grasped at all, asked before a run."""

import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.trees import read_tree
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.execution.leaf_registry import read_registry
from phyagentos.runtime.execution.tree_check import needs_grasp
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


def test_a_run_is_refused_where_all_objects_are_wider_than_the_hand_opens():
    profile = read_profile(file := Library.open().get_target("panda"))[0]
    narrow = profile.model_copy(update={"gripper": profile.gripper.model_copy(update={"max_width_m": 0.03})})
    scene = read_scene(Library.open().get_scene("tabletop/cubes_and_trays"))
    (problem,) = find_out_of_reach(narrow, file, scene, {"red_cube"}, 1)
    assert problem.code == "NOT_GRASPABLE"
    assert "red_cube is wider than the gripper opens (0.03 m)" in problem.found


@pytest.mark.parametrize(
    ("tree", "grasps"),
    [("pick", True), ("pick_and_place", True), ("stack", True), ("push", False), ("inspect", False), ("take_it", True)],
)
def test_a_tree_needs_a_grasp_by_the_role_of_its_leaves_whatever_it_is_called(tmp_path, tree, grasps):
    (tmp_path / "trees").mkdir()
    (tmp_path / "trees" / "take_it.yaml").write_text(
        "tree: take_it\ndescription: Take it.\nroot: {subtree: {tree: take}}\n"
    )
    library = Library.open(tmp_path)
    assert needs_grasp(read_tree(library.get_tree(tree)).root, library, read_registry(library)) is grasps
