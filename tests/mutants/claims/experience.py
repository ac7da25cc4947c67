"""Mutants of memory: what was never verified is given as a fact."""

from tests.mutants.mutant import Edit, Mutant

METHODS = "phyagentos.agent.memory.methodological"

MUTANTS = (
    Mutant(
        name="unverified_lesson_recalled",
        claim="A correction that no verdict has confirmed is told as a lesson.",
        edits=(
            Edit(
                METHODS,
                'if not self.count.successes:\n            return EntryState.HYPOTHESIS, ""',
                'if not self.count.successes:\n            return EntryState.ACTIVE, ""',
            ),
        ),
        tests=(
            "tests/agent/memory/test_lessons.py::"
            "test_a_correction_that_was_not_confirmed_stays_a_hypothesis_and_is_never_recalled",
        ),
    ),
    Mutant(
        name="lesson_of_another_hand",
        claim="What one hand has learned is applied with any other.",
        edits=(
            Edit(
                "phyagentos.agent.memory.scopes",
                "return _compare_bodies(scope.body, case.body, strategy)",
                'return ""',
            ),
        ),
        tests=(
            "tests/agent/memory/test_lessons.py::test_a_lesson_is_told_of_the_same_object_and_a_hand_alike_or_of_a_place",
        ),
    ),
    Mutant(
        name="promotion_without_a_test",
        claim="A way becomes the default after so many starts, however often it failed.",
        edits=(
            Edit(
                "phyagentos.agent.memory.semantic",
                "if ratio >= PROMOTES and len(starts) >= STARTS_MIN:",
                "if len(starts) >= STARTS_MIN:",
            ),
        ),
        tests=(
            "tests/agent/memory/test_promotion.py::"
            "test_a_way_that_is_not_good_enough_is_promoted_in_at_most_alpha_of_the_trials",
        ),
    ),
    Mutant(
        name="memory_writes_safety",
        claim="What memory knows of a limit is written into safety.yaml.",
        edits=(
            Edit(
                "phyagentos.agent.memory.episode_recorder",
                "        self._memory.record(found)\n        self.publish()",
                "        self._memory.record(found)\n"
                '        (self._workspace.root / "safety.yaml").write_text("version: 2\\n")\n'
                "        self.publish()",
            ),
        ),
        tests=("tests/agent/memory/test_episode_recorder.py::test_memory_never_writes_a_setting",),
    ),
    Mutant(
        name="memory_believes_an_audit",
        claim="What an audit let pass on the controller's word is remembered as verified.",
        edits=(
            Edit(
                "phyagentos.agent.memory.episodes",
                "found = (decision.found or decision.verdict)",
                "found = decision.verdict",
            ),
        ),
        tests=(
            "tests/agent/memory/test_episodes.py::"
            "test_what_an_audit_let_pass_is_remembered_as_the_failure_that_was_found",
        ),
    ),
    Mutant(
        name="prepared_success_is_the_own_way",
        claim="What succeeded only because memory had prepared it counts as a success without any advice.",
        edits=(
            Edit(
                "phyagentos.agent.memory.experience",
                "not (episode.strategy or episode.advised_by or episode.prepared)",
                "not episode.strategy",
            ),
        ),
        tests=(
            "tests/agent/memory/test_means.py::"
            "test_a_first_attempt_that_memory_prepared_counts_for_the_lesson_and_not_for_the_own_way",
        ),
    ),
    Mutant(
        name="accident_forgiven",
        claim="A lesson that led to a safety event goes on advising.",
        edits=(Edit(METHODS, "        if self.accidents:\n", "        if False:\n"),),
        tests=("tests/agent/memory/test_cautions.py::test_a_lesson_that_a_safety_event_followed_is_used_no_more",),
    ),
    Mutant(
        name="snapshot_moves",
        claim="A goal that goes on is advised from what other runs have recorded since.",
        edits=(
            Edit(
                "phyagentos.agent.memory.advisor",
                "self._known = earlier or self._memory",
                "self._known = self._memory",
            ),
        ),
        tests=(
            "tests/agent/memory/test_episode_recorder.py::"
            "test_a_goal_that_goes_on_is_advised_from_the_snapshot_that_it_began_with",
        ),
    ),
)
