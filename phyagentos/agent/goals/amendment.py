"""Amendments: another graph for a goal that is pursued already, as a difference to the one that it has.

Upstream: a person (`paos amend`), a node that fans out over what is seen, or a plan made anew. What has begun stays as
it is; everything else may become other nodes.
"""

import copy
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from phyagentos.agent.goals.expansion import Node
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.goals.selector import Choice
from phyagentos.errors import Problem
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.predicate import View, iter_entities, parse_predicate, substitute
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, NodeStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import UNNAMED
from phyagentos.protocol.world.truth import Truth

_NEW = NodeStatus()
_TAKEN_OUT = frozenset({NodeState.BLOCKED, NodeState.SKIPPED})  # begun, and yet nothing that was done


def describe_node(graph: GoalGraph, name: str) -> Fields:
    """A node as the journal holds it."""
    node, choice = graph.nodes[name], graph.choices[name]
    return _describe(node.spec.objective, choice, node)


def _describe(objective: str, carried: NodeStatus | Choice, ordered: NodeStatus | Node) -> Fields:
    failing = {"on_failure": [list(edge) for edge in ordered.on_failure]} if ordered.on_failure else {}
    named = {"objective": objective, "skill": carried.skill, "target": carried.target, "after": list(ordered.after)}
    return {**named, **failing, "reasons": list(carried.reasons)}


def find_contradictions(old: GoalGraph, new: GoalGraph, status: GoalStatus) -> Iterator[Problem]:
    """Why a goal cannot go on with another graph: it is another goal, or what has begun is not in it as it was."""
    for key in ("goal", "scene", "targets", "worlds"):
        before, after = getattr(old.spec, key), getattr(new.spec, key)
        if before != after:
            yield Problem("CHANGED", f"{new.source}: {key}", repr(after), repr(before))
    for name, node in status.nodes.items():
        if not node.sessions or name not in old.nodes:
            continue
        where, found = f"{new.source}: node {name!r}", f"it is {node.state}, by {node.sessions[-1]}"
        if name not in new.nodes:
            if node.state not in _TAKEN_OUT:
                hint = "Undo it by a node that comes after it."
                yield Problem("CHANGED", where, f"{found}, and was taken out", f"node {name!r}", hint)
        elif changed := [*_iter_changed(old, new, name)]:
            hint = "Leave it as it is, and add another node."
            yield Problem("CHANGED", where, f"{found}; changed: {', '.join(changed)}", "as it was", hint)


def _iter_changed(old: GoalGraph, new: GoalGraph, name: str) -> Iterator[str]:
    before, after = old.nodes[name].spec, new.nodes[name].spec
    yield from (
        key for key in type(before).model_fields if key != "after" and getattr(before, key) != getattr(after, key)
    )
    if (old.choices[name].skill, old.choices[name].target) != (new.choices[name].skill, new.choices[name].target):
        yield "what it is carried out with"
    if not set(new.nodes[name].predecessors) <= set(old.nodes[name].predecessors):
        yield "what it comes after"


def compute_difference(new: GoalGraph, nodes: Mapping[str, NodeStatus]) -> Fields:
    """Body of the record that amends a goal: nodes that are new or changed, names that are gone, acceptance."""
    changed = {}
    for name in new.nodes:
        described = describe_node(new, name)
        known = nodes.get(name, _NEW)
        if known.sessions:  # its objective is that of its sessions
            described["objective"] = known.objective
        if described != _describe(known.objective, known, known) or known is _NEW:
            changed[name] = described
    removed = [name for name in nodes if name not in new.nodes]
    judged = {"accept": list(new.spec.accept), "constraints": list(new.spec.constraints)}
    return {"nodes": changed, "removed": removed, **judged}


def find_fitting(node: Node, roles: Mapping[str, str], view: View) -> dict[str, list[str]]:
    """For each variable of a fan-out over what is seen the objects of the inventory that fit, sorted by name."""
    seen = sorted(name for name, each in view.now.entities.items() if each.visible and each.kind != UNNAMED)
    found: dict[str, list[str]] = {}
    for key, text in ((key, text) for key, text in node.spec.foreach.items() if isinstance(text, str)):
        named = {*iter_entities(parse_predicate(text, template=True))}  # a tray is not among the objects in it
        filled = {name: parse_predicate(substitute(text, {key: name})) for name in seen if name not in named}
        renamed = {name: each.rename_targets(roles) for name, each in filled.items()}
        found[key] = [name for name, each in renamed.items() if each.evaluate(view).truth is Truth.TRUE]
    return found


def set_values(authored: Any, node: Node, values: Mapping[str, list[str]]) -> Any:
    """The authored graph with values for a fan-out; the node may stand in an included graph, or be an alternative."""
    changed = copy.deepcopy(authored)
    first, *names = node.authored.split("-")
    place = changed["sessions"][first]
    for name in names:
        place = place["include"]["sessions"][name] if "include" in place else place["any_of"][int(name) - 1]
    place["foreach"].update(values)
    return changed


def find_graph(workspace: Workspace, goal: GoalStatus) -> Path:
    """The file with the graph that a goal has now."""
    return workspace.goals / goal.file if goal.file else workspace.goal_file_of(goal.id)


def keep_graph(workspace: Workspace, goal: GoalId, authored: object) -> Path:
    """Keep another graph in `goals/`, as data or as a whole file; the record that takes it over comes later."""
    content = authored if isinstance(authored, bytes) else encode_graph(authored)
    file = workspace.amended_file_of(goal, content)
    replace_durably(file, content)
    return file


def encode_graph(authored: object) -> bytes:
    """A graph as a file."""
    return yaml.safe_dump(authored, sort_keys=False, allow_unicode=True).encode()
