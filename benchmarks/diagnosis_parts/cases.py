"""The cases of benchmarks/diagnosis.py: one goal of one session each, and what is injected into it."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from benchmarks.diagnosis_parts.model import ANSWERS
from benchmarks.diagnosis_parts.policies import MANNERS

POLICY_S = 1.0  # a session waits so long for its policy [s]


@dataclass(frozen=True, slots=True)
class Case:
    """One cause, and how it is injected.

    Attributes:
        name: Of the goals it makes.
        kind: The class of the cause, as it was injected.
        scene: Where.
        object: The thing to move.
        destination: Where to.
        fault: For the fault file, without its condition on the session; None when something else injects it.
        node: More keys of the node.
        skill: Who is to move it; a manner of `policies` has a policy server of its own.
        accept: Asked beside that it is there.
        judge: Manner of `model`; such a case is judged on pictures too. `judge_down`: nobody listens.
        kills: Whether the worker is killed meanwhile.
        settings: runtime_contract.yaml of the workspace: key -> value. Such a case has a runtime plane of its own.
        sense: The only sensing for which the case makes sense; empty for both.
    """

    name: str
    kind: str
    scene: str = "tabletop/cubes_and_trays"
    object: str = "red_cube"
    destination: str = "red_tray"
    fault: dict[str, object] | None = None
    node: tuple[tuple[str, object], ...] = ()
    skill: str = "pick_and_place"
    accept: tuple[str, ...] = ()
    judge: str = ""
    kills: bool = False
    settings: tuple[tuple[str, object], ...] = ()
    sense: str = ""

    @property
    def cause(self) -> str:
        """Its name; the tables count by it."""
        return self.name

    def write_graph(self, folder: Path) -> Path:
        """A goal graph of one session."""
        node = {
            "skill": self.skill,
            "target": "arm",
            "with": {"object": self.object, "destination": self.destination},
            **dict(self.node),
        }
        graph = {
            "goal": self.name,
            "objective": f"{self.object} into {self.destination}, while something goes wrong.",
            "scene": self.scene,
            "targets": {"arm": "panda"},
            "defaults": {"max_replans": 0, "policy_s": POLICY_S},  # it may look again, and does nothing else
            "sessions": {"move": node},
            "accept": [f"inside({self.object}, {self.destination})"],
        }
        node["accept"] = [*graph["accept"], *self.accept]
        path = folder / f"{self.name}.yaml"
        path.write_text(yaml.safe_dump(graph, sort_keys=False))
        return path


WORKSHOP = "recovery/workshop"
CASES = (
    Case("slippery", "grasp", scene=WORKSHOP, object="soap"),
    Case("dropped", "transport", fault={"kind": "slip", "object": "red_cube", "when": {"lifted_m": 0.12}}),
    Case(
        "nudged",
        "external disturbance",
        fault={"kind": "nudge", "object": "red_cube", "when": {"gripper_near_m": 0.04}},
    ),
    Case(
        "moved", "external disturbance", fault={"kind": "move", "object": "red_cube", "when": {"gripper_near_m": 0.25}}
    ),
    Case("removed", "external disturbance", fault={"kind": "remove", "object": "red_cube", "when": {}}),
    Case("stalled", "machine", fault={"kind": "stall", "object": "red_cube", "when": {"gripper_near_m": 0.3}}),
    Case("killed", "machine", kills=True),
    Case("hemmed", "planning", scene=WORKSHOP),
    Case("wide", "planning", scene=WORKSHOP, object="carton", destination="zone"),
    Case("chute", "placement", scene="tabletop/workbench", object="tin", destination="rack"),
    Case("hurried", "timeout", node=(("timeout_s", 2.0),)),
    Case("forbidden", "safety", node=(("hold", ["not moved(red_cube)"]),)),
    Case("misfit", "adapter", settings=(("control_period_s", 0.01),)),
    *(Case(manner, "policy", skill=manner) for manner in MANNERS),
    Case("contradicted", "verifier", accept=("not inside(red_cube, red_tray)",)),
    Case("unmeasured", "verifier", accept=("metric(spilled_ml) <= 5",)),
    *(Case(manner, "verifier", judge=manner) for manner in ("judge_down", *ANSWERS)),
    Case("blind", "perception", fault={"kind": "blackout", "when": {"time_s": 1.0}}, sense="perceived"),
    Case("frozen", "perception", fault={"kind": "freeze", "when": {"time_s": 1.0}}, sense="perceived"),
)
