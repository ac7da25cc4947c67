"""A small library, synthetic worlds, and a runtime that plays its part in the journal without a robot."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import dedent
from typing import Any

import msgspec
import pytest

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.mission.mission import Mission
from phyagentos.agent.mission.report import MissionReport
from phyagentos.clock import SystemClock
from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.sessions.evidence import AFTER, BEFORE, HOLDS, TRACE, encode_lines, write_json
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Ended, Execution, Session
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Criterion
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import (
    Entity,
    Environment,
    Interior,
    Pose,
    Shape,
    ShapeKind,
    TargetState,
)
from phyagentos.store.admission import Entry
from phyagentos.store.journal import Journal
from phyagentos.store.ledger import Ledger
from tests.chat_server import ChatServer

SKILLS = {
    "pick_and_place": """
        description: Takes an object and puts it into a container.
        tree: pick_and_place
        parameters:
          object: {type: entity}
          destination: {type: place}
          near: {type: point, optional: true}
          speed: {type: number, default: 1.0, minimum: 0.1, maximum: 1.0}
        outputs:
          place_site: {type: point}
        requires: ["visible(${object})"]
        guarantees: ["inside(${object}, ${destination})"]
        needs: {observations: [entity_poses], actions: [joint_position], capabilities: [manipulation]}
        """,
    "pick": """
        description: Takes hold of an object.
        tree: pick
        parameters: {object: {type: entity}}
        requires: ["visible(${object})"]
        guarantees: ["holding(target, ${object})"]
        needs: {actions: [joint_position], capabilities: [manipulation]}
        """,
    "place": """
        description: Puts a held object into a container.
        tree: place
        parameters: {object: {type: entity}, destination: {type: place}}
        outputs: {place_site: {type: point}}
        requires: ["holding(target, ${object})"]
        guarantees: ["inside(${object}, ${destination})"]
        needs: {actions: [joint_position], capabilities: [manipulation]}
        """,
    "photograph": """
        description: Takes a picture from the air.
        tree: photograph
        parameters: {object: {type: entity}}
        guarantees: ["visible(${object})"]
        needs: {observations: [aerial_rgb], capabilities: [flight]}
        """,
}

TARGET = """
    target: panda
    description: An arm.
    model: panda.xml
    arm:
      joints: [j1]
      home_rad: [0.0]
      velocity_rad_s: [1.0]
      acceleration_rad_s2: [1.0]
      jerk_rad_s3: [1.0]
      torque_nm: [1.0]
      stiffness_nm_rad: [1.0]
      damping_nms_rad: [1.0]
    gripper: {joints: [f], pads: [p], max_width_m: 0.08, stiffness_n_m: 1.0, damping_ns_m: 1.0, force_n: 1.0}
    observations: [joint_state, entity_poses]
    actions: [joint_position]
    capabilities: [manipulation]
    """

INSPECT = """
    description: Looks at an object.
    tree: inspect
    parameters: {object: {type: entity}}
    guarantees: ["visible(${object})"]
    needs: {actions: [joint_position], capabilities: [manipulation]}
    """
TIDY = """
    goal: tidy
    objective: Red and green into their trays.
    scene: table
    targets: {arm: panda}
    constraints: ["upright(bottle)"]
    sessions:
      red:
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
      green:
        skill: pick_and_place
        target: arm
        with: {object: green_cube, destination: green_tray}
    accept: ["inside(red_cube, red_tray)", "inside(green_cube, green_tray)"]
    """
TWO = """
    goal: two
    objective: Green, then red.
    scene: table
    targets: {arm: panda}
    defaults: {max_replans: 2}
    BUDGET
    sessions:
      green:
        skill: pick_and_place
        target: arm
        with: {object: green_cube, destination: green_tray}
      red:
        after: [green]
        skill: pick_and_place
        target: arm
        with: {object: red_cube, destination: red_tray}
    accept: ["inside(red_cube, red_tray)", "inside(green_cube, green_tray)"]
    """
TRAYS = {"red_tray": 0.3, "green_tray": 0.0, "blue_tray": -0.3}
CUBES = {"red_cube": 0.3, "green_cube": 0.0, "blue_cube": -0.3, "yellow_cube": -0.1}


def add_skills(library: Library, skills: dict[str, str]) -> Library:
    for name, front in skills.items():
        folder = library.roots[0] / "skills" / name
        folder.mkdir(parents=True)
        (folder / "SKILL.md").write_text(f"---\nskill: {name}\n{dedent(front).strip()}\n---\n\n# {name}\n")
    return library


@pytest.fixture
def library(tmp_path: Path) -> Library:
    root = tmp_path / "library"
    (root / "robots" / "panda").mkdir(parents=True)
    (root / "robots" / "panda" / "target.yaml").write_text(dedent(TARGET))
    return add_skills(Library((root,)), SKILLS)


@pytest.fixture
def catalogue(library: Library) -> Catalogue:
    return Catalogue(
        skills=Catalogue.read(library).skills,
        targets=Catalogue.read(library).targets,
        scenes={"table": Path("table.yaml")},
    )


@pytest.fixture(autouse=True)
def known_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene `table` without a file: its names are those of the synthetic world."""
    kinds = {**dict.fromkeys(TRAYS, "tray"), **dict.fromkeys(CUBES, "cube"), "bottle": "bottle"}
    monkeypatch.setattr(Catalogue, "find_kinds", lambda self, scene: kinds if scene == "table" else None)
    monkeypatch.setattr("phyagentos.agent.goals.catalogue._find_scenes", lambda library: {"table": Path("table.yaml")})


