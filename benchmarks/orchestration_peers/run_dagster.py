"""Dagster: one job in this process, an instance with SQLite storage."""

import itertools
import logging
from pathlib import Path

from dagster import (
    DagsterInstance,
    DependencyDefinition,
    GraphDefinition,
    In,
    MultiDependencyDefinition,
    NodeInvocation,
    Nothing,
    op,
)
from timing import measure

RUNS = itertools.count()


@op(ins={"before": In(Nothing)})
def no_op() -> None:
    """Nothing."""


@op
def first() -> None:
    """Nothing, after nothing."""


def run(edges: list[list[int]], scratch: Path) -> int:
    """One run of a job; how many steps succeeded."""
    folder = scratch / f"dagster-{next(RUNS)}"
    folder.mkdir()
    dependencies = {}
    for index, befores in enumerate(edges):
        definition = no_op if befores else first
        after = [DependencyDefinition(f"n{before}") for before in befores]
        dependencies[NodeInvocation(definition.name, alias=f"n{index}")] = (
            {"before": MultiDependencyDefinition(after)} if after else {}
        )
    job = GraphDefinition("bench", node_defs=[no_op, first], dependencies=dependencies).to_job()
    with DagsterInstance.local_temp(str(folder), overrides={"telemetry": {"enabled": False}}) as instance:
        result = job.execute_in_process(instance=instance)
        return sum(event.is_step_success for event in result.all_events)


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    measure("dagster", "SQLite events", "1", run)
