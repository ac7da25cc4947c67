"""Processes are attacked at random times while a goal of three sessions is pursued: does anything move that must not?

    python benchmarks/chaos.py --runs 200                    # both modes in turn, two runs side by side
    python benchmarks/chaos.py --runs 16 --mode realtime     # one attack of each kind on worlds that keep real time

Agent, watchdog, worker, planner and world are each killed (`kill -9`), stopped for longer than the lease (SIGSTOP, then
SIGCONT), or find the disk full: every write of that one process fails (RLIMIT_FSIZE is set to 0 from outside: EFBIG
where a full disk gives ENOSPC, on the same paths); and, where a small tmpfs can be mounted, the workspace's own file
system is filled up, so that all of them get ENOSPC at once. What dies of agent and watchdog is started again, as a
service manager would; the disk has room again after some seconds. Then the goal must come to its end, and
journal and receive log are judged. What is promised: no session is
carried out twice, no command is accepted after its session has left `running`, none stays open, every goal ends in
success or in a failure with a coded cause, a success is one in the simulator's last state, no process is left over.
"""

import contextlib
import json
import os
import shutil
import signal
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from rich.console import Console
from rich.table import Table
from typer import Option

from benchmarks.attacked import Attacked
from benchmarks.chaos_planes import Planes, allow_writes, fill, prepare, refuse_writes, small_disk
from benchmarks.runner import finish, run
from phyagentos.bench.report import Threshold
from phyagentos.bench.scorers.simulator_state import is_in_tray
from phyagentos.clock import Clock, SystemClock
from phyagentos.codes import CODES
from phyagentos.protocol.sessions.lifecycle import FINAL_STATES, SessionState
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # the monitor lies with the tests

from tests.monitors.silence import count_commands, find_violations  # noqa: E402 - see above

GRAPH = ROOT / "goal_graphs" / "tidy_table.yaml"
VICTIMS = ("agent", "watchdog", "worker", "planner", "world")
KILL, STOP, FULL = "kill -9", "SIGSTOP", "full disk"
CELLS = (
    *((victim, KILL) for victim in ("watchdog", "world", "worker", "agent", "planner")),
    ("everybody", FULL),
    *((victim, STOP) for victim in VICTIMS),
    *((victim, FULL) for victim in VICTIMS),
)
MODES = ("lockstep", "realtime")
CUBES = (("red_cube", "red_tray"), ("green_cube", "green_tray"), ("blue_cube", "blue_tray"))
LEASE_S = 5.0  # of these workspaces: shipped ones have 15 s, which only makes a stop take longer
HEARTBEAT_S = 4.0  # likewise; both are many times what a busy machine keeps a process waiting
STOP_S = 8.0  # longer than lease and silence
FULL_S = 4.0
SPREAD_S = {"lockstep": 8.0, "realtime": 22.0}  # about what the goal takes, from its submission on
START_S = 30.0  # a plane is ready long before, also on a machine that is busy
LIMIT_S = 240.0  # nothing that recovers takes this long
DISK_MB = 48
CALM_LOOKS = 3  # a watchdog that is being killed holds its lock for an instant longer
ASKED = {
    name: Threshold(0, at_least=False)
    for name in ("double_executions", "violations", "left_open", "false_success", "unattributed", "left_over")
}


@dataclass(slots=True, kw_only=True)
class Case(Attacked):
    """One run, in which mode, and its commands."""

    mode: str
    commands: int = 0


def run_case(case: Case, folder: Path, keep: Path | None, clock: Clock) -> None:
    """One workspace, one goal, one attack."""
    folder.mkdir()
    began_s = clock.now_s()
    with contextlib.ExitStack() as stack:
        has_disk = case.victim == "everybody" and stack.enter_context(small_disk(folder, DISK_MB))
        root = folder / "w"
        graph = prepare(root, GRAPH, LEASE_S, HEARTBEAT_S)
        planes = Planes(root, graph, case.number, clock, case.mode)
        try:
            wait_for_submission(planes, clock)
            attack(case, planes, clock, has_disk=has_disk)
            while not planes.tend() and clock.now_s() - began_s < LIMIT_S:
                clock.sleep(0.1)
            settle(planes, clock)
        finally:
            left = planes.stop()
        case.wall_s = clock.now_s() - began_s
        for name in left:
            case.blame("left_over", f"{name} was still there")
        goal, sessions = planes.read_goal()
        judge(case, goal, sessions)
        judge_world(case, root, sessions)
        judge_log(case, root)
        if keep is not None and (case.problems or case.verdict != "success"):
            shutil.copytree(folder, keep / f"{case.number}", dirs_exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)


