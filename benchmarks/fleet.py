"""A fleet under attack, and what it costs: hosts as processes with a folder each, and no path in common.

    python benchmarks/fleet.py --runs 40                      # attacks on one fleet, a goal each
    python benchmarks/fleet.py --runs 0 --noop 2000 --hosts 16 # sessions without work, beside one host and none

Two hosts share a target, a third one has its own; three servers are a cluster whose users have least rights. Host,
servers, their leader, hub and agent are killed (`kill -9`), the leader steps down, the process of a host is stopped for
longer than its lease, links are cut, delayed by 200 ms, lose one message in twenty, double each, or lose the server's
answers, a host's clock is an hour off, its disk is full (where small disks may be mounted). Then the goal must come to
its end. What is promised: no record is lost (each lane is byte by byte the same on the hub), no session is carried out
twice, no command is accepted after its claim was fenced, no session stays open, every goal ends in success or in a
failure with a coded cause.
"""

import contextlib
import datetime
import json
import shutil
import signal
import tempfile
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.console import Console
from typer import Option

from benchmarks.attacked import Attacked
from benchmarks.fleet_parts.noop import measure_noop
from benchmarks.fleet_parts.stage import CLOCK_OFF_S, HOSTS, LEASE_S, SERVERS, Stage
from benchmarks.runner import finish, run
from benchmarks.runner import show as show_table
from phyagentos.bench.report import Threshold
from phyagentos.clock import Clock, SystemClock
from phyagentos.codes import CODES
from phyagentos.fleet.hub import GRACE_S
from phyagentos.operations.store import check_journal
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.session import SessionStatus

KILL, STOP, CUT, DELAY, LOSE, CHANGE = "kill -9", "SIGSTOP", "cut", "200 ms", "answers lost", "steps down"
LOSSY, TWICE, CLOCK_OFF, FULL = "5 % lost", "doubled", "clock off 1 h", "disk full"
CELLS = (
    ("host", KILL),
    ("every server", KILL),
    ("host", CUT),
    ("hub", KILL),
    ("leader", CHANGE),
    ("process of a host", KILL),
    ("host", LOSE),
    ("every link", LOSSY),
    ("process of a host", STOP),
    ("hub", CUT),
    ("leader", KILL),
    ("every link", TWICE),
    ("agent", KILL),
    ("every link", DELAY),
    ("host", CLOCK_OFF),
    ("host", FULL),
)
LOSS = 0.05
START_S, LIMIT_S, SETTLE_S, SPREAD_S = 90.0, 240.0, 60.0, 6.0
DELAY_S = 0.2
ASKED = {
    name: Threshold(0, at_least=False)
    for name in ("records_lost", "double_executions", "commands_after_fencing", "left_open", "unattributed")
}


@dataclass(slots=True, kw_only=True)
class Case(Attacked):
    """One run, on which host, for how long [s], and how many claims were fenced."""

    host: str
    lasts_s: float
    fenced: int = 0


def run_case(case: Case, stage: Stage, clock: Clock) -> None:
    """One goal, one attack."""
    began_s = clock.now_s()
    stage.pursue(case.number)
    wait(stage, lambda: find_goal(stage, case) is not None, START_S, clock)
    wait(stage, lambda: False, case.delay_s, clock)
    case.host = find_busy(stage, np.random.default_rng(case.number)) or case.host
    attack(case, stage, clock)
    wait(stage, lambda: is_over(stage, case), LIMIT_S, clock)
    stage.dismiss_agent()
    wait(stage, lambda: not find_open(stage), SETTLE_S, clock)
    judge(case, stage)
    case.wall_s = clock.now_s() - began_s


def wait(stage: Stage, is_done: object, limit_s: float, clock: Clock) -> None:
    """Until something holds; processes that end meanwhile are started again."""
    end_s = clock.now_s() + limit_s
    while clock.now_s() < end_s:
        stage.tend()
        with contextlib.suppress(OSError):
            if callable(is_done) and is_done():
                return
        clock.sleep(0.1)


