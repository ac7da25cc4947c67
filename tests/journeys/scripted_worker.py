"""A worker process without a target, which behaves as a plan says: one entry for each process that is started.

    python -m tests.journeys.scripted_worker PLAN.json --control FD

An entry maps `start`, `check`, `run` and `reconcile` to a behaviour; what it leaves out goes well.
"""

import json
import os
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path

from phyagentos.clock import SystemClock
from phyagentos.errors import Problem
from phyagentos.protocol.sessions.session import Ended, Execution
from phyagentos.runtime.preflight.adapter_plan import AdapterPlan, TargetToolManifest
from phyagentos.runtime.worker.orders import (
    Check,
    Checked,
    Finished,
    Ready,
    Reconcile,
    Run,
    Stop,
    encode,
    receive_order,
)

CLOCK = SystemClock()
SLOW_S = 0.1  # longer than a check is hidden
PLAN = AdapterPlan(target_adapter="a", skill_runtime="s", tree="t", observation_path=(), action_path=())


def read_entry(plan: Path) -> dict[str, str]:
    """The entry of this process; the last one serves all that follow."""
    with plan.with_suffix(".starts").open("ab") as starts:
        starts.write(b".")
        number = starts.tell() - 1
    entries = json.loads(plan.read_text())
    return entries[min(number, len(entries) - 1)]


def wait_for_stop(control) -> str:
    while not isinstance(order := receive_order(control), Stop):
        pass
    return order.reason


def check(control, order: Check, how: str) -> Checked:
    id = order.session.id
    if how in {"die", "slow lost", "hang"}:
        CLOCK.sleep(SLOW_S)
    if how == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "hang":
        CLOCK.sleep(60.0)
    if how == "until stopped":
        wait_for_stop(control)
    if how in {"refuse", "refuse and leave", "slow lost"}:
        code = "TARGET_LOST" if how == "slow lost" else "SKILL_UNKNOWN"
        return Checked(session=id, plan=None, tools=None, problems=(Problem(code=code, address=id),))
    return Checked(session=id, plan=PLAN, tools=TargetToolManifest(expose=()))


def run(control, order: Run, how: str) -> Finished:
    if how == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "deaf":
        CLOCK.sleep(60.0)
    ended = Ended(wait_for_stop(control)) if how == "until stopped" else Ended.COMPLETED
    return Finished(session=order.session.id, execution=Execution(ended=ended, evidence=order.evidence))


def reconcile(order: Reconcile, how: str) -> Finished:
    if how == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    execution = Execution(ended=order.ended, evidence=order.evidence, message=order.reason)
    return Finished(session=order.session.id, execution=execution, is_target_lost=how == "lost")


def main() -> None:
    entry = read_entry(Path(sys.argv[1]))
    control = Connection(int(sys.argv[3]))
    control.recv_bytes()  # the token for its target, which it does not have
    if entry.get("start") == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    control.send_bytes(encode(Ready()))
    while True:
        match receive_order(control):
            case Check() as order:
                control.send_bytes(encode(check(control, order, entry.get("check", ""))))
                if entry.get("check") == "refuse and leave":
                    CLOCK.sleep(SLOW_S)
                    return
            case Run() as order:
                control.send_bytes(encode(run(control, order, entry.get("run", ""))))
            case Reconcile() as order:
                control.send_bytes(encode(reconcile(order, entry.get("reconcile", ""))))


if __name__ == "__main__":
    main()
