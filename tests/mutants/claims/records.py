"""Mutants of the store: what was acknowledged is not there, what was judged is rewritten, what was edited lost."""

from tests.mutants.mutant import Edit, Mutant

MUTANTS = (
    Mutant(
        name="durability_barrier_removed",
        claim="A commit is told as durable although nobody waited for the disk.",
        edits=(
            Edit(
                "phyagentos.store.writer",
                "self.be_durable(self._io.fdatasync, self._fd)\n",
                "pass\n",
            ),
        ),
        tests=(
            "tests/store/test_journal_faults.py::test_one_commit_needs_one_sync_and_none_when_not_durable",
            "tests/durability/test_power_loss.py::test_the_power_goes_after_one_writer_was_killed_and_another_went_on",
        ),
    ),
    Mutant(
        name="start_before_the_disk",
        claim="A session has its lease before its start is on the disk.",
        edits=(
            Edit(
                "phyagentos.runtime.supervision.target_supervisor",
                "self._journal.sync()  # no lease",
                "pass  # no lease",
            ),
        ),
        tests=("tests/runtime/test_starts.py::test_a_session_has_its_first_lease_only_when_its_start_is_on_the_disk",),
    ),
    Mutant(
        name="first_lease_not_awaited",
        claim="A worker begins a session before it has a lease.",
        edits=(Edit("phyagentos.runtime.worker.worker", "while not self._lease_until_s:", "while False:"),),
        tests=(
            "tests/runtime/test_leases.py::"
            "test_a_session_opens_its_bundle_and_takes_no_authority_before_its_first_lease",
        ),
    ),
    Mutant(
        name="crc_not_checked",
        claim="A record is believed whatever its checksum says.",
        edits=(
            Edit(
                "phyagentos.store.records",
                "if not is_next or compute_crc(seq + 1, payload) != int(match[3], 16):",
                "if not is_next:",
            ),
        ),
        tests=("tests/store/test_records.py::test_every_single_flipped_bit_is_noticed",),
    ),
    Mutant(
        name="lock_not_taken",
        claim="Two writers hold the partition at the same time.",
        edits=(
            Edit(
                "phyagentos.store.partition_lock",
                "fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)",
                "fcntl.flock(self._fd, fcntl.LOCK_SH | fcntl.LOCK_NB)",
            ),
        ),
        tests=("tests/store/test_journal.py::test_a_lock_that_stays_taken_names_its_holder",),
    ),
    Mutant(
        name="attempt_rewritten",
        claim="A later judgement takes the place of the earlier one.",
        edits=(
            Edit(
                "phyagentos.store.ledger",
                '(*before.attempts, msgspec.convert(body["attempt"], Attempt))',
                '(*before.attempts[:-1], msgspec.convert(body["attempt"], Attempt))',
            ),
        ),
        tests=("tests/cli/test_verify.py::test_every_further_judgement_is_appended",),
    ),
    Mutant(
        name="sealed_file_edited",
        claim="A file that was changed after its bundle was sealed passes for the one that was sealed.",
        edits=(
            Edit(
                "phyagentos.protocol.sessions.evidence_manifest",
                "if found == expected.sha256:",
                "if found:",
            ),
        ),
        tests=("tests/store/test_evidence_manifest.py::test_a_change_of_a_sealed_bundle_is_found",),
    ),
    Mutant(
        name="view_edit_lost",
        claim="What a person saved into a rendered document while it was renewed is thrown away without a word.",
        edits=(
            Edit(
                "phyagentos.store.shared_file",
                "self._kept.append(_Kept(fresh, self._clock.now_s(), self._digest))",
                "fresh.unlink()",
            ),
        ),
        tests=("tests/store/test_edits.py::test_a_section_that_is_added_submits_a_session",),
    ),
    Mutant(
        name="measured_is_commanded",
        claim="The trajectory in the evidence tells as measured what was only commanded.",
        edits=(
            Edit(
                "phyagentos.runtime.worker.recorder",
                "                *target.q_rad,\n",
                "                *points.q_rad[-1].tolist(),\n",
            ),
        ),
        tests=(
            "tests/runtime/test_recorded_evidence.py::test_the_trajectory_holds_what_was_measured_beside_what_was_commanded",
        ),
    ),
    Mutant(
        name="after_is_before",
        claim="The recorder files the world before the session once more as the world after it.",
        edits=(
            Edit(
                "phyagentos.runtime.worker.recorder",
                "encode_json(environment))\n",
                "encode_json(environment) if is_start else (self.folder / evidence.BEFORE).read_bytes())\n",
            ),
        ),
        tests=("tests/runtime/test_recorded_evidence.py::test_the_end_of_a_bundle_is_the_world_as_it_was_left",),
    ),
    Mutant(
        name="old_picture_of_the_end",
        claim="The picture of the end is that of the beginning.",
        edits=(
            Edit(
                "phyagentos.runtime.worker.runner",
                "self._take_picture(recorder, files.PICTURE_AFTER)",
                "recorder.write_file(files.PICTURE_AFTER, (recorder.folder / files.PICTURE_BEFORE).read_bytes())",
            ),
        ),
        tests=("tests/runtime/test_recorded_evidence.py::test_the_end_of_a_bundle_is_the_world_as_it_was_left",),
    ),
    Mutant(
        name="trace_without_failures",
        claim="Every node of the tree is traced as a success.",
        edits=(
            Edit("phyagentos.runtime.execution.tree_runtime", "status=behaviour.status.value,", 'status="SUCCESS",'),
        ),
        tests=("tests/runtime/test_composites.py::test_a_retry_runs_the_child_again_and_the_trace_shows_each_attempt",),
    ),
)
