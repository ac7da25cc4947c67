"""LangGraph: SQLite checkpointer, durability `sync`: a checkpoint a superstep, so one a task in a chain."""

import itertools
import operator
from pathlib import Path
from typing import Annotated, TypedDict

from langgraph.checkpoint.sqlite import SqliteSaver
from langgraph.graph import END, START, StateGraph
from timing import measure, note

RUNS = itertools.count()


class State(TypedDict):
    """How many tasks were done."""

    done: Annotated[int, operator.add]


def run(edges: list[list[int]], scratch: Path) -> int:
    """One thread of the graph; how many nodes ran."""
    builder = StateGraph(State)
    followed = {before for befores in edges for before in befores}
    for index, befores in enumerate(edges):
        builder.add_node(f"n{index}", lambda state: {"done": 1})
        if befores:
            builder.add_edge([f"n{before}" for before in befores], f"n{index}")
        else:
            builder.add_edge(START, f"n{index}")
        if index not in followed:
            builder.add_edge(f"n{index}", END)
    with SqliteSaver.from_conn_string(str(scratch / "langgraph.sqlite")) as saver:
        graph = builder.compile(checkpointer=saver)
        config = {"configurable": {"thread_id": str(next(RUNS))}, "recursion_limit": len(edges) + 10}
        return graph.invoke({"done": 0}, config, durability="sync")["done"]


def recover(n: int, log: str, scratch: Path) -> None:
    """One thread by its name: from its last checkpoint, where it has one."""
    builder = StateGraph(State)
    names = [START, *(f"n{index}" for index in range(n)), END]
    for index, name in enumerate(names[1:-1]):
        builder.add_node(name, lambda state, index=index: note(log, index) or {"done": 1})
    for before, after in itertools.pairwise(names):
        builder.add_edge(before, after)
    with SqliteSaver.from_conn_string(str(scratch / "langgraph.sqlite")) as saver:
        graph = builder.compile(checkpointer=saver)
        config = {"configurable": {"thread_id": "walk"}, "recursion_limit": n + 10}
        begun = graph.get_state(config).values  # not `next`: a task whose writes are kept is not named there
        graph.invoke(None if begun else {"done": 0}, config, durability="sync")


if __name__ == "__main__":
    measure("langgraph", "SQLite, a checkpoint a superstep", "1", run, recover)
