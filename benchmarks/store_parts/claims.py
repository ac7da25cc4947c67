"""Several processes claim the same sessions: each once, none lost, and fairly."""

import contextlib
import json
import random
import subprocess
import sys
import time
from pathlib import Path

from phyagentos.protocol.sessions.lifecycle import IllegalTransition, Side
from phyagentos.store.follower import Follower
from phyagentos.store.journal import Journal

from .sessions import BATCH, CLOCK, LANE, claim, open_pair, submit

CLAIMERS = 8
TOGETHER = 4  # sessions a claimer asks for at once: a worker that is busy anyway takes the next few along


def measure_claims(root: Path, sessions: int) -> dict[str, float]:
    """Claims per second of all, doubles, losses, and the smallest share over the mean."""
    agent, runtime = open_pair(root, durable=False)
    for first in range(0, sessions, BATCH):
        agent.commit([submit(f"s{number}") for number in range(first, min(first + BATCH, sessions))])
    runtime.close()
    code = "import sys; sys.path.insert(0, sys.argv[1]); from store_parts.claims import run_claimer; run_claimer()"
    folder = str(Path(__file__).parents[1])
    claimers = [
        subprocess.Popen(
            [sys.executable, "-c", code, folder, str(root), str(number)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for number in range(CLAIMERS)
    ]
    for process in claimers:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    begin_s = time.perf_counter()
    for process in claimers:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    answers = [json.loads(process.communicate()[0]) for process in claimers]
    passed_s = max(answer["ended_s"] for answer in answers) - begin_s
    agent.close()
    won = [id for answer in answers for id in answer["won"]]
    follower = Follower(root / "sessions" / LANE)
    recorded = [record.id for record in follower.read_new() if record.ev == "claim"]
    follower.close()
    doubles = len(won) - len(set(won)) + len(recorded) - len(set(recorded))
    lost = sessions - len(set(recorded)) + len(set(won) ^ set(recorded))
    return {
        "claims_per_s": len(recorded) / passed_s,
        "claims_double": float(doubles),
        "claims_lost": float(lost),
        "claims_smallest_share": min(len(answer["won"]) for answer in answers) / (len(won) / CLAIMERS),
    }


def run_claimer() -> None:
    """One claimer: takes a few of those that wait, at random, until none waits."""
    root, number = Path(sys.argv[2]), int(sys.argv[3])
    chance = random.Random(number)
    journal = Journal(root, side=Side.RUNTIME, by=f"claimer{number}", clock=CLOCK, partition=LANE)
    waiting: list[str] = []
    places: dict[str, int] = {}
    won: list[str] = []

    def read() -> None:
        for record in journal.read_new():
            if record.ev == "submit":
                places[record.id] = len(waiting)
                waiting.append(record.id)
            elif record.ev == "claim" and (place := places.pop(record.id, None)) is not None:
                last = waiting.pop()
                if place < len(waiting):
                    waiting[place], places[last] = last, place

    read()
    print("ready", flush=True)
    sys.stdin.readline()
    while waiting:
        chosen = {chance.choice(waiting) for _ in range(TOGETHER)}
        with contextlib.suppress(IllegalTransition):  # another was faster with one of them
            won += [record.id for record in journal.commit([claim(id) for id in sorted(chosen)])]
        read()
    print(json.dumps({"won": won, "ended_s": time.perf_counter()}))
