"""The graph of a goal as SVG: every attempt at a node; a large one collapsed by state, or what a search finds."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import networkx

from phyagentos.pictures.layers import draw_layers
from phyagentos.protocol.documents.flowchart import Arrow, Box
from phyagentos.protocol.sessions.tasks import GoalStatus, Relation, Step, iter_edges, iter_steps

MOST = 60  # boxes that are drawn one by one


@dataclass(frozen=True, slots=True)
class Drawn:
    """What is drawn of a step beside its name and state: where it leads, a picture's address, how long it took [s]."""

    link: str = ""
    picture: str = ""
    time_s: float | None = None


def draw_goal(goal: GoalStatus, *, find: str = "", show: Callable[[Step], Drawn] = lambda _: Drawn()) -> str:
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
    boxes = [_draw_step(goal, step, show(step), is_found=name in found) for name, step in steps.items()]
    return draw_layers(boxes, arrows, title)


def _draw_step(goal: GoalStatus, step: Step, drawn: Drawn, *, is_found: bool) -> Box:
    node, state = goal.nodes[step.node], step.state
    timed = state if drawn.time_s is None else f"{state}, {drawn.time_s:.1f} s"
    return Box(
        name=step.name,
        title=step.name,
        below=[node.skill, timed] if drawn.picture else [timed],
        kind=f"{state} found" if is_found else state,
        link=drawn.link,
        hint=node.objective,
        picture=drawn.picture,
    )


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
