"""A claimant is stopped past its lease; whatever it says after it was replaced is fenced."""

import fcntl
import json
import os
import random
import select
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.store.journal import Entry, Journal
from phyagentos.testing import ManualClock

from .workloads import LANE, NOON_S, make_submit

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
CLAIMANT = """
import json, sys
from pathlib import Path
from phyagentos.clock import SystemClock
from phyagentos.errors import PhyAgentOSError
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.store.journal import Entry, Journal
options = {"partition": sys.argv[2], "clock": SystemClock(), "durable": False}
journal = Journal(Path(sys.argv[1]), side=Side.RUNTIME, by="slow", **options)
def tell(**facts):
    print(json.dumps(facts), flush=True)
def say(session, event, epoch):
    try:
        seq = journal.commit([Entry(session, event, {"reason": "late"}, epoch)])[0].seq
    except PhyAgentOSError as error:
        return {"event": event, "error": type(error).__name__}
    return {"event": event, "seq": seq}
tell(ready=True)
for line in sys.stdin:
    session = line.strip()
    said = [say(session, "claim", 0)]
    if "seq" in said[0]:
        said.append(say(session, "check", 1))
    tell(ready=True)
    sys.stdin.readline()
    for event in ("check", "start", "finish", "reject", "release", "lose"):
        said.append(say(session, event, 1))
    said.append(say(session, "claim", 0))
    tell(said=said)
"""


@pytest.fixture
def claimant(memory):
    process = subprocess.Popen(
        [sys.executable, "-c", CLAIMANT, str(memory), LANE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    yield process
    process.kill()
    process.communicate()


def ask(process, line):
    process.stdin.write(line + "\n")
    process.stdin.flush()
    return json.loads(process.stdout.readline())


def stop_outside_the_lock(process, folder, pause_s):
    """Stop it after a while; a process that is stopped with the lock held would stop everybody, so not there."""
    select.select([], [], [], pause_s)
    retries = 0
    lock = os.open(folder / ".lock", os.O_RDWR)
    try:
        while True:
            os.kill(process.pid, signal.SIGSTOP)
            os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.kill(process.pid, signal.SIGCONT)
                select.select([], [], [], 0.0001)
                retries += 1
            else:
                return retries
    finally:
        os.close(lock)


def test_every_command_of_a_claimant_that_was_replaced_is_fenced(memory, claimant, scale, figures):
    rng, told = random.Random(9), Counter()
    options = {"partition": LANE, "clock": ManualClock(NOON_S), "durable": False}
    agent = Journal(memory, side=Side.AGENT, by="agent", **options)
    heir = Journal(memory, side=Side.RUNTIME, by="heir", **options)
    assert json.loads(claimant.stdout.readline()) == {"ready": True}
    for number in range(scale(20, 1_000)):
        session = f"s{number}"
        agent.commit([make_submit(session)])
        claimant.stdin.write(session + "\n")
        claimant.stdin.flush()
        told["stopped_in_the_lock"] += stop_outside_the_lock(
            claimant, heir.folder, rng.choice((0.0, 0.0002, 0.0005, 0.002))
        )
        taken = take_over(heir, session)
        os.kill(claimant.pid, signal.SIGCONT)
        told["stops"] += 1
        assert json.loads(claimant.stdout.readline()) == {"ready": True}
        for answer in ask(claimant, "")["said"]:
            told["commands"] += 1
            told["fenced"] += answer.get("error") == "Fenced"
            told["before_the_stop"] += answer.get("seq", taken.seq) < taken.seq
        heir.commit([Entry(session, "check"), Entry(session, "start", None, taken.epoch)])  # the new claim goes on
    figures(**told)
    assert told["fenced"] + told["before_the_stop"] == told["commands"] > 7 * told["stops"]
    check_epochs(heir.read_new())


def take_over(heir, session):
    """What a watchdog does when a lease is over: the session may be claimed, checked, or not be claimed yet."""
    for before in ((), ("check",), ("claim", "check")):
        try:
            heir.commit([*(Entry(session, event) for event in before), Entry(session, "release", {"reason": "over"})])
            break
        except IllegalTransition:  # the claimant was stopped before it came so far
            continue
    return heir.commit([Entry(session, "claim")])[0]


def check_epochs(records):
    """Epochs count up with each claim, and nobody speaks under an older one than the latest."""
    held = {}
    for record in records:
        if record.ev == "claim":
            assert record.epoch == held.get(record.id, 0) + 1
            held[record.id] = record.epoch
        elif record.epoch:
            assert record.epoch == held[record.id]
        if record.by == "slow":
            assert record.epoch == 1
