"""The record that amends a goal, and the file with its whole graph, which is written before it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from phyagentos.agent.goals.amendment import compute_difference
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.mission.goal_facts import GoalFacts
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.admission import Entry, GoalEvent


@dataclass(frozen=True, slots=True, kw_only=True)
class Amender:
    """Amends the graph of one goal in its workspace."""

    facts: GoalFacts
    workspace: Workspace

    def read_authored(self) -> Any:
        """The present graph as it is written."""
        file = self.facts.ledger.goals[self.facts.goal].file
        path = self.workspace.goals / file if file else self.workspace.goal_file_of(self.facts.goal)
        return read_yaml(path).data

    def write(self, authored: Any) -> Path:
        """Keep another graph in `goals/`; it is not read yet."""
        content = yaml.safe_dump(authored, sort_keys=False, allow_unicode=True).encode()
        file = self.workspace.amended_file_of(self.facts.goal, content)
        replace_durably(file, content)
        return file

    def note(self, graph: GoalGraph, file: str, reason: str) -> Entry:
        """The record that takes a graph over."""
        nodes = self.facts.ledger.goals[self.facts.goal].nodes
        body = {"file": file, **compute_difference(graph, nodes), "reason": reason}
        return Entry(f"goal:{self.facts.goal}", GoalEvent.GOAL_AMENDED, body)