@pytest.fixture
def write_graph(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str, name: str = "graph.yaml") -> Path:
        path = tmp_path / name
        path.write_text(dedent(text).lstrip("\n"))
        return path

    return write


@pytest.fixture
def tidy(write_graph: Callable[[str], Path]) -> Path:
    return write_graph(TIDY)


@pytest.fixture
def two(write_graph: Callable[[str], Path]) -> Path:
    return write_graph(TWO.replace("BUDGET", ""))


def cube(name: str, x: float, y: float, z: float = 0.02, **more: Any) -> Entity:
    shape = Shape(ShapeKind.BOX, (0.02, 0.02, 0.02))
    return Entity(name=name, kind="cube", pose=Pose((x, y, z)), shapes=(shape,), **more)


def tray(name: str, y: float) -> Entity:
    floor = Shape(ShapeKind.BOX, (0.1, 0.08, 0.005), Pose((0, 0, 0.005)))
    interior = Interior((0, 0, 0.035), (0.09, 0.07, 0.025))
    return Entity(name=name, kind="tray", pose=Pose((0.6, y, 0.0)), shapes=(floor,), interior=interior, movable=False)


def make_table() -> Entity:
    top = (Shape(kind=ShapeKind.BOX, size_m=(0.5, 0.6, 0.02)),)
    return Entity(name="table", kind="table", movable=False, pose=Pose(position_m=(0.4, 0.0, -0.02)), shapes=top)


def bottle() -> Entity:
    shape = Shape(ShapeKind.CYLINDER, (0.03, 0.1))
    return Entity(name="bottle", kind="bottle", pose=Pose((0.8, 0.0, 0.1)), shapes=(shape,))


def make_world(**more: Any) -> Environment:
    objects = [*(tray(n, y) for n, y in TRAYS.items()), *(cube(n, 0.4, y) for n, y in CUBES.items()), bottle()]
    arm = TargetState(q_rad=(0.0,), qd_rad_s=(0.0,), gripper_width_m=0.08, tcp=Pose())
    facts = {"time_s": 0.0, "scene": "table", "episode": "e", "revision": 1, "sensing": "truth"}
    return Environment(**(facts | {"entities": {e.name: e for e in objects}, "targets": {"panda": arm}} | more))


def change(world: Environment, name: str, **more: Any) -> Environment:
    """The world with other facts of one entity."""
    changed = msgspec.structs.replace(world.entities[name], **more)
    return msgspec.structs.replace(world, entities={**world.entities, name: changed})


def put(world: Environment, name: str, position: tuple[float, float, float]) -> Environment:
    return change(world, name, pose=Pose(position))


def hold(world: Environment, *names: str) -> Environment:
    arm = msgspec.structs.replace(world.targets["panda"], holding=names)
    return msgspec.structs.replace(world, targets={"panda": arm})


