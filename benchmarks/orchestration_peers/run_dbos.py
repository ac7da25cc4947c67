"""DBOS: one workflow, a step with its checkpoint in SQLite for each task."""

import logging
from pathlib import Path

from dbos import DBOS, SetWorkflowID
from timing import measure, note

STARTED: list[DBOS] = []
COUNT = [0]


@DBOS.step()
def no_op(index: int) -> int:
    """Nothing but a count."""
    COUNT[0] += 1
    return index


@DBOS.workflow()
def walk(n: int) -> int:
    """Every task in an order that respects every edge."""
    for index in range(n):
        no_op(index)
    return n


@DBOS.step()
def noted(log: str, index: int) -> None:
    """A step that is seen from outside."""
    note(log, index)


@DBOS.workflow()
def walk_noted(n: int, log: str) -> None:
    """A chain of such steps."""
    for index in range(n):
        noted(log, index)


def launch(scratch: Path) -> None:
    """Begin, and go on with workflows that have not ended."""
    url = f"sqlite:///{scratch / 'dbos.sqlite'}"
    STARTED.append(DBOS(config={"name": "bench", "system_database_url": url, "log_level": "ERROR"}))
    DBOS.launch()


def recover(n: int, log: str, scratch: Path) -> None:
    """The same workflow by its name, whether it is new or goes on."""
    launch(scratch)
    with SetWorkflowID("walk"):
        DBOS.start_workflow(walk_noted, n, log).get_result()


def run(edges: list[list[int]], scratch: Path) -> int:
    """One workflow; how many steps ran."""
    if not STARTED:
        launch(scratch)
    before = COUNT[0]
    walk(len(edges))
    return COUNT[0] - before


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    measure("dbos", "SQLite, a checkpoint a step", "1", run, recover)
    DBOS.destroy()
