"""Temporal: its development server with SQLite, one workflow, an activity for each task."""

import asyncio
import atexit
import itertools
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path
from subprocess import DEVNULL

from temporalio import activity, workflow
from temporalio.client import Client
from temporalio.common import WorkflowIDConflictPolicy
from temporalio.worker import Worker

with workflow.unsafe.imports_passed_through():
    from timing import build_edges, measure, note

QUEUE, START_S, AT_ONCE = "bench", 30.0, 100
TASK_LIMIT = timedelta(seconds=5)  # an activity whose worker died is begun again after it
RUNS = itertools.count()
WAITING: list[asyncio.Task[None]] = []
BEGUN: list[tuple[asyncio.Runner, Client]] = []


@activity.defn
def no_op(index: int, log: str) -> int:
    """Nothing; with a log, what is seen from outside."""
    if log:
        note(log, index)
    return index


@workflow.defn
class Walk:
    """Every task as soon as those before it are done."""

    @workflow.run
    async def run(self, edges: list[list[int]], log: str) -> int:
        """How many were done."""
        tasks: list[asyncio.Task[int]] = []

        async def carry_out(index: int, befores: list[int]) -> int:
            for before in befores:
                await tasks[before]
            return await workflow.execute_activity(no_op, args=(index, log), start_to_close_timeout=TASK_LIMIT)

        tasks.extend(asyncio.create_task(carry_out(index, befores)) for index, befores in enumerate(edges))
        return len([await task for task in tasks])


def launch(scratch: Path) -> str:
    """Start the server over a file; its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    program = Path(sys.executable).with_name("temporal")
    stored = ["--db-filename", str(scratch / "temporal.sqlite"), "--log-level", "never"]
    server = subprocess.Popen([program, "server", "start-dev", "--headless", "--port", port, *stored], stdout=DEVNULL)
    atexit.register(server.kill)
    return f"127.0.0.1:{port}"


async def serve(address: str) -> Client:
    """Connect as soon as the server answers, and let a worker wait for what comes."""
    loop = asyncio.get_running_loop()
    until_s = loop.time() + START_S
    while True:
        try:
            client = await Client.connect(address)
            break
        except RuntimeError:
            if loop.time() > until_s:
                raise
            await asyncio.sleep(0.05)
    threads = ThreadPoolExecutor(AT_ONCE)
    worker = Worker(client, task_queue=QUEUE, workflows=[Walk], activities=[no_op], activity_executor=threads)
    WAITING.append(asyncio.create_task(worker.run()))
    return client


def begin(scratch: Path) -> tuple[asyncio.Runner, Client]:
    """The one server and worker of this process."""
    if not BEGUN:
        runner = asyncio.Runner()
        BEGUN.append((runner, runner.run(serve(launch(scratch)))))
    return BEGUN[0]


def run(edges: list[list[int]], scratch: Path) -> int:
    """One workflow; how many activities ran."""
    runner, client = begin(scratch)
    walk = client.execute_workflow(Walk.run, args=(edges, ""), id=f"walk-{next(RUNS)}", task_queue=QUEUE)
    return runner.run(walk)


def recover(n: int, log: str, scratch: Path) -> None:
    """The same workflow by its name, whether it is new or goes on."""
    runner, client = begin(scratch)
    goes_on = WorkflowIDConflictPolicy.USE_EXISTING
    edges = build_edges("chain", n)
    walk = client.execute_workflow(Walk.run, args=(edges, log), id="walk", task_queue=QUEUE, id_conflict_policy=goes_on)
    runner.run(walk)


if __name__ == "__main__":
    measure("temporalio", "SQLite, each activity's begin and end", "1", run, recover)