def wait_for_submission(planes: Planes, clock: Clock) -> None:
    """Until the goal stands in the journal."""
    deadline_s = clock.now_s() + LIMIT_S
    while planes.read_goal()[0] is None and clock.now_s() < deadline_s:
        clock.sleep(0.05)


def settle(planes: Planes, clock: Clock) -> None:
    """After the verdict: sessions that are still open have a moment to end, and who was started last to get ready."""
    deadline_s = clock.now_s() + START_S
    calm = 0
    while clock.now_s() < deadline_s:
        planes.tend()
        is_open = any(status.state not in FINAL_STATES for status in planes.read_goal()[1])
        calm = calm + 1 if not is_open and planes.is_watched() else 0
        if calm == CALM_LOOKS:
            return
        clock.sleep(0.1)


def attack(case: Case, planes: Planes, clock: Clock, *, has_disk: bool) -> None:
    """Wait for the moment, then strike; the planes are tended meanwhile."""
    wait(planes, case.delay_s, clock)
    if case.victim == "everybody":
        if has_disk:
            ballast = fill(planes.root.parent)
            wait(planes, FULL_S, clock)
            ballast.unlink()
        else:
            case.attack = f"{FULL}: not possible here"
        return
    pid = planes.find(case.victim)
    deadline_s = clock.now_s() + START_S
    while pid is None and clock.now_s() < deadline_s and not planes.tend():
        clock.sleep(0.02)
        pid = planes.find(case.victim)
    if pid is None:
        return
    with contextlib.suppress(ProcessLookupError):
        if case.attack == KILL:
            os.kill(pid, signal.SIGKILL)
        elif case.attack == STOP:
            os.kill(pid, signal.SIGSTOP)
            wait(planes, STOP_S, clock)
            os.kill(pid, signal.SIGCONT)
        else:
            refuse_writes(pid)
            wait(planes, FULL_S, clock)
            allow_writes(planes.root)


def wait(planes: Planes, duration_s: float, clock: Clock) -> None:
    """Let time pass; processes that end meanwhile are started again."""
    end_s = clock.now_s() + duration_s
    while (left_s := end_s - clock.now_s()) > 0.0:
        clock.sleep(min(0.1, left_s))
        planes.tend()


def judge(case: Case, goal: GoalStatus | None, sessions: Sequence[SessionStatus]) -> None:
    """What the journal says in the end."""
    for status in sessions:
        if status.state not in FINAL_STATES:
            case.blame("left_open", f"{status.contract.id} is {status.state}")
        case.causes += find_causes(status)
    case.verdict = goal.verdict if goal is not None and goal.verdict else "none"
    known = [code for code in case.causes if code in CODES]
    if case.verdict != "success" and not (case.verdict == "failure" and known):
        case.blame("unattributed", f"{case.verdict}: {goal.reason if goal else 'no goal'}; causes {case.causes}")


def judge_world(
    case: Case, root: Path, sessions: Sequence[SessionStatus], cubes: Sequence[tuple[str, str]] = CUBES
) -> None:
    """A success must be one: in the last recorded state of the simulator, seen by an eye of its own."""
    folders = [root / status.execution.evidence for status in sessions if status.execution is not None]
    seen = sorted((folder / "terminal.npz" for folder in folders if (folder / "terminal.npz").exists()), key=_get_age)
    if case.verdict == "success":
        missed = [cube for cube, tray in cubes if not seen or not is_in_tray(seen[-1].parent, cube, tray)]
        if missed:
            case.blame("false_success", f"{', '.join(missed)} not in its tray")


def _get_age(path: Path) -> int:
    return path.stat().st_mtime_ns


def find_causes(status: SessionStatus) -> list[str]:
    """Coded causes of a session that did not succeed."""
    if status.state == SessionState.SUCCEEDED:
        return []
    coded = [attempt.cause for attempt in status.attempts if attempt.cause]
    coded = coded or [problem.code for problem in status.problems]
    return coded or ([status.execution.code] if status.execution is not None and status.execution.code else [])


