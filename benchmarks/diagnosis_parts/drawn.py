"""Goals of one session in rooms drawn from seeds, each with one injected cause."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

from benchmarks.diagnosis_parts.cases import Case
from benchmarks.oracle.feasible import find_ambiguity, list_obstacles
from benchmarks.worlds.cases import Case as Drawn
from benchmarks.worlds.cases import Node
from benchmarks.worlds.files import render_goal, render_scene, write_project
from benchmarks.worlds.goals import draw_case

NODE = "move"
DISTURBANCE, VERIFIER = "external disturbance", "verifier"
FAULTS: dict[str, tuple[str, dict[str, object]]] = {  # name -> class of the cause, fault without its thing
    "slip": ("transport", {"kind": "slip", "when": {"lifted_m": 0.08}}),
    "nudge": (DISTURBANCE, {"kind": "nudge", "when": {"gripper_near_m": 0.05}}),
    "move": (DISTURBANCE, {"kind": "move", "when": {"gripper_near_m": 0.2}}),
    "remove": (DISTURBANCE, {"kind": "remove", "when": {"gripper_near_m": 0.2}}),
    "stall": ("machine", {"kind": "stall", "when": {"gripper_near_m": 0.2}}),
    "blackout": ("perception", {"kind": "blackout", "when": {"time_s": 1.0}}),
    "freeze": ("perception", {"kind": "freeze", "when": {"time_s": 1.0}}),
}
OTHERS = {"hurried": "timeout", "forbidden": "safety", "contradicted": VERIFIER, "impossible": "planning"}
CAUSES = (*FAULTS, *OTHERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnCase(Case):
    """One cause in one drawn room.

    Attributes:
        injected: Name of the cause.
        room: The drawn case, with one node.
    """

    injected: str
    room: Drawn

    @property
    def cause(self) -> str:
        """Its name; the tables count by it."""
        return self.injected

    def write_graph(self, folder: Path) -> Path:
        """A goal graph of one session, and its scene, in the folder of a project."""
        graph = render_goal(self.room)
        graph["defaults"] = {"timeout_s": 2.0 if self.injected == "hurried" else 60.0, "max_replans": 0}
        node = graph["sessions"][NODE]
        if self.injected == "forbidden":
            node["hold"] = [f"not moved({node['with']['object']})"]
        return write_project(folder, render_scene(self.room.room, self.room.name), graph)


def iter_drawn(first_seed: int, number: int) -> Iterator[DrawnCase]:
    """So many cases; causes take turns, each in the next room that has a fitting node."""
    seeds = count(first_seed)
    for index in range(number):
        cause = CAUSES[index % len(CAUSES)]
        yield next(case for seed in seeds if (case := _inject(cause, draw_case(seed))) is not None)


def _inject(cause: str, drawn: Drawn) -> DrawnCase | None:
    """The cause in this room; None where it has no node that fits."""
    wanted = cause == "impossible"
    fitting = (n for n in drawn.nodes if n.skill == "pick_and_place" and _fits(drawn, n, impossible=wanted))
    if bool(drawn.detail) != wanted or (node := next(fitting, None)) is None:
        return None
    accept = node.accept[:1]
    fault, kind = None, OTHERS.get(cause, "")
    if cause in FAULTS:
        kind, plain = FAULTS[cause]
        thing = {} if kind == "perception" else {"object": node.arguments["object"]}
        fault = {**plain, **thing}
    if cause == "contradicted":
        accept = (*accept, f"not {accept[0]}")
    one = replace(node, name=NODE, accept=accept, after=())
    room = replace(drawn, nodes=(one,), accept=(), constraints=(), faults=())
    return DrawnCase(name=f"{cause}_{drawn.seed}", kind=kind, injected=cause, room=room, fault=fault, skill="")


def _fits(drawn: Drawn, node: Node, *, impossible: bool) -> bool:
    if find_ambiguity(drawn, node):
        return False
    return bool(list_obstacles(drawn, node)) == impossible
