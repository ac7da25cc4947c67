"""Servers that turn hostile in the midst of a session: it ends in time with a code, and the next one is sound."""

import base64
import contextlib
import json

import cv2
import numpy as np
import pytest

from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.segmentation import Palette
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.policy_server import answer
from tests.hostile_server import WAYS, HostileServer

pytestmark = pytest.mark.journey

POLICY = find_shipped_root() / "examples" / "projects" / "03_policy_server"
SCENE = "tabletop/cubes_and_trays"
WAITS_S = 2.0  # for a server, by the settings of this workspace
LIMIT_S = 40.0  # of a whole goal on a busy machine
DRIP, BOMB, SILENCE = "a drip of a body", "a gzip bomb", "silence"
JUDGED = {"role": "assistant", "content": '{"truth": "true", "because": "it is there"}'}
GRAPH = f"""
goal: hostile
objective: Put the red cube into the red tray.
scene: {SCENE}
targets: {{arm: panda}}
defaults: {{max_replans: 0, policy_s: {WAITS_S}}}
budget: {{sessions: 1}}
sessions:
  red:
    skill: pick_and_place
    target: arm
    with: {{object: red_cube, destination: red_tray}}
    accept: ["inside(red_cube, red_tray)", "not moved(green_cube)"]
"""


class Turncoat(HostileServer):
    """Answers every request by `reply`; once it is told to, only so many more of them."""

    def __init__(self, reply) -> None:
        super().__init__(SILENCE, polite=self._reply_or_turn)
        self._reply, self._turns_at = reply, float("inf")

    def turn(self, way: str, after: int) -> None:
        self.way, self.parts, self._turns_at = way, WAYS[way](), self.requests + after

    def turn_back(self) -> None:
        self._turns_at = float("inf")

    def _reply_or_turn(self, request: bytes) -> bytes | None:
        if self.requests <= self._turns_at:
            return self._reply(request)
        self.parts = WAYS[self.way]()
        return None


class Stand:
    """A workspace whose planes run, and the servers that it asks; each goal is of one session in a world of its own."""

    def __init__(self, root, stack) -> None:
        skill, _ = read_skill(POLICY / "skills" / "imitate" / "SKILL.md")
        replies = {
            "policy": lambda data: wire.encode(answer(wire.decode_request(data), Rest(), skill.policy)),
            "detector": detect_by_colour(),
            "judge": lambda _: json.dumps({"choices": [{"message": JUDGED}]}).encode(),
        }
        self.servers = {name: Turncoat(reply) for name, reply in replies.items()}
        self.workspace = workspace = Workspace.create(root / "w", Library.open(POLICY))
        registry, contract = workspace.skill_registry, workspace.runtime_contract
        registry.write_text(registry.read_text().replace(skill.policy.endpoint, self.servers["policy"].url))
        with workspace.perception.open("a") as file:
            settings = f"{{url: '{self.servers['detector'].url}', timeout_s: {WAITS_S}}}"
            file.write(f"detector: {{name: http, settings: {settings}}}\n")
        model = f"{{url: '{self.servers['judge'].url}', model: looker, timeout_s: {WAITS_S}}}"
        rest = contract.read_text().split("verification:")[0]
        contract.write_text(f"{rest}verification: {{judges: [predicates, vision], vision: {model}}}\n")
        self._mission = stack.enter_context(open_bench(workspace, SystemClock())).mission
        self._graph, self._count = root / "goal.yaml", 0

    def run(self, skill):
        self._graph.write_text(GRAPH.replace("pick_and_place", skill))
        self._count += 1
        report = self._mission.run(self._graph, seed=1, goal=f"goal-{self._count}")
        assert report.wall_s < LIMIT_S
        (session,) = report.sessions
        return report, session

    def run_against(self, name, way, after, skill="pick_and_place"):
        """With a server that turns hostile after so many requests and is polite again once the session has ended."""
        server = self.servers[name]
        before = server.requests
        server.turn(way, after)
        report, session = self.run(skill)
        assert server.requests > before + after
        assert report.exit_code == 1
        server.turn_back()
        return session

    def run_on(self, skill="pick_and_place"):
        """With polite servers; the report."""
        report, session = self.run(skill)
        assert session.ended == "completed"
        logs = self.workspace.logs.glob("*.log")
        assert [log.name for log in logs if "Traceback" in log.read_text()] == []
        return report


@pytest.fixture(scope="module")
def stand(tmp_path_factory):
    with contextlib.ExitStack() as stack:
        yield (stand := Stand(tmp_path_factory.mktemp("hostile"), stack))
    for server in stand.servers.values():
        server.close()


class Rest:
    """A policy that stays where it is, for three chunks."""

    def start(self, request):
        pass

    def infer(self, request):
        return np.tile(np.append(request.observations["joint_state"], 0.08), (25, 1)), request.sequence == 2


def test_a_policy_server(stand):
    session = stand.run_against("policy", SILENCE, after=3, skill="imitate")  # what it is, a start, one chunk

    assert (session.ended, session.code, session.cause) == ("skill_failed", "POLICY_LOST", "POLICY_FAILED")
    assert session.ticks > 10, "it was in motion"
    stand.run_on(skill="imitate")


def detect_by_colour():
    """The replies of a detector that knows the colours of the scene."""
    inventory = build_inventory(read_scene(Library.open().get_scene(SCENE)))
    palette, objects = Palette(inventory.palette), [item for item in inventory.objects.values() if item.colors]
    colors = {f"{item.template.color} {item.template.kind}".strip(): item.colors[0] for item in objects}

    def encode(mask):
        png = cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes()
        return {"box": [0, 0, *mask.shape[::-1]], "mask_png": base64.b64encode(png).decode()}

    def reply(data):
        asked = json.loads(data)
        png = np.frombuffer(base64.b64decode(asked["image_png"]), np.uint8)
        labels = palette.label(cv2.imdecode(png, cv2.IMREAD_COLOR)[..., ::-1])
        found = [{"label": word, "score": 0.9} | encode(labels == colors[word]) for word in asked["labels"]]
        return json.dumps({"version": 1, "detections": found}).encode()

    return reply


def test_a_detector_and_a_judge_that_looks_at_pictures(stand):
    session = stand.run_against("detector", DRIP, after=5)  # a camera after the other: in the last look

    assert (session.ended, session.verdict, session.cause) == ("completed", "failure", "EVIDENCE_MISSING"), session
    after = json.loads((stand.workspace.evidence_of(session.id) / evidence.AFTER).read_bytes())
    found = {(each["status"], each["detail"].split(":")[0]) for each in after["sensors"].values()}
    assert found == {("unread", "MODEL_FAILED")}

    session = stand.run_against("judge", BOMB, after=1)  # there are two criteria, seen by the detector

    assert (session.ended, session.verdict, session.cause) == ("completed", "failure", "JUDGE_FAILED"), session
    answers = [(str(each.truth), each.because.split(":")[0]) for each in session.criteria if each.kind == "vision"]
    assert answers == [("true", "it is there"), ("unknown", "MODEL_FAILED")]
    assert stand.run_on().verdict == "success"
