"""Mutants of perception and of look-ahead: what only the simulator knows, and pictures of another time."""

from tests.mutants.mutant import Edit, Mutant

BELIEF_TESTS = "tests/runtime/perception/test_belief.py"
FIXED_TESTS = "tests/runtime/perception/test_fixed_objects.py"
UNCHANGED_TESTS = "tests/runtime/perception/test_unchanged_objects.py"
MUG_TEST = f"{UNCHANGED_TESTS}::test_an_open_vessel_is_not_pulled_through_its_walls_and_its_handle_is_where_it_is"

NAMING_TESTS = "tests/runtime/perception/test_naming.py"
EXCHANGE_TESTS = "tests/protocol/test_exchanges.py"

MUTANTS = (
    Mutant(
        name="chance_names_are_facts",
        claim="What is so of one of two objects that nothing tells apart is so of the one that is named.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.evaluation",
                "if _evaluate_each(formula, world).truth is not believed.truth:",
                "if False and world:",
            ),
        ),
        tests=(
            f"{EXCHANGE_TESTS}::test_what_depends_on_the_name_of_one_of_two_alike_objects_is_unknown",
            "tests/agent/test_verifier.py::test_alike_objects_end_a_session_at_once_with_their_names",
        ),
    ),
    Mutant(
        name="costs_without_noise",
        claim="The assignment of least cost decides every name, however little the others cost more.",
        edits=(Edit("phyagentos.runtime.perception.naming", "NOISE_M = 0.0012", "NOISE_M = 0.0"),),
        tests=(
            f"{NAMING_TESTS}::test_costs_that_differ_by_less_than_their_noise_decide_no_name",
            f"{NAMING_TESTS}::test_a_name_that_fits_a_free_cluster_as_well_has_no_place",
        ),
    ),
    Mutant(
        name="old_names_are_known",
        claim="An object that was named by chance once is known by that name from then on.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.association",
                "Match(fit=fitted, points=pieces[index], alternatives=look.believed[name].alternatives)",
                "Match(fit=fitted, points=pieces[index])",
            ),
        ),
        tests=(f"{NAMING_TESTS}::test_a_chance_name_follows_its_object_and_does_not_become_known",),
    ),
    Mutant(
        name="held_by_one_color",
        claim="What the fingers hold shows its own colour alone: pixels of a like colour are another object.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.belief",
                "if c in item.colors or _is_like(inventory, c, item)]",
                "if c in item.colors or (name not in held and _is_like(inventory, c, item))]",
            ),
        ),
        tests=(
            "tests/runtime/perception/test_belief.py::"
            "test_points_on_what_the_fingers_hold_are_no_other_object_of_a_like_color[True-0]",
        ),
    ),
    Mutant(
        name="stray_pixels_are_a_thing",
        claim="An object out of view is where another one shows stray pixels of its colour.",
        edits=(
            Edit("phyagentos.runtime.perception.pieces", "PURE = 0.6", "PURE = 0.0"),
            Edit("phyagentos.runtime.perception.association", "STRAY_SHARE = 0.025, 0.15", "STRAY_SHARE = 0.025, 0.0"),
            Edit("phyagentos.runtime.perception.separate_overlaps", "WITHIN = 0.7", "WITHIN = 7.0"),
        ),
        tests=(f"{NAMING_TESTS}::test_an_object_out_of_view_is_not_on_another_ones_stray_pixels",),
    ),
    Mutant(
        name="closed_on_air_is_held",
        claim="Fingers that press on each other hold whatever was nearest to them.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.grip",
                "if beyond > hand.reach_m or float(high[1] - low[1]) < state.gripper_width_m - WIDTH_M:",
                "if False:",
            ),
        ),
        tests=(f"{BELIEF_TESTS}::test_fingers_that_touch_nothing_known_hold_nothing",),
    ),
    Mutant(
        name="touch_shows_what_is_held",
        claim="An object that was near when both fingers touched something is what they hold.",
        edits=(Edit("phyagentos.protocol.predicates.builtins", "    _demand_grasp(view, entity, state)\n", ""),),
        tests=(
            "tests/protocol/test_predicate_doubt.py::"
            "test_fingers_that_touch_something_near_an_object_do_not_show_that_they_hold_it",
            f"{BELIEF_TESTS}::test_what_the_fingers_hold_is_known_once_it_was_seen_in_the_hand_after_lifting",
        ),
    ),
    Mutant(
        name="boxes_for_shapes",
        claim="A round support ends where the box around it ends.",
        edits=(
            Edit(
                "phyagentos.protocol.world.entity_geometry",
                "past_m = math.hypot(at[0], at[1]) - half[0] if shape.kind is ShapeKind.CYLINDER else max(aside)",
                "past_m = max(aside)",
            ),
        ),
        tests=("tests/protocol/test_predicate_builtins.py::test_a_round_support_ends_where_its_disk_ends",),
    ),
    Mutant(
        name="near_the_top_is_on",
        claim="What hovers a centimetre above a support stands on it.",
        edits=(Edit("phyagentos.protocol.predicates.bearing", "CONTACT_M = 0.002", "CONTACT_M = 0.010"),),
        tests=("tests/protocol/test_predicate_builtins.py::test_the_allowed_gap_is_the_stated_doubt",),
    ),
    Mutant(
        name="one_twin_is_watched",
        claim="What must hold throughout is watched of the believed one of two equal objects alone.",
        edits=(
            Edit(
                "phyagentos.runtime.execution.holds",
                "named.union(*(group for group in find_groups(initial) if group & named))",
                "named",
            ),
        ),
        tests=(
            "tests/runtime/execution/test_holds.py::"
            "test_the_twin_of_what_is_named_is_looked_at_too_since_it_may_be_the_one_that_is_meant",
        ),
    ),
    Mutant(
        name="on_through_another",
        claim="What stands on a plate stands on whatever is below the plate.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                "find_between(view, a, b, top.point_m[2], gap_m + allowed_m) if is_near else None",
                "None",
            ),
        ),
        tests=(
            "tests/protocol/test_predicate_builtins.py::"
            "test_what_stands_on_something_that_stands_on_it_is_above_and_not_on",
        ),
    ),
    Mutant(
        name="rolling_is_at_rest",
        claim="Where an object is while it moves is where it stays.",
        edits=(Edit("phyagentos.protocol.predicates.evaluation", "    if definition.at_rest:\n", "    if False:\n"),),
        tests=(
            "tests/protocol/test_predicate_builtins.py::"
            "test_a_lasting_fact_about_an_object_that_moves_is_unknown_until_it_rests",
            f"{BELIEF_TESTS}::test_what_rolls_is_known_to_rest_once_two_looks_show_it_in_one_place",
        ),
    ),
    Mutant(
        name="one_look_shows_rest",
        claim="An object that one look shows somewhere else has come to rest there.",
        edits=(
            Edit("phyagentos.runtime.perception.belief", "speed, since_s = 0.0, time_s", "speed, since_s = 0.0, 0.0"),
        ),
        tests=(f"{BELIEF_TESTS}::test_what_rolls_is_known_to_rest_once_two_looks_show_it_in_one_place",),
    ),
    Mutant(
        name="end_does_not_wait",
        claim="The last look is taken while objects still roll.",
        edits=(Edit("phyagentos.runtime.worker.runner", "LOOK_ON_S = 2.0", "LOOK_ON_S = 0.0"),),
        tests=(
            "tests/runtime/test_runner.py::"
            "test_the_look_at_the_end_waits_a_while_for_what_the_acceptance_speaks_of_to_rest",
        ),
    ),
    Mutant(
        name="silence_keeps_facts_young",
        claim="A look for which no camera answered shows what the look before showed.",
        edits=(Edit("phyagentos.runtime.perception.pipeline", "lose_sight(felt, look.focus)", "felt"),),
        tests=(f"{BELIEF_TESTS}::test_a_look_of_silent_cameras_leaves_everything_that_moves_hidden",),
    ),
    Mutant(
        name="unseen_is_nowhere",
        claim="What no look has shown is none of the objects that `*` stands for.",
        edits=(Edit("phyagentos.protocol.world.environment", ", *self.never_seen]", "]"),),
        tests=(
            "tests/protocol/test_predicates.py::"
            "test_a_star_ranges_over_the_inventory_and_what_no_look_has_shown_is_unknown",
        ),
    ),
    Mutant(
        name="truth_leaks",
        claim="Perceived sensing takes over what the simulator says is held.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.pipeline",
                "return msgspec.structs.replace(state, holding=held)",
                "return state",
            ),
        ),
        tests=(f"{BELIEF_TESTS}::test_names_that_the_simulator_puts_into_the_state_are_not_believed",),
    ),
    Mutant(
        name="twins_swapped",
        claim="Of two equal cubes each is taken for the other.",
        edits=(
            Edit("phyagentos.runtime.perception.association", "        matches |= tracked\n", "        tracked = {}\n"),
            Edit(
                "phyagentos.runtime.perception.association",
                "item = group[row]\n        if (row, column)",
                "item = group[len(group) - 1 - row]\n        if (row, column)",
            ),
        ),
        tests=(f"{BELIEF_TESTS}::test_two_identical_cubes_ten_centimetres_apart_stay_two",),
    ),
    Mutant(
        name="frozen_picture_is_fresh",
        claim="The same picture with a new stamp is a new picture.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.sensor_health",
                'if was is None:\n        return "live", ""',
                'if True:\n        return "live", ""',
            ),
        ),
        tests=(f"{BELIEF_TESTS}::test_a_frozen_picture_with_new_stamps_is_noticed_and_its_facts_age",),
    ),
    Mutant(
        name="still_picture_of_a_moving_arm_is_live",
        claim="A camera without noise that shows the arm where it was is live.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.sensor_health",
                "return _count_absent(view, robot, state) > _count_absent(view, robot, then) + SAMPLES",
                "return not view",
            ),
        ),
        tests=(
            "tests/runtime/perception/test_sensor_health.py::"
            "test_without_noise_a_frozen_picture_is_told_by_the_motion_of_the_arm_and_a_still_scene_is_no_such",
        ),
    ),
    Mutant(
        name="map_without_error",
        claim="What objects stand on is where the scene file has it, whatever depth shows.",
        edits=(
            Edit("phyagentos.runtime.perception.supports", "CONTRADICTED, AGREED = 4.0", "CONTRADICTED, AGREED = 1e9"),
        ),
        tests=(
            "tests/runtime/perception/test_supports.py::"
            "test_a_table_that_is_lower_or_leans_is_measured_and_so_is_what_stands_on_it[none--0.01-0.0]",
        ),
    ),
    Mutant(
        name="glance_confirms_blindly",
        claim="A glance that does not show an object where it is believed confirms it there.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.pipeline",
                "            else:\n                return None\n",
                "            else:\n"
                "                seen[name] = msgspec.structs.replace(entity, observed_at_s=time_s)\n",
            ),
        ),
        tests=(
            "tests/runtime/perception/test_confirmation.py::"
            "test_what_is_not_there_any_more_is_not_believed_after_the_next_glance",
        ),
    ),
    Mutant(
        name="frames_are_kept_roughly",
        claim="Evidence keeps depths to the centimetre, which look the same and judge otherwise.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.look_file",
                "np.save(data, array)",
                "np.save(data, np.round(array, 2))",
            ),
        ),
        tests=(
            "tests/runtime/perception/test_looks.py::"
            "test_pictures_and_depths_come_back_bit_for_bit_and_the_file_depends_on_the_look_alone",
        ),
    ),
    Mutant(
        name="judged_again_on_the_record",
        claim="A verdict that is formed again from frames is formed from the recorded snapshot.",
        edits=(
            Edit(
                "phyagentos.agent.judging.review",
                "before=before, after=snapshots.get(LookRole.END)",
                "before=before",
            ),
        ),
        tests=(
            "tests/agent/test_from_frames.py::"
            "test_an_object_that_is_perceived_elsewhere_changes_acceptance_verdict_and_snapshot",
        ),
    ),
    Mutant(
        name="clocks_of_a_bag_agree",
        claim="Every clock of a bag is that of the joint states: old pictures with stamps of now count.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.bag_looks", 'return says if abs(off_s) > allowed_s else ""', 'return ""'
            ),
        ),
        tests=("tests/runtime/perception/test_bag_verdicts.py::test_old_pictures_with_stamps_of_now_are_not_believed",),
    ),
    Mutant(
        name="any_frame_is_the_scenes",
        claim="A tray that fits nowhere near its place is where a bag's cameras, set aside, make it out.",
        edits=(
            Edit(
                "phyagentos.operations.verify_bag",
                "            for each in astray\n",
                "            for each in ()\n",
            ),
        ),
        tests=(
            "tests/runtime/perception/test_bag_verdicts.py::"
            "test_cameras_in_another_frame_than_the_scenes_decide_nothing[4-off_m0]",
        ),
    ),
    Mutant(
        name="fingers_of_a_bag_are_open",
        claim="What a bag shows between the fingers was let go.",
        edits=(
            Edit("phyagentos.operations.verify_bag", "if each.name == found.between_fingers)", "if not each.name)"),
        ),
        tests=("tests/runtime/perception/test_bag_verdicts.py::test_an_object_between_the_fingers_may_be_held",),
    ),
    Mutant(
        name="one_look_at_a_bag_shows_rest",
        claim="An object that one look alone shows rests.",
        edits=(Edit("phyagentos.operations.verify_bag", "each.still_since_s is None)", "each.still_since_s == -1)"),),
        tests=("tests/runtime/perception/test_bag_verdicts.py::test_one_look_does_not_show_that_an_object_rests",),
    ),
    Mutant(
        name="lookahead_reads_true_friction",
        claim="The imagined world is drawn with the weight and the friction that the true one has.",
        edits=(
            Edit(
                "rollout_forecaster.estimate",
                '            "mass_span_kg": body.mass_span_kg and _center(body.mass_span_kg),\n'
                '            "grip_span": body.grip_span and _center(body.grip_span),\n',
                "",
            ),
        ),
        tests=(
            "tests/runtime/lookahead/test_forecast.py::"
            "test_the_imagined_world_is_the_same_whatever_the_true_one_weighs",
        ),
    ),
    Mutant(
        name="a_force_without_error",
        claim="A contact force is exact: what is measured at the bound decides.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                'uncertainty = view.metrics.get(f"{name}_error", 0.0)',
                "uncertainty = 0.0",
            ),
        ),
        tests=("tests/protocol/test_predicate_doubt.py::test_a_metric_with_an_error_is_unknown_near_its_bound",),
    ),
    Mutant(
        name="an_ideal_world_is_not_told",
        claim="A verdict does not say what of its world was simpler than reality.",
        edits=(
            Edit(
                "phyagentos.agent.judging.verifier",
                "            idealisations=bundle.execution.idealisations,\n",
                "",
            ),
        ),
        tests=("tests/agent/test_verifier.py::test_a_verdict_names_what_was_idealised_in_its_evidence",),
    ),
    Mutant(
        name="furniture_where_it_is_drawn",
        claim="A fixed body of an area stands in the middle of it.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.fixed_objects",
                "is_searched = max(reach[:2]) > SEARCH_M or item.yaw_span_rad > SEARCH_RAD",
                "is_searched = False",
            ),
        ),
        tests=(f"{FIXED_TESTS}::test_fixed_bodies_of_an_area_and_of_a_frame_are_found_within_their_stated_doubt[1]",),
    ),
    Mutant(
        name="furniture_without_doubt",
        claim="A fixed body stands exactly where it was measured.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                'if each is not None and (each.position_std_m or (each.movable and view.now.sensing != "truth"))',
                'if each is not None and each.movable and (each.position_std_m or view.now.sensing != "truth")',
            ),
        ),
        tests=("tests/protocol/test_predicate_doubt.py::test_a_fixed_object_that_was_measured_has_a_doubt",),
    ),
    Mutant(
        name="leaning_is_upright",
        claim="What leans by less than half a right angle is told as upright, with the uncertainty of its noise alone.",
        edits=(
            Edit("phyagentos.runtime.perception.pose_uncertainty", "UPRIGHT_STDS = 3.0", "UPRIGHT_STDS = 30.0"),
            Edit(
                "phyagentos.runtime.perception.belief",
                "tilt_std_rad=math.hypot(turn_rad, *lean, other_rad / 2)",
                "tilt_std_rad=turn_rad",
            ),
        ),
        tests=(f"{UNCHANGED_TESTS}::test_a_small_object_that_leans_is_not_walked_upright_by_looking_again[7.6]",),
    ),
    Mutant(
        name="other_pose_forgotten",
        claim="That another pose explained an object as well is forgotten with the next look, whatever that shows.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.belief",
                "other_rad if _shows_more(evidence, entity.evidence) else max(other_rad, kept_rad)",
                "other_rad",
            ),
        ),
        tests=(
            f"{UNCHANGED_TESTS}::"
            "test_what_another_pose_explained_as_well_is_excluded_by_a_look_that_shows_more_and_by_no_other",
        ),
    ),
    Mutant(
        name="looks_wear_errors_away",
        claim="Each look at an unchanged object halves what its pose may be off.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.pose_uncertainty",
                "fused: Array = np.maximum(np.sqrt(square), least)",
                "fused: Array = before / 2.0",
            ),
        ),
        tests=(f"{UNCHANGED_TESTS}::test_a_small_object_that_leans_is_not_walked_upright_by_looking_again[7.6]",),
    ),
    Mutant(
        name="points_on_hidden_faces",
        claim="A point belongs to the nearest face, though no camera sees it: the back of a thin wall.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.fitting",
                "solids.measure_seen((self.points_m - position_m) @ rotation, self.towards @ rotation)",
                "solids.measure_with_gradient((self.points_m - position_m) @ rotation)",
            ),
        ),
        tests=(MUG_TEST,),
    ),
    Mutant(
        name="half_of_all_turns",
        claim="Half a turn leaves every form as it was.",
        edits=(Edit("phyagentos.runtime.perception.fitting", "else 4 * quarter", "else 2 * quarter"),),
        tests=(MUG_TEST,),
    ),
    Mutant(
        name="strangers_are_air",
        claim="Where no object of the inventory was found there is nothing.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.unknown_objects",
                "fit_box(points[cluster], noise_m, map_solids, named) if len(cluster) >= POINTS_MIN else None",
                "None",
            ),
        ),
        tests=(
            "tests/runtime/perception/test_unknown_objects.py::"
            "test_an_object_outside_the_inventory_is_an_unnamed_box_where_it_is_until_it_is_gone[wood]",
        ),
    ),
    Mutant(
        name="two_in_one_place",
        claim="Two objects that are alike are where a picture shows one of them in parts.",
        edits=(Edit("phyagentos.runtime.perception.separate_overlaps", "WITHIN = 0.7", "WITHIN = 7.0"),),
        tests=(
            "tests/runtime/perception/test_possible_poses.py::"
            "test_two_objects_are_not_in_one_place_when_a_picture_shows_one_of_them_in_parts",
        ),
    ),
    Mutant(
        name="guesses_are_facts",
        claim="A pose that hardly fits what was seen is where the object is.",
        edits=(Edit("phyagentos.protocol.world.environment", "SURE = 0.65", "SURE = 0.0"),),
        tests=("tests/protocol/test_predicate_doubt.py::test_a_pose_that_hardly_fits_is_no_fact_until_another_look",),
    ),
    Mutant(
        name="cameras_never_move",
        claim="Every camera stands where it says.",
        edits=(Edit("phyagentos.runtime.perception.sensor_health", "TIMES = 0.005, 2.5", "TIMES = 1.0, 2.5"),),
        tests=(
            "tests/runtime/perception/test_displacement.py::"
            "test_a_camera_that_is_shifted_is_displaced_and_objects_are_where_the_others_see_them",
        ),
    ),
    Mutant(
        name="one_side_is_another",
        claim="An object that is nearly square was turned by a quarter where its measurement says so.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                "else compute_least_turn(a, was, uncertainty_m)",
                "else turned_rad",
            ),
        ),
        tests=("tests/protocol/test_predicate_doubt.py::test_a_quarter_turn_of_what_is_nearly_square_is_not_known",),
    ),
    Mutant(
        name="low_forecast_starts",
        claim="A session that its look-ahead expects to fail is let through.",
        edits=(Edit("phyagentos.runtime.lookahead.gate", "if not result.is_low:", "if result:"),),
        tests=(
            "tests/runtime/lookahead/test_gate.py::"
            "test_a_low_forecast_refuses_with_cause_and_remedy_and_leaves_its_evidence",
        ),
    ),
    Mutant(
        name="planner_sees_no_wall",
        claim="Every posture is free, whatever the arm would run into.",
        edits=(Edit("phyagentos.runtime.motion.planning_scene", "return self._data.ncon == 0", "return True"),),
        tests=(
            "tests/runtime/motion/test_planner.py::test_goals_inside_a_wall_are_refused_with_the_pair_that_touches",
        ),
    ),
    Mutant(
        name="lightly_held_is_let_go",
        claim="An object between fingers that hardly press is told as let go of.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                "between_m > width_m - WIDTH_M - uncertainty_m",
                "False",
            ),
        ),
        tests=(
            "tests/protocol/test_predicate_doubt.py::"
            "test_fingers_as_far_apart_as_an_object_between_them_is_wide_may_still_hold_it[0.041-0.0-unknown]",
        ),
    ),
    Mutant(
        name="flat_as_stated",
        claim="The lowest point of an object that pixels show leaning is that of the pose rounded to lie flat.",
        edits=(Edit("phyagentos.protocol.predicates.builtins", " + _find_low_uncertainty(a, up)", ""),),
        tests=(
            "tests/protocol/test_predicate_doubt.py::"
            "test_the_lowest_point_of_what_is_stated_to_lie_flat_is_as_doubtful_as_that[0.25-unknown]",
        ),
    ),
    Mutant(
        name="stray_of_what_stays",
        claim="An object in plain view is placed on a few stray pixels of another one of its colour, which stays.",
        edits=(Edit("phyagentos.runtime.perception.association", "    own += known\n", ""),),
        tests=(
            "tests/runtime/perception/test_naming.py::"
            "test_an_object_in_view_is_not_thought_to_be_on_stray_pixels_of_one_that_stays",
        ),
    ),
    Mutant(
        name="few_pixels_show_a_turn",
        claim="A small cube that two looks of few pixels show at two angles has moved.",
        edits=(Edit("phyagentos.protocol.predicates.builtins", "COARSE_FACTOR if", "1.0 if"),),
        tests=("tests/protocol/test_predicate_doubt.py::test_a_turn_that_few_pixels_show_is_no_turn[0.1-unknown]",),
    ),
    Mutant(
        name="covered_slides_up",
        claim="What is almost covered is believed within its cover, as the pixels of its rim fit best.",
        edits=(Edit("phyagentos.runtime.perception.separate_overlaps", "if name in priors and", "if False and"),),
        tests=(
            "tests/runtime/perception/test_possible_poses.py::"
            "test_what_is_almost_covered_stays_where_it_was_and_does_not_slide_into_its_cover[True]",
        ),
    ),
    Mutant(
        name="diverged_world_begins_anew",
        claim="A simulation that became unstable goes on as if nothing had happened.",
        edits=(
            Edit(
                "phyagentos.runtime.drivers.mujoco.queries",
                "if not np.isfinite(self._data.qpos).all():",
                "if False:",
            ),
        ),
        tests=("tests/runtime/targets/test_world.py::test_a_simulation_that_diverges_is_told_and_does_not_begin_anew",),
    ),
    Mutant(
        name="pads_meet_an_edge",
        claim="A grasp counts as good although the pads meet no more than the edge of an object.",
        edits=(Edit("phyagentos.runtime.motion.pad_contacts", "-min(int(meets[index]), ENOUGH)", "0"),),
        tests=(
            "tests/runtime/motion/test_grasps.py::"
            "test_a_tall_bottle_is_closed_on_by_more_than_the_edge_of_its_body[0.038]",
        ),
    ),
)
