"""Mutants about what was achieved: of the verifier, of its judges, of the evidence before them and of the mission."""

from tests.mutants.mutant import Edit, Mutant

VERIFIER = "phyagentos.agent.judging.verifier"
EVIDENCE = "phyagentos.protocol.sessions.evidence"
SHOWN = "tests/agent/test_verifier.py::test_only_what_evidence_shows_is_accepted_and_what_is_missing_is_named"
OBSERVED = "tests/agent/test_mission.py::test_a_goal_ends_by_what_was_observed_of_it_and_says_why"

MUTANTS = (
    Mutant(
        name="an_edge_is_a_foot",
        claim="What leans on a bar, its edge on the tray, is on the tray.",
        edits=(Edit("phyagentos.protocol.predicates.builtins", "    leans = is_near and ", "    leans = False and "),),
        tests=(
            "tests/protocol/test_predicate_doubt.py::"
            "test_what_leans_on_something_else_may_not_be_on_what_its_edge_touches",
        ),
    ),
    Mutant(
        name="hung_is_put_down",
        claim="What hangs on closed fingers is where it was to be set down.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                "if between_m is None and is_within",
                "if False and is_within",
            ),
        ),
        tests=(
            "tests/protocol/test_predicate_doubt.py::test_what_may_hang_on_the_closed_fingers_within_it_is_nowhere_yet",
        ),
    ),
    Mutant(
        name="verifier_always_success",
        claim="Whatever the criteria say, the verdict is success.",
        edits=(
            Edit(
                VERIFIER,
                "if decisive and all(criterion.truth is Truth.TRUE for criterion in decisive):",
                "if decisive:",
            ),
        ),
        tests=(f"{SHOWN}[fingers that closed on air are a missed grasp although the skill completed]",),
    ),
    Mutant(
        name="unknown_counted_as_true",
        claim="What nobody could see counts as met.",
        edits=(
            Edit(
                VERIFIER,
                "if decisive and all(criterion.truth is Truth.TRUE for criterion in decisive):",
                "if decisive and all(criterion.truth is not Truth.FALSE for criterion in decisive):",
            ),
        ),
        tests=(f"{SHOWN}[unknown is never a success]",),
    ),
    Mutant(
        name="no_criteria_is_success",
        claim="A contract that asks for nothing has been met.",
        edits=(
            Edit(
                VERIFIER,
                "if decisive and all(criterion.truth is Truth.TRUE for criterion in decisive):",
                "if not decisive:\n"
                "            return self._sign(bundle, criteria, verdict=Verdict.SUCCESS, reason='nothing is false')\n"
                "        if decisive and all(criterion.truth is Truth.TRUE for criterion in decisive):",
            ),
        ),
        tests=(f"{SHOWN}[without criteria nothing is a success]",),
    ),
    Mutant(
        name="controller_decides",
        claim="An execution that reports completion has met its objective.",
        edits=(
            Edit(
                VERIFIER,
                "if self.mode is VerificationMode.ENFORCE:\n            history",
                "if bundle.execution.ended is Ended.COMPLETED:\n"
                "            return self._sign(bundle, (), verdict=Verdict.SUCCESS, reason='the controller says so')\n"
                "        if self.mode is VerificationMode.ENFORCE:\n            history",
            ),
        ),
        tests=(f"{OBSERVED}[a skill that reports success and moves nothing fails]",),
    ),
    Mutant(
        name="criteria_swapped",
        claim="Every node is judged by the acceptance of the first one of its goal.",
        edits=(
            Edit(
                "phyagentos.agent.goals.compiler",
                "accept=resolve((*spec.accept, *promiser.guarantees)),",
                "accept=resolve((*self.graph.nodes[self.graph.order[0]].spec.accept, *promiser.guarantees)),",
            ),
        ),
        tests=("tests/agent/test_compiler.py::test_outputs_fill_parameters_with_values_and_predicates_with_text",),
    ),
    Mutant(
        name="stale_snapshot",
        claim="The world before the session is handed over as the world after it.",
        edits=(
            Edit(
                EVIDENCE, "after=_decode(data.get(AFTER), Environment)", "after=_decode(data.get(BEFORE), Environment)"
            ),
        ),
        tests=("tests/cli/test_verify.py::test_a_judgement_is_added_and_the_verdict_stays",),
    ),
    Mutant(
        name="old_facts_pass_for_fresh",
        claim="A fact that was observed long before the end counts as one of the end.",
        edits=(Edit("phyagentos.protocol.world.environment", "if not age_s <= allowed_s:", "if not age_s <= 5.0:"),),
        tests=("tests/agent/test_judges.py::test_acceptance_needs_facts_that_were_observed_at_the_end",),
    ),
    Mutant(
        name="whatever_covers_bears",
        claim="A hidden object is under what is seen above its place, at whatever height that is.",
        edits=(
            Edit(
                "phyagentos.runtime.perception.contents",
                "for name, top in tops if abs(top.measure_gap(upper)) <= near_m}",
                "for name, top in tops if name == lower.name}",
            ),
        ),
        tests=("tests/runtime/perception/test_bearing.py::test_what_is_not_sure_to_rest_on_it_shows_nothing",),
    ),
    Mutant(
        name="edges_hold_what_they_do_not",
        claim="An object whose middle may be past an edge, by what the measurement may be off, surely stands.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                "for slack_m in (-uncertainty_m, FOOTPRINT_SLACK_M + uncertainty_m))",
                "for slack_m in (FOOTPRINT_SLACK_M - uncertainty_m, FOOTPRINT_SLACK_M + uncertainty_m))",
            ),
        ),
        tests=("tests/protocol/test_predicate_doubt.py::test_a_middle_near_an_edge_is_not_surely_over_it",),
    ),
    Mutant(
        name="slopes_are_level",
        claim="What hovers over a slope touches it where its lowest point is as high as the slope below its middle.",
        edits=(
            Edit(
                "phyagentos.protocol.world.entity_geometry",
                "return compute_lowest(entity, self.normal) - dot(self.point_m, self.normal)",
                "return compute_lowest(entity) - self.point_m[2]",
            ),
        ),
        tests=("tests/protocol/test_predicate_builtins.py::test_on_a_slope_contact_is_measured_across_its_surface",),
    ),
    Mutant(
        name="a_doubtful_pose_shows_a_turn",
        claim="An object has turned by what its pose differs from one of several that had fitted as well.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.builtins",
                "if max(a.tilt_std_rad, was.tilt_std_rad) > MOVED_RAD:",
                "if False:",
            ),
        ),
        tests=(
            "tests/protocol/test_predicate_doubt.py::"
            "test_an_object_of_which_another_pose_fits_as_well_is_not_known_to_have_turned",
        ),
    ),
    Mutant(
        name="hidden_counts_as_seen",
        claim="What is hidden is where it was last seen.",
        edits=(
            Edit(
                "phyagentos.protocol.world.environment",
                "if entity.status not in {Status.SEEN, Status.HELD}:",
                "if entity.status is Status.GONE:",
            ),
        ),
        tests=(
            "tests/protocol/test_predicate_doubt.py::test_what_the_deciding_look_did_not_show_is_unknown",
            "tests/runtime/execution/test_holds.py::"
            "test_what_was_hidden_for_a_moment_must_be_confirmed_and_for_longer_it_is_unknown",
        ),
    ),
    Mutant(
        name="hidden_stretch_is_bridged",
        claim="However long a hold condition was not seen, it held meanwhile.",
        edits=(Edit("phyagentos.runtime.execution.holds", "BRIDGED_S = 1.5", "BRIDGED_S = 60.0"),),
        tests=(
            "tests/runtime/execution/test_holds.py::"
            "test_what_was_hidden_for_a_moment_must_be_confirmed_and_for_longer_it_is_unknown",
        ),
    ),
    Mutant(
        name="constraint_forgotten",
        claim="A constraint that a session could not see is not asked for again.",
        edits=(
            Edit(
                "phyagentos.agent.judging.goal_judgement",
                "for text in graph.spec.constraints if not has_metric(text)}",
                "for text in ()}",
            ),
        ),
        tests=("tests/agent/test_worlds_apart.py::test_a_constraint_must_be_seen_true_at_the_end_of_the_goal",),
    ),
    Mutant(
        name="worst_sample_dropped",
        claim="Of a hold condition only the last sample is kept.",
        edits=(
            Edit(
                "phyagentos.runtime.execution.holds",
                "if before is None or worse(before[0], evaluation) is evaluation:",
                "if True:",
            ),
        ),
        tests=("tests/runtime/execution/test_holds.py::test_the_worst_sample_is_kept_with_its_time",),
    ),
    Mutant(
        name="replan_budget_ignored",
        claim="There is always one more attempt.",
        edits=(Edit(VERIFIER, "has_budget = history.replans < history.max_replans", "has_budget = True"),),
        tests=(f"{SHOWN}[a spent budget turns a replan into a failure]",),
    ),
    Mutant(
        name="undone_node_stays_done",
        claim="What the world has undone since counts as done.",
        edits=(
            Edit(
                "phyagentos.agent.mission.goal_controller",
                "regressions = self._recovery.find_regressions()",
                "regressions = {}",
            ),
        ),
        tests=(
            "tests/agent/test_mission.py::test_a_finished_node_that_the_world_undid_is_done_again_before_the_verdict",
        ),
    ),
    Mutant(
        name="goal_budget_ignored",
        claim="Sessions are submitted beyond what the goal's budget pays for.",
        edits=(
            Edit("phyagentos.agent.repair.case", "        if self.sessions < 1:\n", "        if False:\n"),
            Edit("phyagentos.agent.repair.case", "if sessions + self.needed > self.sessions:", "if False:"),
        ),
        tests=("tests/agent/test_recovery_missions.py::test_nothing_is_submitted_beyond_the_budget_of_the_goal",),
    ),
    Mutant(
        name="own_word_is_a_measurement",
        claim="What a skill says of itself counts as measured.",
        edits=(
            Edit(
                "phyagentos.protocol.predicates.measured",
                'REPORTED = "reported_"',
                'REPORTED = ""',
            ),
        ),
        tests=(
            "tests/agent/test_judges.py::"
            "test_a_controllers_own_word_counts_only_where_the_goal_asks_for_what_was_reported",
        ),
    ),
    Mutant(
        name="fault_that_never_struck",
        claim="Every fault that was planted counts as struck.",
        edits=(Edit("phyagentos.assembly.planted_faults", 'missing.append(f"{fault.kind} of {body}")', "pass"),),
        tests=("tests/cli/test_planted_faults.py::test_a_fault_that_never_struck_is_named",),
    ),
    Mutant(
        name="refused_way_again",
        claim="The very way that the target has refused is tried again.",
        edits=(Edit("phyagentos.agent.repair.retrying", "if cause is Cause.ADAPTER_REFUSED:", "if False:"),),
        tests=("tests/agent/test_verifier.py::test_the_strategy_answers_the_cause",),
    ),
    Mutant(
        name="goal_time_bounds_nothing",
        claim="A session runs on when the simulated time of its goal is spent.",
        edits=(
            Edit(
                "phyagentos.protocol.sessions.session",
                "return own_s if self.goal_left_s is None else min(own_s, self.goal_left_s)",
                "return own_s",
            ),
        ),
        tests=(
            "tests/agent/test_recovery_missions.py::"
            "test_a_session_may_take_no_more_than_what_is_left_of_the_simulated_time",
            "tests/runtime/test_runner.py::test_the_limit_that_decides_ends_a_session_and_is_named",
        ),
    ),
    Mutant(
        name="goal_time_granted_twice",
        claim="Sessions side by side may each take all that is left of the goal's simulated time.",
        edits=(
            Edit(
                "phyagentos.agent.mission.goal_controller",
                "if not is_alone and session.parent is None and rest_s < session.limits.timeout_s:",
                "if False:",
            ),
        ),
        tests=(
            "tests/agent/test_recovery_missions.py::test_sessions_begin_side_by_side_only_while_each_has_its_whole_time",
        ),
    ),
    Mutant(
        name="miss_without_a_cause",
        claim="What was not met is recorded without a cause.",
        edits=(
            Edit(
                "phyagentos.protocol.sessions.verdicts",
                "if self.verdict.is_miss and not self.cause:",
                "if False:",
            ),
        ),
        tests=("tests/agent/test_verifier.py::test_a_miss_without_a_cause_cannot_be_made",),
    ),
    Mutant(
        name="done_node_is_missed",
        claim="A node that is done counts as missed, because a look for the goal's sake was refused.",
        edits=(
            Edit(
                "phyagentos.agent.mission.recovery",
                "GoalEvent.NODE_DONE if is_done else GoalEvent.NODE_BLOCKED",
                "GoalEvent.NODE_BLOCKED",
            ),
        ),
        tests=(
            "tests/agent/test_recovery_missions.py::"
            "test_what_the_goal_asks_of_an_object_that_was_never_perceived_stays_unknown_and_says_so",
        ),
    ),
    Mutant(
        name="looked_at_for_ever",
        claim="What cannot be told is looked at once more, however often that was done.",
        edits=(
            Edit(
                "phyagentos.agent.repair.looking",
                "if case.cause not in _UNCERTAIN or looks >= LOOKS_MAX or not wanted:",
                "if case.cause not in _UNCERTAIN or not wanted:",
            ),
        ),
        tests=("tests/agent/test_repair.py::test_what_cannot_be_told_is_looked_at_first_and_no_more_than_twice",),
    ),
    Mutant(
        name="blocked_goal_is_met",
        claim="A goal is met although one of its nodes was never done, because nothing speaks against it.",
        edits=(Edit("phyagentos.agent.judging.goal_judgement", "    if blocked:\n", "    if blocked and missed:\n"),),
        tests=(
            "tests/agent/test_mission.py::"
            "test_a_goal_with_a_blocked_node_is_not_met_though_nothing_speaks_against_its_acceptance",
        ),
    ),
    Mutant(
        name="review_decides",
        claim="A judgement that was added afterwards takes the place of the one that decided.",
        edits=(
            Edit(
                "phyagentos.protocol.sessions.session",
                "(attempt for attempt in reversed(self.attempts) if not attempt.is_review)",
                "(attempt for attempt in reversed(self.attempts))",
            ),
        ),
        tests=("tests/cli/test_verify.py::test_everybody_sees_the_verdict_and_every_judgement",),
    ),
    Mutant(
        name="prediction_outvotes_observation",
        claim="What look-ahead expected weighs as much as what was observed afterwards.",
        edits=(Edit(VERIFIER, "    return observed or criteria\n", "    return criteria\n"),),
        tests=("tests/agent/test_judges.py::test_a_prediction_never_outvotes_what_was_observed",),
    ),
    Mutant(
        name="agent_reads_faults",
        claim="The diagnosis looks up what was injected and tells it as its own finding.",
        edits=(
            Edit(
                VERIFIER,
                "    diagnosis = diagnose(bundle, criteria)\n",
                "    diagnosis = diagnose(bundle, criteria)\n"
                "    if (told := bundle.folder / 'faults.json').exists():\n"
                "        diagnosis = replace(diagnosis, fact=told.read_text())\n",
            ),
        ),
        tests=(
            "tests/agent/test_blind_to_faults.py::"
            "test_the_agent_judges_diagnoses_and_repairs_without_opening_what_was_injected",
        ),
    ),
    Mutant(
        name="met_before_without_rest",
        claim="What was seen once in its place before a session counts as met, although it may still move.",
        edits=(
            Edit(
                "phyagentos.runtime.execution.criteria",
                "    return Truth.TRUE if is_met(session, now, now) else Truth.UNKNOWN\n",
                "    return Truth.TRUE\n",
            ),
        ),
        tests=("tests/runtime/test_runner.py::test_what_is_met_already_is_not_acted_on[cube2-99.0-True-]",),
    ),
    Mutant(
        name="refused_session_acts_as_its_replan",
        claim="What the dry run refused is carried out by the next attempt, which has none.",
        edits=(
            Edit(
                "phyagentos.runtime.preflight.examination",
                "        if is_tried:\n",
                "        if is_tried and not session.attempt:\n",
            ),
        ),
        tests=("tests/runtime/test_preflight_dry_run.py::test_every_attempt_passes_the_same_dry_run",),
    ),
    Mutant(
        name="same_plan_in_the_same_world",
        claim="A plan that failed is another one the second time, although nothing has moved.",
        edits=(
            Edit(
                "phyagentos.agent.repair.repetition",
                '    return "" if find_change(before, world, sorted(names)) else cause\n',
                '    return ""\n',
            ),
        ),
        tests=(
            "tests/agent/test_repair.py::"
            "test_a_claim_that_a_look_found_false_is_asked_again_only_of_another_world[moved0-give up]",
        ),
    ),
    Mutant(
        name="undecided_once_more",
        claim="What the stated number of looks did not decide is decided by doing it again.",
        edits=(
            Edit(
                "phyagentos.agent.repair.retrying",
                "or _is_undecided_for_good(case) or case.miss",
                "or case.miss",
            ),
        ),
        tests=("tests/agent/test_repair.py::test_what_two_looks_did_not_decide_or_show_ends_there",),
    ),
    Mutant(
        name="unseen_hold_forgotten_by_the_replan",
        claim="A hold condition that a session could not see is asked of its replan against a world after the harm.",
        edits=(Edit(VERIFIER, "judge.judge(bundle)), *history.carried]", "judge.judge(bundle))]"),),
        tests=(
            "tests/agent/test_recovery_missions.py::"
            "test_what_a_session_could_not_see_of_its_hold_condition_is_asked_of_its_replan[0.1-failure]",
        ),
    ),
)