def attack(case: Case, stage: Stage, clock: Clock) -> None:
    """Strike, wait, and let go."""
    name = case.host if "host" in case.victim else case.victim
    links = [each for name in ([name] if name in stage.links else stage.links) for each in stage.links[name]]
    if case.attack == KILL:
        victims = [*SERVERS] if name == "every server" else [stage.find_leader() if name == "leader" else name]
        for each in victims:
            stage.kill(each, case.lasts_s, alone=case.victim == "process of a host")
        return
    if case.attack == STOP:
        stage.send(name, signal.SIGSTOP)
    elif case.attack == CHANGE:
        stage.find_leader(steps_down=True)
    elif case.attack == CLOCK_OFF:
        stage.shift_clock(name, is_off=True)
    elif case.attack == FULL:
        stage.fill_disk(name)
    for link in links:
        link.is_cut, link.loses_answers = case.attack == CUT, case.attack == LOSE
        link.delay_s = DELAY_S if case.attack == DELAY else 0.0
        link.loss, link.copies = LOSS if case.attack == LOSSY else 0.0, 2 if case.attack == TWICE else 1
    wait(stage, lambda: False, case.lasts_s, clock)
    if case.attack == STOP:
        stage.send(name, signal.SIGCONT)
    elif case.attack == CLOCK_OFF:
        stage.shift_clock(name, is_off=False)
    elif case.attack == FULL:
        stage.empty_disk(name)
    for link in links:
        link.mend()


def find_goal(stage: Stage, case: Case) -> object:
    """The goal of a case, None before it is submitted."""
    return stage.read("hub")[0].goals.get(f"chaos-{case.number}")


def is_over(stage: Stage, case: Case) -> bool:
    """Whether it has its verdict."""
    goal = stage.read("hub")[0].goals.get(f"chaos-{case.number}")
    return goal is not None and bool(goal.verdict)


def find_open(stage: Stage) -> list[str]:
    """What is not over everywhere: live sessions, and records that the hub does not have."""
    found = [
        f"{place}: {each.contract.id} is {each.state}"
        for place in ("hub", *HOSTS)
        for each in stage.read(place)[0].sessions.values()
        if each.state not in FINAL_STATES
    ]
    return found + [f"lane {host}" for host in HOSTS if not is_same(stage, host)]


def is_same(stage: Stage, host: str) -> bool:
    """Whether the lane of a host is byte by byte the same on the hub."""
    own, copy = stage.folder / host / "sessions" / host, stage.folder / "hub" / "fleet" / host / "sessions" / host
    written = [path for path in own.glob("*.*.md") if b"<!-- phy1" in path.read_bytes()]  # one may have just begun
    return all(
        (copy / each.name).is_file() and (copy / each.name).read_bytes() == each.read_bytes() for each in written
    )


def judge(case: Case, stage: Stage) -> None:
    """What journals and receive logs say in the end."""
    ledger, records = stage.read("hub")
    prefix = f"chaos-{case.number}."
    for text in find_open(stage):
        case.blame("records_lost" if text.startswith("lane") else "left_open", text)
    for place in ("hub", *HOSTS, *(f"hub/fleet/{host}" for host in HOSTS)):
        if any((stage.folder / place).glob("sessions/*/*.*.md")) and not check_journal(stage.folder / place).is_whole:
            case.blame("records_lost", f"{place} is not whole")
    sessions = [each for id, each in ledger.sessions.items() if id.startswith(prefix)]
    goal = ledger.goals.get(f"chaos-{case.number}")
    case.verdict = goal.verdict if goal is not None and goal.verdict else "none"
    case.causes = [cause for each in sessions for cause in find_causes(each)]
    if case.verdict != "success" and not (case.verdict == "failure" and {*case.causes} & {*CODES}):
        case.blame("unattributed", f"{case.verdict}: {goal.reason if goal else 'no goal'}; causes {case.causes}")
    fenced = {each.id: each.at for each in records if each.ev == "lose" and "did not renew" in each.markdown}
    case.fenced = sum(id.startswith(prefix) for id in fenced)
    for session, commands in read_commands(stage).items():
        if not session.startswith(prefix):
            continue
        if len({(host, number) for host, number, _ in commands}) > 1:
            case.blame("double_executions", f"{session}: {sorted({each[:2] for each in commands})}")
        late = [at for _, _, at in commands if session in fenced and at > read_time(fenced[session])]
        if late:
            case.blame("commands_after_fencing", f"{session}: {len(late)} after {fenced[session]}")


def read_time(text: str) -> float:
    """Wall time [s]; hub and hosts of this benchmark have one clock, but for one that was set ahead."""
    at_s, now_s = (datetime.datetime.fromisoformat(each).timestamp() for each in (text, SystemClock().wall_iso()))
    return at_s - (CLOCK_OFF_S if at_s > now_s + CLOCK_OFF_S / 2 else 0)


