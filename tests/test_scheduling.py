"""The supervisor's scheduling."""

import json
import os
import subprocess
import sys

import pytest

from phyagentos.assembly.process_tuning import ask_for_precedence, ask_for_prompt_wakeups

ASK = """
import json, os, subprocess, sys
from phyagentos.assembly.process_tuning import ask_for_prompt_wakeups
granted = ask_for_prompt_wakeups()
child = subprocess.run([sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"], capture_output=True)
own = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
print(json.dumps([granted, own == os.SCHED_FIFO, int(child.stdout) == os.SCHED_OTHER]))
"""
ASK_FOR_SHARE = """
import json, os, subprocess, sys
from phyagentos.assembly.process_tuning import PRECEDENCE, ask_for_precedence
before = os.getpriority(os.PRIO_PROCESS, 0)
granted = ask_for_precedence()
look = "import os; print(os.getpriority(os.PRIO_PROCESS, 0))"
child = subprocess.run([sys.executable, "-c", look], capture_output=True)
own = os.getpriority(os.PRIO_PROCESS, 0)
print(json.dumps([granted, own == PRECEDENCE, int(child.stdout) >= min(before, 0)]))
"""


@pytest.mark.parametrize("source", [ASK, ASK_FOR_SHARE], ids=["prompt wake-ups", "a larger share"])
def test_what_was_granted_is_in_force_and_no_child_inherits_it(source):
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    granted, is_in_force, is_child_ordinary = json.loads(done.stdout)

    assert granted == is_in_force
    assert is_child_ordinary


def test_a_refusal_leaves_everything_as_it_was(monkeypatch):
    def refuse(*_given):
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)

    assert not ask_for_prompt_wakeups()
    assert not ask_for_precedence()


def test_nobody_is_put_in_front_of_the_others_on_a_single_processor(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: {0})
    before = os.sched_getscheduler(0)

    assert not ask_for_prompt_wakeups()
    assert os.sched_getscheduler(0) == before
