"""A goal of a thousand nodes with sessions, and what a refresh of its page takes."""

import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from phyagentos.clock import SystemClock
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.journal import Entry, Journal
from phyagentos.view.documents import Documents
from phyagentos.view.pages import PanelRenderer
from phyagentos.view.panels import PANELS, Query

NODES, DONE = 1000, 300
GOAL = "big-7"


@dataclass
class Spent:
    """Wall and CPU time of each refresh [ms]."""

    wall_ms: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)


class Stopwatch:
    """Adds what has passed since it was started to a `Spent`."""

    def __init__(self) -> None:
        self._wall_s, self._cpu_s = time.perf_counter(), time.thread_time()

    def stop(self, spent: Spent) -> None:
        """Add both times."""
        spent.wall_ms.append(1e3 * (time.perf_counter() - self._wall_s))
        spent.cpu_ms.append(1e3 * (time.thread_time() - self._cpu_s))


def measure_refreshes(root: Path, real: Path, count: int) -> dict[str, Spent]:
    """Times of a refresh after each of `count` records: of the whole page, of reading, and of each panel.

    `first` is what the first viewer of a server waits for: reading all, and templates that are not compiled yet.
    """
    workspace = Workspace.create(root, Library.open(find_shipped_root()))
    agent, runtime = (
        Journal(root, side=side, by=side.value, clock=SystemClock(), durable=False)
        for side in (Side.AGENT, Side.RUNTIME)
    )
    last = _write_history(workspace, agent, runtime, real)
    spent = {name: Spent() for name in ("first", "page", "reading", *(panel.name for panel in PANELS))}
    whole = Stopwatch()
    documents = Documents(root)
    documents.refresh()
    renderer = PanelRenderer(documents, lambda: {"actions": True, "live": True})
    for panel in PANELS:
        renderer.render(panel, Query(session=last))
    whole.stop(spent["first"])
    for index in range(count):
        agent.read_new()
        agent.commit([Entry(f"node:{GOAL}/n{DONE + index}", "node_ready", {})])
        whole = Stopwatch()
        part = Stopwatch()
        documents.refresh()
        part.stop(spent["reading"])
        for panel in PANELS:
            part = Stopwatch()
            renderer.render(panel, Query(session=last))
            part.stop(spent[panel.name])
        whole.stop(spent["page"])
    agent.close()
    runtime.close()
    return spent


def _write_history(workspace: Workspace, agent: Journal, runtime: Journal, real: Path) -> str:
    """The goal and its sessions, each as one of a real run went; the id of the last one, which has its evidence too."""
    model = next(each for each in read_ledger(real).sessions.values() if each.decision is not None)
    nodes = {
        f"n{index}": {
            "objective": f"Do {index}.",
            "skill": model.contract.skill,
            "target": model.contract.target,
            "after": [f"n{index - 7}"] if index >= 7 else [],
        }
        for index in range(NODES)
    }
    goal = f"goal:{GOAL}"
    agent.commit(
        [
            Entry(goal, "goal_submitted", {"graph": "big", "seed": 7, "objective": "Much."}),
            Entry(goal, "goal_compiled", {"nodes": nodes, "accept": [], "constraints": []}),
        ]
    )
    id = ""
    for index in range(DONE):
        id = f"{GOAL}.n{index}"
        contract = msgspec.structs.replace(model.contract, id=id, goal=GOAL, node=f"n{index}")
        _write_session(agent, runtime, contract, model.execution, model.decision)
    shutil.copytree(real / "evidence" / model.contract.id, workspace.evidence_of(id))
    shutil.copytree(real / "evidence" / "objects", workspace.evidence / "objects", dirs_exist_ok=True)
    return id


def _write_session(agent: Journal, runtime: Journal, contract: Session, execution: object, attempt: object) -> None:
    node = f"node:{GOAL}/{contract.node}"
    agent.read_new()
    agent.commit([Entry(node, "node_ready", {}), Entry(contract.id, "submit", msgspec.to_builtins(contract))])
    runtime.read_new()
    epoch = runtime.commit([Entry(contract.id, "claim", {})])[-1].epoch
    runtime.commit([Entry(contract.id, event, {}, epoch) for event in ("check", "start", "halt")])
    runtime.commit([Entry(contract.id, "finish", {"execution": msgspec.to_builtins(execution)}, epoch)])
    agent.read_new()
    agent.commit([Entry(contract.id, "verify", {})])
    agent.commit(
        [Entry(contract.id, "accept", {"attempt": msgspec.to_builtins(attempt)}), Entry(node, "node_done", {})]
    )