def remove(world: Environment, name: str) -> Environment:
    return msgspec.structs.replace(world, entities={n: e for n, e in world.entities.items() if n != name})


@dataclass(frozen=True, kw_only=True)
class Play:
    """What one session does to the world, and what is said of it."""

    world: Environment
    ended: Ended = Ended.COMPLETED
    code: str = ""
    leaf: str = ""
    trace: tuple[TraceEvent, ...] = ()
    ticks: int = 100
    outputs: dict[str, Any] = field(default_factory=dict)
    hold_truth: dict[str, Criterion] = field(default_factory=dict)


def succeed(world: Environment, session: Session) -> Play:
    """What a skill does when all goes well."""
    name = session.parameters["object"]
    if session.skill == "pick":
        return Play(world=hold(world, name))
    if "destination" not in session.parameters:
        return Play(world=world)
    x, y, z = world.entities[session.parameters["destination"]].pose.position_m
    taken = [e for e in world.entities.values() if e.kind == "cube" and abs(e.pose.position_m[1] - y) < 0.08]
    taken = [e for e in taken if e.name != name and e.pose.position_m[0] > 0.5]
    site = (x - 0.05 + 0.08 * len(taken), y, z + 0.03)
    return Play(world=hold(put(world, name, site)), outputs={"place_site": list(site)})


def slip(world: Environment, session: Session) -> Play:
    """The object is lost on the way."""
    lost = put(world, session.parameters["object"], (0.5, 0.1, 0.02))
    return Play(world=lost, ended=Ended.SKILL_FAILED, code="GRASP_LOST", leaf="pick_and_place/place/verify_grasp")


def make_unmet(text: str) -> Problem:
    return Problem(code="PRECONDITION_UNMET", address="requires", found=f"{text} is false", subject=text)


def make_rejection(session: Session, *problems: Problem) -> Entry:
    body = {"reason": "; ".join(map(str, problems)), "problems": msgspec.to_builtins(problems)}
    return Entry(session.id, "reject", body, 0)


Script = dict[str, Callable[[Environment, Session], Play]]


class ScriptedRuntime:
    """Claims, starts and finishes pending sessions, urgent ones first, in the thread that told it of a change.

    Args:
        workspace: Where the bundles go.
        world: As it stands at the beginning.
        script: Session id without its goal (`red.r1`) -> what happens; anything else succeeds.
        refuse: Node, or session id without its goal -> problem for which preflight rejects it.
    """

    def __init__(
        self,
        workspace: Workspace,
        world: Environment,
        script: Script | None = None,
        refuse: dict[str, Problem] | None = None,
    ) -> None:
        self.world = world
        self.script = script or {}
        self.refuse = refuse or {}
        self.ran: list[Session] = []
        self.paused = False
        self._workspace = workspace
        self._journal = Journal(workspace.root, side=Side.RUNTIME, by="scripted", clock=SystemClock(), durable=False)
        self._ledger = Ledger()

    def close(self) -> None:
        self._journal.close()

    def on_change(self, goal: Any, ledger: Ledger) -> None:
        for record in self._journal.read_new():
            self._ledger.apply(record)
        pending = [] if self.paused else [status.contract for status in self._ledger.iter_pending()]
        for session in sorted(pending, key=lambda session: -session.priority):
            self._run(session)

    def _run(self, session: Session) -> None:
        id = session.id
        unmet = [text for text in session.requires if not self._is_true(text, self.world)]
        problems = [make_unmet(text) for text in unmet]
        key = id.removeprefix(f"{session.goal}.")
        if problem := self.refuse.get(session.node) or self.refuse.get(key):
            problems.append(problem)
        if problems:
            self._journal.commit([make_rejection(session, *problems)])
            return
        before = self.world
        self.ran.append(session)
        play = self.script.get(key, succeed)(before, session)
        later = before.time_s + 10.0
        entities = {n: msgspec.structs.replace(e, observed_at_s=later) for n, e in play.world.entities.items()}
        self.world = msgspec.structs.replace(play.world, time_s=later, revision=before.revision + 1, entities=entities)
        self._leave_bundle(session, before, play)
        execution = Execution(
            ended=play.ended,
            evidence=f"evidence/{id}",
            outputs=play.outputs,
            leaf=play.leaf,
            code=play.code,
            ticks=play.ticks,
            sim_time_s=10.0,
        )
        self._journal.commit(
            [
                Entry(id, "claim", None, 0),
                Entry(id, "check"),
                Entry(id, "start", None, 1),
                Entry(id, "halt"),
                Entry(id, "finish", {"execution": msgspec.to_builtins(execution)}, 1),
            ]
        )

    def _leave_bundle(self, session: Session, before: Environment, play: Play) -> None:
        folder = self._workspace.evidence_of(session.id)
        folder.mkdir(parents=True)
        write_json(folder / BEFORE, before)
        write_json(folder / AFTER, self.world)
        (folder / TRACE).write_bytes(encode_lines(list(play.trace)))
        view = View(now=self.world, initial=before, target="panda")
        holds = []
        for text in session.hold:
            evaluation = parse_predicate(text).evaluate(view)
            sampled = Criterion(text=text, kind="hold", truth=evaluation.truth, because=evaluation.because, at_s=1.0)
            holds.append(play.hold_truth.get(text, sampled))
        write_json(folder / HOLDS, holds)

    def _is_true(self, text: str, now: Environment) -> bool:
        return parse_predicate(text).evaluate(View(now=now, initial=now, target="panda")).truth == "true"


