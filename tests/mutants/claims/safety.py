"""Mutants of the guard, of the target's own limits and of authority: what must not move moves."""

from tests.mutants.mutant import Edit, Mutant

GUARD = "phyagentos.runtime.actions.guard"
LIMITS = "phyagentos.runtime.drivers.mujoco.local_limits"
AUTHORITY = "phyagentos.runtime.targets.authority"
SERVED = "phyagentos.runtime.targets.served_target"

MUTANTS = (
    Mutant(
        name="guard_bypassed",
        claim="Commands leave the worker without having been looked at.",
        edits=(
            Edit(
                "phyagentos.runtime.actions.handle",
                "ruling = self._guard.judge(command, now)",
                "ruling = Ruling(command)",
            ),
        ),
        tests=("tests/runtime/test_runner.py::test_a_refused_command_never_reaches_the_wire_and_is_recorded",),
    ),
    Mutant(
        name="velocity_not_checked",
        claim="The guard measures every joint as standing still.",
        edits=(
            Edit(
                GUARD,
                "is_within = found <=",
                "found[VELOCITY] = 0.0; is_within = found <=",
            ),
        ),
        tests=("tests/runtime/actions/test_guard.py::test_any_velocity_above_its_limit_is_refused",),
    ),
    Mutant(
        name="nan_passes",
        claim="The guard asks whether a bound is exceeded, which a number that is none never does.",
        edits=(
            Edit(
                GUARD,
                "is_within = found <= self._bounds",
                "is_within = ~(found > self._bounds)",
            ),
            Edit(
                GUARD,
                "if not (jerk <= self._limits.jerk_sum_max).all():",
                "if (jerk > self._limits.jerk_sum_max).any():",
            ),
        ),
        tests=("tests/runtime/actions/test_guard.py::test_a_single_bad_number_is_refused_as_not_finite",),
    ),
    Mutant(
        name="workspace_without_a_ceiling",
        claim="The guard lets the tool out of its workspace on the far side of each axis.",
        edits=(Edit(GUARD, "if not low <= value <= high:", "if not low <= value:"),),
        tests=(
            "tests/runtime/actions/test_guard.py::test_a_command_out_of_bounds_is_refused_with_its_place_and_number",
        ),
    ),
    Mutant(
        name="target_takes_any_motion",
        claim="The target believes that whoever commands it has checked the motion already.",
        edits=(
            Edit(LIMITS, "broken = self._find_broken(q, qd, held)", 'broken = ""'),
            Edit(LIMITS, "return self._check_place(q[-1], qd[-1])", "return None"),
        ),
        tests=(
            "tests/runtime/targets/test_hostile.py::"
            "test_set_points_that_no_drive_should_follow_are_refused_and_move_nothing",
        ),
    ),
    Mutant(
        name="deadman_off",
        claim="An arm whose client falls silent in mid-motion may be commanded on as if nothing had happened.",
        edits=(Edit(SERVED, "self.note_deadman()", "pass"),),
        tests=(
            "tests/runtime/targets/test_realtime.py::"
            "test_a_stream_that_breaks_off_in_mid_motion_ends_in_a_hold_and_is_not_taken_up_again",
        ),
    ),
    Mutant(
        name="estop_latch_ignored_by_guard",
        claim="The guard takes a latched emergency stop for a released one.",
        edits=(
            Edit(
                GUARD,
                "if self._is_stopped is not None and self._is_stopped():",
                "if self._is_stopped is not None and not self._is_stopped:",
            ),
        ),
        tests=(
            "tests/runtime/actions/test_guard_reactions.py::test_nothing_passes_while_the_emergency_stop_is_latched",
        ),
    ),
    Mutant(
        name="estop_latch_ignored_by_target",
        claim="The target never looks at the latch.",
        edits=(Edit(SERVED, "if not self._is_estopped():", "if True:"),),
        tests=(
            "tests/runtime/targets/test_stop_on_a_full_disk.py::"
            "test_the_arm_is_at_rest_before_the_disk_is_asked_and_nothing_is_accepted_while_it_is_full",
        ),
    ),
    Mutant(
        name="command_after_end",
        claim="A session keeps its authority over the target after its end.",
        edits=(
            Edit(
                AUTHORITY,
                'self._floors[self.session] = self._epoch + 1\n        self.session = ""',
                "self._floors[self.session] = self._epoch + 1",
            ),
        ),
        tests=(
            "tests/conformance/test_target_drivers.py::"
            "test_a_driver_does_what_the_port_promises[debug-asks_for_authority]",
        ),
    ),
    Mutant(
        name="stale_epoch_at_target",
        claim="The target obeys a worker whose claim has been replaced.",
        edits=(Edit(AUTHORITY, "if epoch != self._epoch:", "if False:"),),
        tests=(
            "tests/conformance/test_target_drivers.py::"
            "test_a_driver_does_what_the_port_promises[debug-asks_for_authority]",
        ),
    ),
    Mutant(
        name="stale_epoch_in_journal",
        claim="The journal records what a replaced claimant says.",
        edits=(
            Edit(
                "phyagentos.protocol.sessions.lifecycle",
                "self.token is None or self.token == self.epoch",
                "self.token is None or self.token <= self.epoch",
            ),
        ),
        tests=("tests/store/test_journal.py::test_a_claimant_of_an_earlier_epoch_is_fenced",),
    ),
    Mutant(
        name="fingers_are_always_open",
        claim="The guard judges fingers as if they stood wide open.",
        edits=(
            Edit(
                "phyagentos.runtime.motion.planning_scene",
                "openings_m = [high_m] * SWEEP if high_m <= low_m else _list_openings(low_m, high_m, SWEEP)",
                "openings_m = [self.robot.profile.gripper.max_width_m] * SWEEP",
            ),
        ),
        tests=(
            "tests/runtime/actions/test_collision.py::test_fingers_that_are_closed_pass_where_open_ones_would_touch",
        ),
    ),
    Mutant(
        name="closing_fingers_meet_no_wall",
        claim="A grasp is free when the open fingers are: what they sweep while they close is not looked at.",
        edits=(
            Edit(
                "phyagentos.runtime.motion.approaches",
                "scene.sweep(q_rad, *self.openings_m, tolerate)",
                "scene.sweep(q_rad, self.openings_m[1], self.openings_m[1], tolerate)",
            ),
        ),
        tests=(
            "tests/runtime/motion/test_grasps.py::test_an_object_whose_walls_open_fingers_would_straddle_is_refused",
        ),
    ),
    Mutant(
        name="falls_without_walls",
        claim="An object is let go above a container of which one side is open.",
        edits=(
            Edit(
                "phyagentos.runtime.motion.sites",
                "lowest = min(lowest, _climb(space, walls))",
                "lowest = min(lowest, _climb(space, solids))",
            ),
        ),
        tests=(
            "tests/runtime/motion/test_placements.py::test_nothing_falls_where_it_must_not_or_where_no_wall_keeps_it",
        ),
    ),
    Mutant(
        name="standing_force_excuses_any",
        claim="An arm that began a session in contact may press as hard as it likes.",
        edits=(
            Edit(
                "phyagentos.runtime.drivers.mujoco.joint_controller",
                "self._standing_n = min(self._standing_n, self._force_n)",
                "self._standing_n = max(self._standing_n, self._force_n)",
            ),
        ),
        tests=(
            "tests/runtime/targets/test_hostile.py::"
            "test_an_arm_that_rests_in_contact_may_leave_it_and_may_not_press_harder",
        ),
    ),
    Mutant(
        name="stride_feels_nothing",
        claim="A contact in the middle of a command is felt at its end, if at all.",
        edits=(
            Edit(
                "phyagentos.runtime.drivers.mujoco.joint_controller",
                "row += stride.steps\n            if stride.is_felt:\n                self._feel()",
                "row += stride.steps\n            if stride.is_felt:\n                pass",
            ),
        ),
        tests=(
            "tests/runtime/targets/test_strides.py::"
            "test_a_grasp_and_a_collision_are_the_same_in_strides_and_step_by_step",
        ),
    ),
    Mutant(
        name="announced_way_is_free",
        claim="A motion is admitted although it crosses what another robot has announced.",
        edits=(
            Edit(
                "phyagentos.runtime.drivers.mujoco.inter_robot_collisions",
                "np.vstack((here, self.find_announced(other)))",
                "here[None]",
            ),
        ),
        tests=(
            "tests/runtime/targets/test_inter_robot_collisions.py::"
            "test_of_two_motions_that_cross_that_of_the_first_name_is_admitted_whichever_comes_first[0]",
        ),
    ),
    Mutant(
        name="neighbour_takes_no_room",
        claim="The planner is told of another robot, and plans through it.",
        edits=(
            Edit(
                "phyagentos.runtime.motion.planner", "if each.is_met or not is_choice]", "if each.is_met and is_choice]"
            ),
        ),
        tests=(
            "tests/runtime/motion/test_neighbours.py::"
            "test_a_move_goes_around_the_posture_and_the_announced_way_of_another_robot",
        ),
    ),
    Mutant(
        name="contact_of_robots_untold",
        claim="Two robots touch, and no bundle says so.",
        edits=(Edit("phyagentos.runtime.worker.recorder", "in step.touched_n.items():", "in {}.items():"),),
        tests=("tests/runtime/test_neighbours.py::test_contacts_with_another_robot_are_events_of_the_bundle",),
    ),
)