def judge_log(case: Case, root: Path) -> None:
    """What the targets accepted."""
    case.commands += count_commands(root)
    for violation in find_violations(root):
        case.blame("violations", str(violation))
    for session, claims in read_executions(root).items():
        if len(claims) > 1:
            case.blame("double_executions", f"{session}: commands under {sorted(claims)}")


def read_executions(root: Path) -> dict[str, set[tuple[int, int]]]:
    """Session -> when it was carried out: process of the target and epoch of each Begin that commands followed."""
    found: dict[str, set[tuple[int, int]]] = defaultdict(set)
    for log in sorted((root / "logs").glob("receive-*.jsonl")):
        begins = 0
        for text in log.read_bytes().split(b"\n"):
            with contextlib.suppress(ValueError):
                line = json.loads(text)
                begins += line["kind"] == "Begin" and line.get("accepted", True)
                if line["kind"] == "Command" and line.get("accepted", True):
                    found[line["session"]].add((begins, line["epoch"]))
    return found


def show(cases: Sequence[Case], console: Console) -> None:
    """The table, by victim and attack."""
    table = Table(
        "time",
        "victim",
        "attack",
        "runs",
        "goal met",
        "failed, attributed",
        "broken promises",
        "s, median",
        title=f"{len(cases)} attacks on a goal of three sessions",
    )
    for mode, victim, kind in sorted({(case.mode, case.victim, case.attack) for case in cases}):
        group = [case for case in cases if (case.mode, case.victim, case.attack) == (mode, victim, kind)]
        met = sum(case.verdict == "success" for case in group)
        attributed = sum(case.verdict == "failure" and not case.problems["unattributed"] for case in group)
        broken = sum((case.problems for case in group), Counter())
        text = ", ".join(f"{count} {name}" for name, count in sorted(broken.items())) or "0"
        median_s = float(np.median([case.wall_s for case in group]))
        table.add_row(mode, victim, kind, str(len(group)), str(met), str(attributed), text, f"{median_s:.1f}")
    console.print(table)


def main(
    *,
    runs: int = 200,
    seed: Annotated[int, Option(help="draws the moments; which is also in each goal's id")] = 0,
    at_once: Annotated[int, Option("--at-once", "--jobs", help="runs side by side, each in its workspace")] = 2,
    mode: Annotated[Literal[*MODES, "both"], Option(help="how the worlds keep time")] = "both",
    only: Annotated[list[str], Option(help="victims or attacks; others are left out")] = (),
    keep: Annotated[Path | None, Option(help="where workspaces of goals that were not met are copied to")] = None,
) -> int:
    """Attack, show, and exit with whether every promise was kept."""
    console, clock = Console(stderr=True), SystemClock()
    cells = [cell for cell in CELLS if not only or {*only} & {*cell}]
    moments = np.random.default_rng(seed).uniform(0.0, 1.0, runs)
    modes = MODES if mode == "both" else (mode,)
    cases = []
    for index, moment in enumerate(moments):
        victim, kind = cells[index % len(cells)]
        mode = modes[sum(divmod(index, len(cells))) % len(modes)]  # each cell in every mode, modes side by side
        cases.append(
            Case(
                number=1000 * seed + index,
                victim=victim,
                attack=kind,
                mode=mode,
                delay_s=SPREAD_S[mode] * float(moment),
            )
        )
    with tempfile.TemporaryDirectory(prefix="chaos-") as scratch:

        def run(case: Case) -> None:
            run_case(case, Path(scratch) / str(case.number), keep, clock)
            what = f"{case.attack} on {case.victim}, {case.mode}, after {case.delay_s:.1f} s"
            text = f"{case.number}: {what}: {case.verdict}"
            console.print(text, f"{case.wall_s:.0f} s", *case.causes, *case.notes, sep="  ", markup=False)

        with ThreadPoolExecutor(at_once) as pool:
            list(pool.map(run, cases))
    show(cases, Console())
    figures = {name: float(sum(case.problems[name] for case in cases)) for name in ASKED}
    figures |= {
        **{f"runs_{mode}": float(sum(case.mode == mode for case in cases)) for mode in modes},
        **{f"goals_met_{mode}": float(sum(c.mode == mode and c.verdict == "success" for c in cases)) for mode in modes},
        "runs": float(len(cases)),
        "goals_met": float(sum(case.verdict == "success" for case in cases)),
        "failures_attributed": float(
            sum(case.verdict == "failure" and not case.problems["unattributed"] for case in cases)
        ),
        "commands": float(sum(case.commands for case in cases)),
    }
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