@dataclass
class Stage:
    """A workspace with a scripted runtime; `pursue` runs one mission on it."""

    workspace: Workspace
    runtime: ScriptedRuntime
    journals: list[Journal] = field(default_factory=list)

    def close(self) -> None:
        for each in (self.runtime, *self.journals):
            each.close()

    def make_mission(self, **more: Any) -> Mission:
        journal = Journal(self.workspace.root, side=Side.AGENT, by="agent", clock=SystemClock(), durable=False)
        self.journals.append(journal)
        observers = more.pop("observers", [self.runtime])
        return Mission(self.workspace, journal, clock=SystemClock(), observers=observers, **more)

    def pursue(self, graph: Path, seed: int = 7) -> MissionReport:
        return self.make_mission().run(graph, seed=seed)


def get_order(stage: Stage) -> list[str]:
    """The sessions that ran, without their goal."""
    return [session.id.partition(".")[2] for session in stage.runtime.ran]


def check_report(report: MissionReport, reasons: dict[str, str] | None = None, **expected: Any) -> None:
    """Raise unless a mission ended as expected; ids of sessions are without their goal.

    Args:
        report: Of the mission.
        reasons: Id of a session, or "" for the goal itself -> what its reason holds.
        expected: What `found` has.
    """
    of_session = {each.id.partition(".")[2]: each for each in report.sessions}
    found = {
        "verdict": report.verdict,
        "exit_code": report.exit_code,
        "replans": report.replans,
        "nodes": {name: str(state) for name, state in report.nodes.items()},
        "sessions": [(id, str(each.state)) for id, each in of_session.items()],
        "causes": {id: each.cause for id, each in of_session.items() if each.cause},
        "ended": {id: each.ended for id, each in of_session.items()},
    }
    assert {key: found[key] for key in expected} == expected
    for id, text in (reasons or {}).items():
        assert text in (of_session[id].reason if id else report.reason)


@pytest.fixture
def make_stage(tmp_path: Path, library: Library) -> Iterator[Callable[..., Stage]]:
    stages: list[Stage] = []

    def make(
        script: Script | None = None, world: Environment | None = None, refuse: dict[str, Problem] | None = None
    ) -> Stage:
        workspace = Workspace.create(tmp_path / "workspace", library)
        stages.append(Stage(workspace, ScriptedRuntime(workspace, world or make_world(), script, refuse)))
        return stages[-1]

    yield make
    for stage in stages:
        stage.close()


@pytest.fixture
def serve() -> Iterator[Callable[..., ChatServer]]:
    """Starts servers of language models; they answer what is given, in turn."""
    with ExitStack() as stack:

        def open_one(*answers: object, **facts: Any) -> ChatServer:
            server = ChatServer(answers, **facts)
            stack.callback(server.close)
            return server

        yield open_one
