"""The planner process: the same answers as in this process, cancelled in time, replaced when lost."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from msgspec.structs import replace

from phyagentos.runtime.motion.process import LocalPlanner, PlannerProcess
from phyagentos.runtime.motion.requests import Approaches, FindGrasps
from tests.runtime.motion.conftest import build_scene

pytestmark = pytest.mark.motion

PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def process(profile_file):
    process = PlannerProcess(profile_file)
    yield process
    process.close()


@pytest.fixture
def request_of_cube(home):
    return FindGrasps(world=build_scene(0), object="cube0", q_rad=home, seed=3)


def ask(planner, request):
    planner.submit(request)
    assert planner.wait(PATIENCE_S)
    return planner.poll()


def cancel(process, request):
    process.submit(request)
    process.cancel()
    answer = None
    while answer is None:
        process.wait(1.0)
        answer = process.poll()
    return answer


def test_another_process_answers_with_the_same_bits(process, planner, request_of_cube):
    there, here = ask(process, request_of_cube), ask(LocalPlanner(planner), request_of_cube)

    assert isinstance(there, Approaches)
    assert [a.label for a in there.approaches] == [a.label for a in here.approaches]
    for a, b in zip(there.approaches, here.approaches, strict=True):
        assert np.array_equal(a.line_rad, b.line_rad)


def test_a_second_request_before_the_answer_is_refused(process, request_of_cube):
    process.submit(request_of_cube)
    with pytest.raises(RuntimeError, match="one request at a time"):
        process.submit(request_of_cube)
    assert process.wait(PATIENCE_S)
    assert isinstance(process.poll(), Approaches)
    assert process.poll() is None


def test_a_cancelled_request_is_answered_so_and_the_next_one_works_also_where_a_planner_does_not_listen(
    process, request_of_cube
):
    assert cancel(process, request_of_cube).code == "CANCELLED"
    assert isinstance(ask(process, request_of_cube), Approaches)
    deaf = process.pid
    os.kill(deaf, signal.SIGSTOP)
    answer = cancel(process, request_of_cube)

    assert answer.code == "CANCELLED"
    assert "replaced" in answer.message
    assert process.pid != deaf


def test_what_preflight_asked_is_known_when_the_skill_asks_it(process, request_of_cube):
    first, other, again = (ask(process, replace(request_of_cube, seed=seed)) for seed in (11, 12, 11))

    assert first.timing == again.timing != other.timing  # what it took then
    assert np.array_equal(first.approaches[0].line_rad, again.approaches[0].line_rad)


def test_a_lost_planner_is_reported_and_replaced(process, request_of_cube):
    assert isinstance(ask(process, request_of_cube), Approaches)
    lost = process.pid
    os.kill(lost, signal.SIGSTOP)  # or it may answer before it is killed
    process.submit(replace(request_of_cube, seed=7))
    os.kill(lost, signal.SIGKILL)
    assert process.wait(PATIENCE_S)
    answer = process.poll()

    assert answer.code == "RUNNER_LOST"
    assert "-9" in answer.message
    assert process.pid != lost
    assert isinstance(ask(process, request_of_cube), Approaches)


def test_the_local_planner_honours_cancel(planner, request_of_cube):
    local = LocalPlanner(planner)
    local.submit(request_of_cube)
    local.cancel()

    assert local.poll().code == "CANCELLED"
    assert local.poll() is None


def test_a_planner_that_has_shaped_nothing_does_not_hold_casadi():
    look = "import sys, phyagentos.runtime.motion.planner; print('casadi' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout == "False\n"
