"""DBOS: one workflow, a step with its checkpoint in SQLite for each task."""

import logging
from pathlib import Path

from dbos import DBOS
from timing import measure

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


def run(edges: list[list[int]], scratch: Path) -> int:
    """One workflow; how many steps ran."""
    if not STARTED:
        url = f"sqlite:///{scratch / 'dbos.sqlite'}"
        STARTED.append(DBOS(config={"name": "bench", "system_database_url": url, "log_level": "ERROR"}))
        DBOS.launch()
    before = COUNT[0]
    walk(len(edges))
    return COUNT[0] - before


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    measure("dbos", "SQLite, a checkpoint a step", "1", run)
    DBOS.destroy()
