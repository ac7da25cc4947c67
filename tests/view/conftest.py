"""A workspace with a goal of two nodes, one of them replanned, as its documents would stand after a run."""

import json

import msgspec
import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.evidence import SCENE_MODEL, encode_json
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Scene, Session, SessionId
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion, Verdict
from phyagentos.protocol.workspace.array_files import encode_arrays
from phyagentos.protocol.world.environment import Entity, Environment, Pose, Shape, ShapeKind
from phyagentos.protocol.world.truth import Truth
from phyagentos.view.documents import Documents
from tests.pens import Pens

GOAL = "goal:tidy-7"
HOSTILE = "<script>document.title='run'</script>"


class Desk(Pens):
    """Writes what both planes would record."""

    def __init__(self, root):
        super().__init__(root, SystemClock(), Library.open(find_shipped_root()))

    def record(self, about, event, /, **body):
        self.write(Side.AGENT, about, event, **body)

    def submit(self, node, attempt=0, parent=None, **changed):
        id = SessionId(f"tidy-7.{node}" + (f".r{attempt}" if attempt else ""))
        contract = Session(
            id=id, goal="tidy-7", node=node, objective=f"Put {node} away. {HOSTILE}", skill="pick_and_place",
            target="panda", parameters={"object": "red_cube"}, accept=("inside(red_cube, red_tray)",),
            scene=Scene(name="tabletop/cubes_and_trays", seed=7, episode="tidy-7"), seed=attempt, parent=parent,
            attempt=attempt, **changed,
        )  # fmt: skip
        self.record(id, "submit", **msgspec.to_builtins(contract))
        return id

    def execute(self, id, *, at_m=0.3, events=()):
        self.claim(id)
        self.leave_evidence(id, at_m, events)
        self.finish(id, ended=Ended.SKILL_FAILED, code="GRASP_LOST", sim_time_s=3.9)

    def leave_evidence(self, id, at_m, events):
        folder = self.workspace.evidence_of(id)
        folder.mkdir(parents=True)
        for name, x in (("environment_before.json", 0.1), ("environment_after.json", at_m)):
            cube = Entity(
                name="red_cube", kind="cube", pose=Pose((x, 0.0, 0.02)), shapes=(Shape(ShapeKind.BOX, (0.02,) * 3),),
                confidence=0.5, observed_at_s=1.0,
            )  # fmt: skip
            world = Environment(
                time_s=3.5, scene="table", episode="tidy-7", revision=1, sensing="perceived",
                entities={"red_cube": cube}, regions={}, targets={},
            )  # fmt: skip
            (folder / name).write_bytes(encode_json(world))
        (folder / SCENE_MODEL).touch()
        trace = [
            ("pick_and_place", "RUNNING", ""),
            ("pick_and_place/free_hand", "SUCCESS", ""),
            ("pick_and_place/pick", "RUNNING", ""),
            ("pick_and_place/pick/close_gripper", "SUCCESS", ""),
            ("pick_and_place/pick", "FAILURE", "GRASP_LOST"),
            ("pick_and_place/pick/close_gripper", "INVALID", ""),
        ]
        keys = ("path", "status", "code")
        lines = [{"tick": 1, "time_s": 1.0, "leaf": "x", **dict(zip(keys, each, strict=True))} for each in trace]
        (folder / "trace.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        (folder / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
        time = np.linspace(1.0, 4.5, 9)
        q = np.linspace(0.0, 1.0, 9)[:, None] * np.ones(7)
        course = {"time_s": time, "q_commanded": q, "q_measured": q, "qd_measured": q * 0, "gripper_measured_m": time}
        (folder / "trajectory.npz").write_bytes(encode_arrays(course))

    def judge(self, id, verdict, truth, **more):
        criterion = Criterion(
            text="inside(red_cube, red_tray)", kind="accept", truth=truth, because=f"measured {HOSTILE}"
        )
        self.decide(id, Attempt(verdict=verdict, criteria=(criterion,), reason="by the evidence", **more))


@pytest.fixture
def desk(tmp_path):
    made = Desk(tmp_path / "w")
    yield made
    made.close()


@pytest.fixture
def documents(desk):
    """Of a goal that was replanned once and met."""
    return tell(desk)


@pytest.fixture(scope="session")
def reported(tmp_path_factory):
    """The same, for tests that change nothing."""
    made = Desk(tmp_path_factory.mktemp("reported") / "w")
    yield tell(made)
    made.close()


def tell(desk):
    nodes = {
        name: {"objective": f"Put {name} away.", "skill": "pick_and_place", "target": "panda"} for name in ("a", "b")
    }
    nodes["b"]["after"] = ["a"]
    desk.record(GOAL, "goal_submitted", graph="tidy", seed=7, objective=f"Tidy. {HOSTILE}")
    desk.record(GOAL, "goal_compiled", nodes=nodes, accept=[], constraints=[])
    first = desk.submit("a")
    refused = {"time_s": 2.0, "kind": "intervention", "code": "JOINT_ACCELERATION", "details": {"message": "too fast"}}
    desk.execute(first, events=[refused])
    desk.judge(first, Verdict.REPLAN, Truth.FALSE, cause="GRASP_LOST")
    second = desk.submit("a", 1, parent=first)
    desk.execute(second, at_m=0.42)
    desk.judge(second, Verdict.SUCCESS, Truth.TRUE)
    found = Documents(desk.workspace.root)
    found.refresh()
    return found
