"""Several processes on one lane: one order, nothing lost, no session claimed twice, whoever is killed."""

import json
import subprocess
import sys

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
