"""A command that has ended holds no file open: a shell, a notebook or a test may call a thousand of them."""

from collections import Counter
from pathlib import Path

import pytest

from phyagentos.agent.memory.memory import Memory
from phyagentos.clock import SystemClock
from tests.agent.memory.conftest import make_correction

DESCRIPTORS = Path("/proc/self/fd")
COMMANDS = [
    ("memory", "show", "-w", "ROOT"),
    ("memory", "why", "LESSON", "-w", "ROOT"),
    ("memory", "why", "nothing-of-this-name", "-w", "ROOT"),
    ("memory", "forget", "LESSON", "--reason", "another soap now", "-w", "ROOT"),
    ("memory", "forget", "nothing-of-this-name", "--reason", "another soap now", "-w", "ROOT"),
    ("why", "tidy-7.red", "-w", "ROOT"),
    ("why", "nothing-of-this-name", "-w", "ROOT"),
    ("verify", "tidy-7.red.r1", "-w", "ROOT"),
    ("judge", "ROOT"),
    ("cancel", "tidy-7.red", "-w", "ROOT"),
    ("store", "check", "ROOT"),
    ("evidence", "prune", "-w", "ROOT"),
]


@pytest.fixture
def lesson(replanned):
    memory = Memory(replanned.workspace.memory, clock=SystemClock(), by="test", durable=False)
    memory.record(make_correction())
    return next(iter(memory.experience.corrections))


def list_open():
    found = (path for path in DESCRIPTORS.iterdir() if path.exists())
    return sorted(str(path.readlink()) for path in found)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_command_closes_what_it_opened(paos, replanned, lesson, command, monkeypatch):
    kept = []
    opened = Memory.__init__

    def keep(self, *arguments, **facts):
        kept.append(self)  # so that nobody's end closes what the command itself should have closed
        opened(self, *arguments, **facts)

    monkeypatch.setattr(Memory, "__init__", keep)
    root = replanned.workspace.root
    words = [{"LESSON": lesson, "ROOT": root}.get(word, word) for word in command]
    paos(*words)  # what is loaded once may stay
    before = list_open()
    for _ in range(3):
        result = paos(*words)
    assert "Usage:" not in result.err, result.err
    assert not Counter(list_open()) - Counter(before)  # what others had left may be closed meanwhile
