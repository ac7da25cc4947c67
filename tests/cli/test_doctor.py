"""`paos doctor`: each check finds what is wrong and says what to do."""

import importlib.metadata
import json
import os
import sys

import pytest

from phyagentos.clock import SystemClock
from phyagentos.operations import doctor
from phyagentos.operations.doctor import Grade, iter_findings
from phyagentos.testing import ManualClock
from tests.command_line import assert_refused

pytestmark = pytest.mark.fast


@pytest.mark.slow
def test_this_machine_keeps_every_promise_and_nothing_is_left_behind(tmp_path, paos):
    result = paos("doctor", tmp_path, "--json")
    findings = json.loads(result.out)

    assert result.code == 0
    assert {each["subject"] for each in findings} >= {"python", "packages", "graphics", "locks", "clock", "ports"}
    assert all(each["fix"] for each in findings if each["grade"] != "fine")
    assert not any(tmp_path.iterdir())


def test_a_folder_that_does_not_exist_is_a_mistake_of_the_caller(tmp_path, paos):
    assert_refused(paos("doctor", tmp_path / "nowhere"), "UNKNOWN_NAME (folder)")


def test_packages_that_are_missing_or_too_old_are_all_named(monkeypatch):
    wanted = ["no-such-package>=1", "PyYAML>=999", "numpy>=2", "other; extra == 'dev'"]
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: wanted)
    finding = doctor.check_packages()

    assert finding.grade is Grade.BROKEN
    assert "no-such-package is missing" in finding.found
    assert ">=999" in finding.found
    assert "numpy" not in finding.found
    assert "other" not in finding.found


def test_a_machine_without_graphics_is_told_which_packages_help(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    finding = doctor.check_graphics()

    assert finding.grade is Grade.WEAK
    assert "apt-get install" in finding.fix


def test_a_slow_disk_and_a_foreign_clock_are_seen(tmp_path):
    class SlowClock(SystemClock):
        spent_s = 0.0

        def now_s(self):
            self.spent_s += 0.05
            return self.spent_s

    assert doctor.check_syncs(tmp_path, SlowClock()).grade is Grade.WEAK
    assert doctor.check_clock(tmp_path, ManualClock()).grade is Grade.WEAK


def test_a_full_disk_and_a_shared_file_system_are_seen(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "FREE_MIN_BYTES", 1 << 62)
    monkeypatch.setattr(doctor, "LOCAL", frozenset())

    assert doctor.check_space(tmp_path, ManualClock()).grade is Grade.WEAK
    assert doctor.check_file_system(tmp_path, ManualClock()).grade is Grade.WEAK


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_is_broken_and_the_other_checks_go_on(tmp_path, monkeypatch):
    def refuse(*_arguments, **_keywords):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "fdatasync", refuse)
    grades = {each.subject: each.grade for each in iter_findings(tmp_path, SystemClock())}

    assert grades["syncs"] is Grade.BROKEN
    assert grades["locks"] is Grade.FINE
