"""Cases of verdicts: sessions that only look at a moment of a LIBERO task, judged as at the end of any session.

The runner observes, halts, observes again and leaves a bundle; the verifier of the shipped settings reads that bundle.
Nothing is commanded: preflight grants the session no more than the look. The acceptance is that of the task's goal
graph, generated from its BDDL. What the benchmark's predicate says of the same moment is appended by its process to a
file at the end of the session, and read here afterwards.
"""

import argparse
import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import yaml

from benchmarks.libero_parts.served import Server, serve
from benchmarks.libero_parts.tasks import LIBRARY, ROBOT, read_profile, write_project
from phyagentos.agent.judging.verifier import History, SessionVerifier
from phyagentos.assembly.verification import build_verifier
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.sessions.evidence import CONTRACT, EXECUTION, read_bundle
from phyagentos.protocol.sessions.session import Execution, GoalId, Scene, Session, SessionId
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.perception.world_model import GroundTruthWorldModel
from phyagentos.runtime.targets.handshake import greet, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.recorder import Bundles
from phyagentos.runtime.worker.runner import SessionRunner

MODULE = "benchmarks.libero_parts.moments"
MOMENTS = {
    "start": 1,
    "met": 4,
    "dropped": 1,
    "near miss": 2,
    "wrong object": 1,
    "elsewhere": 1,
    "half of it": 1,
    "joint short of its end": 2,
    "covered": 1,
    "occluded": 1,
}
"""How many of each kind an episode has, where its goal can have them."""
SKILL = "home"  # of a session that commands nothing, any
LOOK_ONLY = {"tree": SKILL, "refused": [{"code": "LOOK_ONLY", "found": "the session looks, and commands nothing"}]}

Record = dict[str, Any]


class Observer:
    """Looks at moments of one task, over the wire that any target behind `driver: remote` is commanded by."""

    def __init__(
        self, folder: Path, scene: str, accept: Sequence[str], server: Server, verifier: SessionVerifier
    ) -> None:
        self._folder, self._scene, self._accept, self._server = folder, scene, tuple(accept), server
        self._verifier = verifier
        profile, project = read_profile(), folder / "project"
        channel = connect_websocket(server.endpoint)
        greet(channel, mint(server.key))
        self._driver = RemoteDriver(profile, channel, server.key)
        self._target = ServedTarget(self._driver, ReceiveLog(None))
        limits = read_safety(LIBRARY / "protocol" / "safety.yaml").targets[ROBOT]
        self._handle = TargetSessionHandle(Loopback(self._target), limits, sees_truth=True)
        library = Library.open(project)
        planner = LocalPlanner(MotionPlanner(profile, project / "robots" / ROBOT))
        self._runner = SessionRunner(
            target=Embodiment(
                handle=self._handle, world=GroundTruthWorldModel(ROBOT, self._handle), profile=profile, limits=limits
            ),
            skills=SkillLoader(planner=planner, library=library, registry=build_registry(library)),
            bundles=Bundles(folder),
            clock=SystemClock(),
        )

    def close(self) -> None:
        """Disconnect."""
        self._target.close()

    def look(self, state: int, kind: str, number: int, seed: int) -> tuple[Attempt, Record] | None:
        """The verdict on one moment, and the benchmark's line; None where the task has none of this kind."""
        id = _name_session(self._scene, state, kind, number)
        episode = id.partition(".")[0]
        scene = Scene(name=self._scene, seed=state, episode=episode)
        self._handle.load(scene)
        made = self._driver.invoke_tool("make_moment", {"kind": kind, "seed": seed})
        if not json.loads(made.artefacts["moment.json"].data)["made"]:
            return None
        session = Session(
            id=SessionId(id),
            goal=GoalId(episode),
            node=kind,
            objective="Look whether the goal is met.",
            skill=SKILL,
            target=ROBOT,
            parameters={},
            accept=self._accept,
            scene=scene,
            seed=seed,
            unless_met=True,
        )
        execution = self._runner.run(
            session,
            1,
            LOOK_ONLY,
            evidence=f"evidence/{session.id}",
            cancel=lambda: None,
            beat=lambda **_beat: None,
        )
        attempt = judge_bundle(self._folder / execution.evidence, session, execution, self._verifier)
        return attempt, self._server.read_outcomes()[session.id]


def open_verifier() -> SessionVerifier:
    """As an agent has it in a workspace of these tasks."""
    return build_verifier(Workspace(LIBRARY / "protocol"), SystemClock())


def judge_bundle(folder: Path, session: Session, execution: Execution, verifier: SessionVerifier) -> Attempt:
    """The verdict on a bundle, as at the end of a node's only session."""
    return verifier.judge(read_bundle(folder, session, execution), History())


def judge_again(given: argparse.Namespace, record: Record, verifier: SessionVerifier) -> Record:
    """A case whose evidence was kept, by the verifier of today; its label stays."""
    suite, task, state, kind = (record[name] for name in ("suite", "task", "state", "kind"))
    folder = (
        given.keep
        / suite
        / f"task-{task}"
        / "evidence"
        / _name_session(f"{suite}/{task}", state, kind, record["number"])
    )
    session = msgspec.convert(read_yaml(folder / CONTRACT).data["session"], Session)
    execution = msgspec.json.decode((folder / EXECUTION).read_bytes(), type=Execution)
    return record | describe(judge_bundle(folder, session, execution, verifier))


def judge_suite(given: argparse.Namespace, suite: str, states: Mapping[int, Sequence[int]]) -> Iterator[list[Record]]:
    """The cases of some states of each of some tasks, an episode at a time; one process serves them all."""
    folder = (given.keep or given.results.with_suffix(".work")) / suite
    folder.mkdir(parents=True, exist_ok=True)
    profile, verifier = read_profile(), open_verifier()
    first = f"{suite}/{next(iter(states))}"
    try:
        with serve(given.python.absolute(), profile, first, folder / "outcomes.jsonl", MODULE) as server:
            for task, of_task in states.items():
                own, scene = folder / f"task-{task}", f"{suite}/{task}"
                graph = write_project(own / "project", scene, server.describe(profile, scene), server)
                accept = yaml.safe_load(graph.read_text())["accept"]
                with closing(Observer(own, scene, accept, server, verifier)) as observer:
                    for state in of_task:
                        yield list(_judge_episode(observer, suite, task, state, given.seed))
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)


def _judge_episode(observer: Observer, suite: str, task: int, state: int, seed: int) -> Iterator[Record]:
    for kind, count in MOMENTS.items():
        for number in range(count):
            began_s = time.perf_counter()
            drawn = compute_seed(seed, suite, task, state, kind, number)
            found = observer.look(state, kind, number, drawn)
            if found is None:
                break
            attempt, outcome = found
            yield {
                "suite": suite,
                "task": task,
                "state": state,
                "kind": kind,
                "number": number,
                "success": outcome["success"] or outcome["reached"],
                "at_end": outcome["success"],
                **describe(attempt),
                "wall_s": round(time.perf_counter() - began_s, 2),
            }


def describe(attempt: Attempt) -> Record:
    """What a verdict says: `success`, `failure`, or `unknown` where nothing is false and something cannot be told."""
    is_false = any(each.truth is Truth.FALSE for each in attempt.criteria)
    said = "success" if attempt.verdict is Verdict.SUCCESS else "failure" if is_false else "unknown"
    return {"said": said, "why": [f"{each.text} {each.truth}: {each.because}" for each in attempt.criteria]}


def _name_session(scene: str, state: int, kind: str, number: int) -> str:
    return f"{scene.replace('/', '-')}-{state}.{kind.replace(' ', '_')}-{number}"
