"""`paos doctor`: each check finds what is wrong and says what to do."""

import functools
import importlib.metadata
import json
import os
import subprocess
import sys

import pytest

from phyagentos.assembly import graphics
from phyagentos.clock import SystemClock
from phyagentos.operations import doctor
from phyagentos.operations.doctor import Grade, iter_findings
from phyagentos.testing import ManualClock
from tests.command_line import assert_refused


@pytest.mark.slow
def test_this_machine_keeps_every_promise_and_nothing_is_left_behind(tmp_path, paos):
    result = paos("doctor", tmp_path, "--json")
    findings = json.loads(result.out)

    assert result.code == 0
    assert {each["subject"] for each in findings} >= {"python", "packages", "graphics", "locks", "clock", "ports"}
    assert all(each["fix"] for each in findings if each["grade"] != "fine")
    assert not any(tmp_path.iterdir())


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
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    finding = doctor.check_graphics()

    assert finding.grade is Grade.WEAK
    assert "apt-get install" in finding.fix


UNFIT = [
    ({"MUJOCO_GL": "osmesa"}, "MUJOCO_GL=osmesa, which needs libOSMesa"),
    ({"MUJOCO_GL": "glfw"}, "MUJOCO_GL=glfw, which needs a display"),
    ({"MUJOCO_GL": "glfw", "DISPLAY": ":99"}, "draws nothing here with DISPLAY=:99"),
    ({"MUJOCO_GL": "opengl"}, "MUJOCO_GL=opengl, which names no graphics"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("given", "unfit"), UNFIT)
def test_graphics_that_are_named_and_cannot_draw_are_refused_by_doctor_and_run_at_once(
    tmp_path, paos, monkeypatch, given, unfit
):
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)  # MuJoCo leaves it where a test before has imported it
    for name, value in ({"DISPLAY": ""} | given).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(graphics, "can_draw", functools.cache(graphics.can_draw))  # tried once for all three
    finding = doctor.check_graphics()
    refused = paos("run", "tidy_table", "-w", tmp_path / "w")

    assert (finding.grade, unfit in finding.found) == (Grade.BROKEN, True), finding
    assert_refused(refused, "MUJOCO_GL: INVALID_VALUE", unfit, "Unset it")
    assert not (tmp_path / "w").exists()
    assert_refused(paos("preflight", "tidy_table"), unfit)


@pytest.mark.slow
@pytest.mark.parametrize("given", [{"PYOPENGL_PLATFORM": "osmesa"}, {"DISPLAY": ":99"}, {"MUJOCO_GL": " EGL"}])
def test_without_a_name_pictures_are_drawn_by_egl_whatever_else_the_environment_says(monkeypatch, given):
    monkeypatch.delenv("MUJOCO_GL")
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert doctor.check_graphics().found == "pictures by egl"


def test_where_egl_is_not_here_mujoco_is_imported_all_the_same(tmp_path):
    (tmp_path / "OpenGL.py").write_text("raise AttributeError")  # as its bindings do without libEGL
    code = "import os, mujoco; print(os.environ['MUJOCO_GL'], mujoco.MjSpec().compile().nq)"
    code = f"from phyagentos.assembly import graphics; graphics.choose_graphics(); {code}"
    named = os.environ | {"MUJOCO_GL": "", "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run([sys.executable, "-c", code], env=named, capture_output=True, text=True, check=False)
    assert done.stdout == "disable 0\n", done.stderr


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