def read_commands(stage: Stage) -> dict[str, list[tuple[str, int, float]]]:
    """Session -> host, number of the Begin before it and wall time of each command that a target accepted."""
    found: dict[str, list[tuple[str, int, float]]] = defaultdict(list)
    for host in HOSTS:
        begins = 0
        for log in sorted((stage.folder / host / "logs").glob("receive-*.jsonl")):
            for text in log.read_bytes().split(b"\n"):
                with contextlib.suppress(ValueError):
                    line = json.loads(text)
                    begins += line["kind"] == "Begin"
                    if line["kind"] == "Command" and line.get("accepted", True):
                        found[line["session"]].append((host, begins, read_time(line["at"])))
    return found


def find_causes(status: SessionStatus) -> list[str]:
    """Coded causes of a session that did not succeed."""
    if status.state == SessionState.SUCCEEDED:
        return []
    coded = [attempt.cause for attempt in status.attempts if attempt.cause]
    coded = coded or [problem.code for problem in status.problems]
    return coded or ([status.execution.code] if status.execution is not None and status.execution.code else [])


def find_busy(stage: Stage, chance: np.random.Generator) -> str | None:
    """A host that holds a session now: an attack on an idle one proves little."""
    busy = [
        host
        for host in HOSTS
        if any(each.state == SessionState.RUNNING for each in stage.read(host)[0].live_sessions())
    ]
    return str(chance.choice(busy)) if busy else None


def make_cases(runs: int, seed: int, cut_max_s: float, only: Sequence[str] = ()) -> list[Case]:
    """Attacks in turn, at random moments, for random times."""
    chance, cases = np.random.default_rng(seed), list[Case]()
    cells = [cell for cell in CELLS if not only or {*only} & {*cell}]
    for index in range(runs):
        victim, kind = cells[index % len(cells)]
        lasts_s = float(chance.uniform(1.0, cut_max_s if kind in {CUT, LOSE} else 25.0))
        lasts_s = LEASE_S + GRACE_S + 5.0 if kind == STOP else lasts_s
        host = str(chance.choice([*HOSTS]))
        cases.append(
            Case(
                number=1000 * seed + index,
                victim=victim,
                attack=kind,
                host=host,
                delay_s=float(chance.uniform(0.0, SPREAD_S)),
                lasts_s=lasts_s,
            )
        )
    return cases


def show(cases: Sequence[Case]) -> None:
    """The table, by victim and attack."""
    rows = []
    for victim, kind in sorted({(case.victim, case.attack) for case in cases}):
        group = [case for case in cases if (case.victim, case.attack) == (victim, kind)]
        broken = sum((case.problems for case in group), Counter[str]())
        met = sum(case.verdict == "success" for case in group)
        fenced = sum(case.fenced for case in group)
        rows.append(
            (victim, kind, len(group), met, fenced, ", ".join(f"{n} {name}" for name, n in broken.items()) or "0")
        )
    show_table(f"{len(cases)} attacks", ("victim", "attack", "runs", "goal met", "fenced", "broken promises"), rows)


def main(
    *,
    runs: int = 40,
    seed: Annotated[int, Option(help="draws victims, moments and times; which is also in each goal's id")] = 0,
    cut_max_s: Annotated[float, Option(help="the longest that a link is cut [s]")] = 120.0,
    only: Annotated[list[str], Option(help="victims or attacks; others are left out")] = (),
    noop: Annotated[int, Option(help="sessions without work, on one host and on all")] = 0,
    hosts: Annotated[int, Option(help="simulated hosts of those")] = 16,
    keep: Annotated[Path | None, Option(help="where the fleet is copied to when a promise was broken")] = None,
) -> int:
    """Attack, measure, show, and exit with whether every promise was kept."""
    console, clock = Console(stderr=True), SystemClock()
    cases = make_cases(runs, seed, cut_max_s, only)
    with tempfile.TemporaryDirectory(prefix="fleet-") as scratch:
        if cases:
            with contextlib.closing(Stage(Path(scratch), clock)) as stage:
                for case in cases:
                    run_case(case, stage, clock)
                    what = f"{case.number}: {case.attack} on {case.victim} ({case.host}), {case.lasts_s:.0f} s"
                    text = f"{what}, after {case.delay_s:.1f} s: {case.verdict}  {case.wall_s:.0f} s"
                    console.print(text, *case.causes, *case.notes, sep="  ", markup=False)
            if keep is not None and any(case.problems for case in cases):
                shutil.copytree(scratch, keep, dirs_exist_ok=True)
        figures = measure_noop(Path(scratch), noop, hosts) if noop else {}
    show(cases)
    figures |= {name: float(sum(case.problems[name] for case in cases)) for name in ASKED}
    figures["fenced"] = float(sum(case.fenced for case in cases))
    figures |= {"runs": float(runs), "goals_met": float(sum(case.verdict == "success" for case in cases))}
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
