"""The graph of a goal as SVG: every attempt at a node; a large one collapsed by state, or what a search finds."""

from collections import Counter
from collections.abc import Callable

import networkx

from phyagentos.pictures.layers import draw_layers
from phyagentos.protocol.documents.flowchart import Arrow, Box
from phyagentos.protocol.sessions.tasks import GoalStatus, Relation, Step, iter_edges, iter_steps

MOST = 60  # boxes that are drawn one by one


def draw_goal(goal: GoalStatus, *, find: str = "", link: Callable[[Step], str] = lambda _: "") -> str:
    """SVG of a goal's graph; with `find` the steps whose name, skill or state holds that text, and their neighbours."""
    steps = {step.name: step for step in iter_steps(goal)}
    arrows = [
        Arrow(edge.before, edge.step, "" if edge.relation is Relation.AFTER else edge.relation)
        for edge in iter_edges(goal)
    ]
    found = _find(goal, steps, find) if find else []
    if found:
        near = {
            name for arrow in arrows for name in (arrow.before, arrow.after) if {arrow.before, arrow.after} & {*found}
        }
        steps = {name: step for name, step in steps.items() if name in {*found[:MOST]} | {*sorted(near)[:MOST]}}
    title = f"Graph of the goal {goal.id}"
    if len(steps) > MOST and not found:
        return _draw_collapsed(steps, arrows, title)
    boxes = [
        Box(
            name=name,
            title=name,
            below=[step.state],
            kind=f"{step.state} found" if name in found else step.state,
            link=link(step),
            hint=goal.nodes[step.node].objective,
        )
        for name, step in steps.items()
    ]
    return draw_layers(boxes, arrows, title)


def _find(goal: GoalStatus, steps: dict[str, Step], text: str) -> list[str]:
    wanted = text.casefold()
    words = {name: f"{name} {step.state} {goal.nodes[step.node].skill}".casefold() for name, step in steps.items()}
    return [name for name in steps if wanted in words[name]]


def _draw_collapsed(steps: dict[str, Step], arrows: list[Arrow], title: str) -> str:
    """One box for all steps of one state that are equally far from the start, in at most a dozen layers."""
    graph = networkx.DiGraph((arrow.before, arrow.after) for arrow in arrows)
    graph.add_nodes_from(steps)
    depth = {name: level for level, names in enumerate(networkx.topological_generations(graph)) for name in names}
    share = 1 + max(depth.values()) // 12
    group = {name: f"{depth[name] // share} {step.state}" for name, step in steps.items()}
    counts = Counter(group[name] for name in steps)
    boxes = [
        Box(name=name, title=f"{counts[name]} {name.partition(' ')[2]}", kind=name.partition(" ")[2])
        for name in sorted(counts, key=lambda name: int(name.partition(" ")[0]))
    ]
    between = dict.fromkeys(Arrow(group[each.before], group[each.after]) for each in arrows)
    return draw_layers(boxes, [each for each in between if each.before != each.after], f"{title}, collapsed by state")
