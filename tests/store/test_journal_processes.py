"""Several processes on one lane: one order, nothing lost, no session claimed twice, whoever is killed."""

import json
import os
import signal
import subprocess
import sys

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.ledger import Ledger

RECORDS = 200
HEAD = """
import json, os, sys
from pathlib import Path
from phyagentos.clock import SystemClock
from phyagentos.store.journal import Entry, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
root, name = Path(sys.argv[1]), sys.argv[2]
journal = Journal(root, side=Side.RUNTIME, by=name, clock=SystemClock(), durable=False, segment_bytes=30_000)
ledger = Ledger()
print("ready", flush=True)
sys.stdin.readline()
"""
CLAIM_ALL = (
    HEAD
    + """
won, refused = [], 0
while True:
    for record in journal.read_new():
        ledger.apply(record)
    pending = [status.contract.id for status in ledger.iter_pending()]
    if not pending:
        break
    try:
        won += [record.seq for record in journal.commit([Entry(pending[0], "claim")])]
    except IllegalTransition:
        refused += 1
print(json.dumps({"won": won, "refused": refused}))
"""
)
RELEASE_FOREVER = (
    HEAD
    + """
session, epoch = "s" + name, 0
while True:
    release = Entry(session, "release", {"reason": "x" * 3000}, epoch + 1)
    records = journal.commit([Entry(session, "claim"), Entry(session, "check"), release])
    epoch += 1
    os.write(1, f"{records[-1].seq}\\n".encode())
"""
)


def start(code, root, name):
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(root), name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    return process


def test_two_processes_share_200_sessions_without_losing_or_doubling_one(tmp_path, open_journal, submit):
    agent = open_journal()
    agent.commit([submit(f"s{number}") for number in range(RECORDS)])
    claimants = [start(CLAIM_ALL, tmp_path, name) for name in ("one", "two")]

    for process in claimants:
        process.stdin.write("go\n")
        process.stdin.flush()
    answers = [json.loads(process.communicate(timeout=60)[0]) for process in claimants]

    assert [process.returncode for process in claimants] == [0, 0]
    records = agent.read_new()
    claims = [record for record in records if record.ev == "claim"]
    assert [record.seq for record in records] == list(range(1, 2 * RECORDS + 1))
    assert len({record.id for record in claims}) == len(claims) == RECORDS
    acknowledged = {"one": set(answers[0]["won"]), "two": set(answers[1]["won"])}
    assert {name: {r.seq for r in claims if r.by == name} for name in acknowledged} == acknowledged
    assert [record.seq for record in open_journal().read_new()] == [record.seq for record in records]


def test_a_killed_writer_loses_nothing_it_was_told_of(tmp_path, open_journal, submit):
    agent = open_journal()
    agent.commit([submit("sone"), submit("stwo")])
    writers = [start(RELEASE_FOREVER, tmp_path, name) for name in ("one", "two")]
    for process in writers:
        process.stdin.write("go\n")
        process.stdin.flush()

    acknowledged = []
    for process in writers:
        acknowledged += [int(process.stdout.readline()) for _ in range(100)]
    for process in writers:
        os.kill(process.pid, signal.SIGKILL)
        acknowledged += [
            int(line) for line in process.communicate()[0].splitlines(keepends=True) if line.endswith("\n")
        ]

    late = open_journal(Side.RUNTIME, "late")
    late.commit([])
    records = late.read_new()
    ledger = Ledger()
    for record in records:
        ledger.apply(record)
    assert [record.seq for record in records] == list(range(1, len(records) + 1))
    assert set(acknowledged) <= {record.seq for record in records if record.ev == "release"}
    assert [status.state for status in ledger.sessions.values()] == ["pending", "pending"]
