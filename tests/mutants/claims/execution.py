"""Mutants of leaves and of what carries them out: success without a deed, chance that no seed holds."""

from tests.mutants.mutant import Edit, Mutant

MUTANTS = (
    Mutant(
        name="kept_thing_moved_out",
        claim="To make room a session moves out what the goal says must stay.",
        edits=(Edit("phyagentos.runtime.execution.leaves.plan_room", " and each not in session.kept", ""),),
        tests=(
            "tests/runtime/test_preflight_dry_run.py::"
            "test_what_the_tree_moves_out_of_the_destination_is_no_obstacle[more1-False]",
        ),
    ),
    Mutant(
        name="what_comes_is_forgotten",
        claim="A place is called good although what the goal brings there next finds no room beside it.",
        edits=(Edit("phyagentos.runtime.motion.placements", "if space.walled else []", "if False else []"),),
        tests=("tests/runtime/motion/test_placements.py::test_room_is_left_for_what_still_comes",),
    ),
    Mutant(
        name="leaf_always_succeeds",
        claim="`verify_grasp` finds the object between the fingers whatever they touch.",
        edits=(Edit("phyagentos.runtime.execution.leaves.verify_grasp", "if name in held:", "if True:"),),
        tests=("tests/runtime/test_runner.py::test_a_grasp_on_air_fails_with_its_code",),
    ),
    Mutant(
        name="failing_leaf_is_a_success",
        claim="A session whose tree failed is told as completed.",
        edits=(
            Edit(
                "phyagentos.runtime.execution.tree_runtime",
                "if self._tree.root.status is not Status.FAILURE:",
                "if True:",
            ),
        ),
        tests=("tests/runtime/test_runner.py::test_a_grasp_on_air_fails_with_its_code",),
    ),
    Mutant(
        name="seed_ignored",
        claim="A scene is drawn from the noise of the machine instead of its seed.",
        edits=(
            Edit(
                "phyagentos.runtime.models.scene",
                "rng = np.random.default_rng(layout_seed)",
                "rng = np.random.default_rng()",
            ),
        ),
        tests=("tests/runtime/targets/test_scenes.py::test_a_seed_makes_the_scene[tabletop/cubes_and_trays]",),
    ),
    Mutant(
        name="one_seed_for_every_attempt",
        claim="A child draws the very numbers with which its parent failed.",
        edits=(
            Edit(
                "phyagentos.agent.goals.compiler",
                'seed=compute_seed(self.seed, "node", name, "attempt", attempt),\n            limits',
                'seed=compute_seed(self.seed, "node", name, "attempt", 0),\n            limits',
            ),
        ),
        tests=("tests/agent/test_compiler.py::test_every_attempt_has_a_seed_and_an_id_of_its_own",),
    ),
    Mutant(
        name="child_without_parent",
        claim="A child session is compiled as if nothing had gone before it.",
        edits=(Edit("phyagentos.agent.goals.compiler", "parent=revision.parent,", "parent=None,"),),
        tests=("tests/agent/test_compiler.py::test_every_attempt_has_a_seed_and_an_id_of_its_own",),
    ),
    Mutant(
        name="precondition_not_asked",
        claim="A session starts although what it requires does not hold in the world.",
        edits=(
            Edit(
                "phyagentos.runtime.preflight.arguments",
                "texts = [(kind, text) for kind in _CONDITIONS for text",
                'texts = [(kind, text) for kind in ("hold",) for text',
            ),
        ),
        tests=("tests/runtime/test_preflight.py::test_names_and_preconditions_are_judged_on_the_live_world",),
    ),
    Mutant(
        name="joints_not_compared",
        claim="A target with six joints is taken for the one with seven that the profile describes.",
        edits=(
            Edit(
                "phyagentos.runtime.preflight.needs",
                '"n_joints": (live.n_joints, len(profile.arm.joints)),',
                '"n_joints": (live.n_joints, live.n_joints),',
            ),
        ),
        tests=("tests/runtime/test_preflight.py::test_a_live_target_that_is_not_what_it_was_said_to_be_is_refused",),
    ),
    Mutant(
        name="bridge_inverse_wrong",
        claim="Quaternions are written with their real part last where it belongs first.",
        edits=(
            Edit(
                "phyagentos.runtime.actions.bridges.rotations",
                "rotations.as_quat(canonical=True)[:, [3, 0, 1, 2]]",
                "rotations.as_quat(canonical=True)",
            ),
        ),
        tests=(
            "tests/runtime/actions/bridges/test_conformance.py::"
            "test_every_bridge_of_any_chain_is_undone_or_is_a_projection_and_is_needed_by_some_pair_of_spaces",
        ),
    ),
    Mutant(
        name="side_not_asked",
        claim="Any side may fire any event of a session: the agent claims, the runtime gives a verdict.",
        edits=(
            Edit(
                "phyagentos.protocol.sessions.lifecycle",
                "asked.side in sides and ",
                "",
            ),
        ),
        tests=("tests/protocol/test_lifecycle.py::test_every_row_is_refused_to_every_side_that_it_does_not_name",),
    ),
    Mutant(
        name="lifted_from_below",
        claim="A hand with a finger under the plate that it has put down leaves upwards, and takes it along.",
        edits=(
            Edit("phyagentos.runtime.motion.poses", "UP if abs(T[2, 1]) < UNDER_SINE else RISE * UP - T[:3, 2]", "UP"),
        ),
        tests=("tests/runtime/motion/test_grasps.py::test_a_hand_with_a_finger_underneath_leaves_sideways",),
    ),
    Mutant(
        name="old_contact_excuses_new",
        claim="A motion that began in contact may press as hard for as long as it lasts.",
        edits=(
            Edit(
                "phyagentos.runtime.execution.planning",
                "                self._pressed_n = 0.0\n",
                "                pass\n",
            ),
        ),
        tests=(
            "tests/runtime/execution/test_guarded_motion.py::"
            "test_a_guarded_motion_stops_when_the_target_feels_more_than_allowed_and_than_where_it_began",
        ),
    ),
    Mutant(
        name="base_moved_by_hand",
        claim="A base is put where it should be; its wheels turn for show.",
        edits=(
            Edit(
                "phyagentos.runtime.drivers.mujoco.actuation",
                "self._locomotion.control(self._data, *self._goal)",
                "self._locomotion.control(self._data, *self._goal); "
                "self._state.base.write_pose(self._data, self._goal[0])",
            ),
        ),
        tests=("tests/runtime/models/test_bases.py::test_motors_without_torque_move_no_base",),
    ),
    Mutant(
        name="dock_without_heading",
        claim="A base that stands in its bay is docked, wherever it looks.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                "max(off_m / allowed_m, turned_rad / FACING_RAD)",
                "off_m / allowed_m",
            ),
        ),
        tests=("tests/protocol/test_predicate_builtins.py::test_docked_in_a_region_means_within_it_and_headed_as_it",),
    ),
    Mutant(
        name="ground_holds_feet",
        claim="The ground holds a foot as well as it bears it: what would pull is counted on.",
        edits=(Edit("phyagentos.runtime.drivers.mujoco.legs", "shares, _ = nnls(", "shares, *_ = np.linalg.lstsq("),),
        tests=("tests/runtime/targets/test_legs.py::test_forces_of_the_ground_push_within_friction_and_add_up",),
    ),
    Mutant(
        name="lying_is_standing",
        claim="A body that fell stands: only how high its trunk is counts.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.stances",
                "min(1.0 - tilt_rad / UPRIGHT_RAD, (height_m - least_m) / max(least_m, 1e-3))",
                "(height_m - least_m) / max(least_m, 1e-3)",
            ),
        ),
        tests=("tests/protocol/test_postures.py::test_a_body_stands_when_its_trunk_is_upright_and_high_enough",),
    ),
)
