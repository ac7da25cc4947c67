"""Prefect: a flow on the local server with SQLite, tasks on a thread pool."""

import os
import sys
import tempfile
import threading
from pathlib import Path

HOME = sys.argv[4] if sys.argv[1] == "recover" else tempfile.mkdtemp(prefix="prefect-")
os.environ |= {
    "PREFECT_HOME": HOME,
    "PREFECT_LOCAL_STORAGE_PATH": f"{HOME}/storage",
    "PREFECT_SERVER_ALLOW_EPHEMERAL_MODE": "true",
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "PREFECT_LOGGING_LEVEL": "CRITICAL",
    "PREFECT_LOGGING_TO_API_ENABLED": "false",
    "PREFECT_CLI_PROMPT": "false",
    "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "90",
    "DO_NOT_TRACK": "1",
}

from prefect import flow, task  # noqa: E402
from prefect.cache_policies import INPUTS  # noqa: E402
from prefect.client.orchestration import get_client  # noqa: E402
from prefect.server.api.server import SubprocessASGIServer  # noqa: E402
from prefect.settings import PREFECT_API_URL, temporary_settings  # noqa: E402
from prefect.task_runners import ThreadPoolTaskRunner  # noqa: E402
from timing import measure, note  # noqa: E402 - Prefect reads its settings when it is imported

WORKERS = 8
COMPLETED = {"task_runs": {"state": {"type": {"any_": ["COMPLETED"]}}}}


@task
def no_op(index: int) -> int:
    """Nothing."""
    return index


@flow(task_runner=ThreadPoolTaskRunner(max_workers=WORKERS))
def walk(edges: list[list[int]]) -> None:
    """Every task after those before it."""
    futures = []
    for index, befores in enumerate(edges):
        futures.append(no_op.submit(index, wait_for=[futures[before] for before in befores]))
    for future in futures:
        future.wait()


@task(persist_result=True, cache_policy=INPUTS - "log")
def noted(index: int, log: str) -> int:
    """A task that is seen from outside, and is not run again where its result is kept."""
    note(log, index)
    return index


@flow
def walk_noted(n: int, log: str) -> None:
    """A chain of such tasks."""
    for index in range(n):
        noted(index, log)


def recover(n: int, log: str, scratch: Path) -> None:
    """A new run of the flow, which finds the results of the one before."""
    walk_noted(n, log)


def count_recorded() -> int:
    """Task runs that the server's database holds as completed."""
    with get_client(sync_client=True) as client:
        return int(client.request("POST", "/task_runs/count", json=COMPLETED).json())


def run(edges: list[list[int]], scratch: Path) -> int:
    """One flow, until the server has recorded it; how many task runs it recorded."""
    before = count_recorded()
    walk(edges)
    while (recorded := count_recorded() - before) < len(edges):
        threading.Event().wait(0.02)
    return recorded


if __name__ == "__main__":
    server = SubprocessASGIServer()
    server.start(timeout=90)  # not timed
    try:
        with temporary_settings({PREFECT_API_URL: server.api_url}):
            measure("prefect", "SQLite behind its API, no fsync", f"{WORKERS} threads", run, recover)
    finally:
        server.stop()
