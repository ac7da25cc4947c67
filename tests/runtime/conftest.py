"""Doubles for the worker's side of a session: a scripted planner, a target in this process, a workspace."""

from collections import deque

import numpy as np
import pytest
from msgspec.structs import replace

from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.sessions.session import GoalId, Limits, Scene, Session, SessionId
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.protocol.workspace.array_files import encode_arrays
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind, TargetState
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.execution.leaf_registry import LeafRegistry, build_registry
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    Motion,
    NoPlan,
    PlanMove,
    TimeLine,
    Timing,
    Trajectory,
)
from phyagentos.runtime.perception.world_model import GroundTruthWorldModel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.recorder import Bundles
from phyagentos.runtime.worker.runner import SessionRunner
from tests.clocks import ManualClock

STEP_S = 0.002
N_STEPS = 10
TCP_M = (0.4, 0.0, 0.4)  # it stays there, whatever the joints do
ROOT = find_shipped_root()


class LocalConnection:
    """Both ends of the wire in one process: a request is carried out when it is sent, bytes and all."""

    def __init__(self, target):
        self._target = target
        self._replies = deque()

    def send_bytes(self, message):
        request = wire.REQUESTS.decode(message)
        self._replies.append(wire.REPLIES.encode(self._target.handle(request)))

    def recv_bytes(self):
        if not self._replies:
            raise EOFError
        return self._replies.popleft()

    def poll(self, timeout):
        return bool(self._replies)


class PerfectTarget:
    """A target that follows its set-points exactly and closes its fingers on whatever `graspable` names."""

    def __init__(self, profile, entities=(), graspable=None):
        self.profile = profile
        self.entities = {entity.name: entity for entity in entities}
        self.graspable = graspable
        self.time_s = 0.0
        self.q = np.array(profile.arm.home_rad)
        self.q_d = self.q.copy()
        self.qd = np.zeros_like(self.q)
        self.width_m = profile.gripper.max_width_m
        self.stuck_joint = None
        self.requests = []
        self.lost = False

    def close(self):
        pass

    def handle(self, request):
        self.requests.append(request)
        match request:
            case wire.Describe():
                return self._describe()
            case wire.LoadScene():
                return wire.Loaded(episode=request.episode, model_sha256="")
            case wire.Command():
                return self._carry_out(request)
            case wire.Halt():
                self.qd = np.zeros_like(self.q)
                return self._step()
            case wire.Settle():
                self.time_s += request.duration_s
                return self._step()
            case wire.Observe():
                return self._observe()
            case wire.End():
                return wire.Ended(time_s=self.time_s, faults=())
            case wire.InvokeTool(name=wire.RENDER):
                return wire.ToolResult({}, reason="no graphics")
            case wire.InvokeTool(name=wire.SCENE_MODEL):
                files = {"scene.mjb": b"model", "scene.xml": b"<mujoco/>"}
                return wire.ToolResult({name: wire.Artefact("text/plain", data) for name, data in files.items()})
        return wire.Ack()

    def commands(self):
        return [request for request in self.requests if isinstance(request, wire.Command)]

    def _describe(self):
        arm = self.profile.arm
        return wire.Description(
            target=self.profile.target,
            n_joints=len(arm.joints),
            steps_per_command=N_STEPS,
            physics_step_s=STEP_S,
            q_min_rad=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
            q_max_rad=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
            observations=self.profile.observations,
            actions=self.profile.actions,
            cameras=(),
            mode="lockstep",
            kinematics=wire.Kinematics(
                axes=((0.0, 0.0, 1.0),) * len(arm.joints), anchors_m=(TCP_M,) * len(arm.joints), tcp_m=TCP_M
            ),
            gripper_force_n=self.profile.gripper.force_n,
            joints=arm.joints,
            version=wire.WIRE_VERSION,
            driver="mujoco",
            tools=(wire.Tool(wire.RENDER), wire.Tool(wire.SCENE_MODEL)),
            ground_truth=True,
        )

    def _carry_out(self, command):
        self.time_s += STEP_S * N_STEPS
        self.q_d = command.q_rad[-1]
        q = self.q_d.copy()
        if self.stuck_joint is not None:
            q[self.stuck_joint] = self.q[self.stuck_joint]
        self.q, self.qd = q, command.qd_rad_s[-1]
        self.width_m = float(command.gripper_width_m[-1])
        return self._step()

    def snapshot(self):
        arrays = {"state": self.q, "time": np.array(self.time_s), "qpos": self.q, "qvel": self.qd, "act": np.empty(0)}
        return wire.Artefact(wire.NPZ, encode_arrays(arrays))

    def _state(self):
        held = (self.graspable,) if self.graspable and self.width_m < 0.04 else ()
        return TargetState(
            q_rad=tuple(self.q.tolist()),
            qd_rad_s=tuple(self.qd.tolist()),
            gripper_width_m=self.width_m,
            tcp=Pose(TCP_M),
            holding=held,
        )

    def _step(self):
        state = self._state()
        error = float(np.abs(self.q - self.q_d).max())
        return wire.Step(time_s=self.time_s, target=state, tracking_error_rad=error)

    def _observe(self):
        return wire.Observation(
            time_s=self.time_s,
            target=self._state(),
            entities=tuple(replace(entity, observed_at_s=self.time_s) for entity in self.entities.values()),
            snapshot=self.snapshot(),
        )


class ScriptedPlanner:
    """Answers each request by a function, after `polls` polls; straight lines in joint space by default."""

    def __init__(self, polls=0, answer=None):
        self.polls = polls
        self.requests = []
        self.cancelled = 0
        self.waits = 0
        self._answer = answer or compute_answer
        self._pending = None
        self._left = 0

    @property
    def is_free(self):
        return self._pending is None

    def submit(self, request):
        assert self._pending is None, "one request at a time"
        self.requests.append(request)
        self._pending, self._left = request, self.polls

    def poll(self):
        if self._pending is None or self._left > 0:
            return None
        request, self._pending = self._pending, None
        return self._answer(request)

    def wait(self, timeout_s):
        self.waits += timeout_s > 0.0
        self._left -= self._left > 0
        return self._left == 0

    def cancel(self):
        self.cancelled += 1
        self._pending = None

    def close(self):
        pass


def compute_answer(request):
    timing = Timing(ms={"total": 1.0})
    match request:
        case PlanMove():
            return Motion(trajectory=compute_line(request.q_rad, request.goals_rad[0]), goal=0, timing=timing)
        case TimeLine():
            line = request.waypoints_rad
            return Motion(trajectory=compute_line(line[0], line[-1]), goal=0, timing=timing)
    home = np.asarray(request.q_rad)
    line = np.linspace(home + 0.2, home + 0.3, 5)
    approach = Approach(label="yaw+000", tcp_end=Pose(), line_rad=line)
    return Approaches(approaches=(approach,), timing=timing)


def refuse(request):
    return NoPlan(code="NO_PATH_FOUND", message="the wall is in the way", timing=Timing(ms={}), rejected={"ik": 3})


def compute_line(start, end, speed_rad_s=0.5):
    """A straight motion with a quintic profile."""
    duration_s = max(0.1, 1.875 * float(np.abs(end - start).max()) / speed_rad_s)
    t = np.minimum(np.arange(1, int(np.ceil(duration_s / STEP_S)) + 1) * STEP_S / duration_s, 1.0)[:, None]
    s = 10 * t**3 - 15 * t**4 + 6 * t**5
    v = (30 * t**2 - 60 * t**3 + 30 * t**4) / duration_s
    return Trajectory(q_rad=start + s * (end - start), qd_rad_s=v * (end - start), step_s=STEP_S)


def build_cube(name="red_cube", position=(0.5, 0.0, 0.02), **changes):
    shape = Shape(kind=ShapeKind.BOX, size_m=(0.02, 0.02, 0.02))
    return Entity(name=name, kind="cube", pose=Pose(position), shapes=(shape,), **changes)


@pytest.fixture
def doubles():
    """The double classes and builders, for tests that vary them."""

    class Doubles:
        pass

    for name in ("LocalConnection", "PerfectTarget", "ScriptedPlanner"):
        setattr(Doubles, name, globals()[name])
    for name in ("compute_answer", "compute_line", "refuse", "build_cube"):
        setattr(Doubles, name, staticmethod(globals()[name]))
    return Doubles


@pytest.fixture(scope="session")
def profile():
    return validate(TargetProfile, read_yaml(ROOT / "robots" / "panda" / "target.yaml"))


@pytest.fixture(scope="session")
def limits():
    return read_safety(ROOT / "protocol" / "safety.yaml").targets["panda"]


@pytest.fixture(scope="session")
def library():
    return Library.open()


@pytest.fixture
def registry(library) -> LeafRegistry:
    return build_registry(library)


@pytest.fixture
def build_session():
    def build(**changes):
        values = {
            "id": SessionId("tidy-1.red"),
            "goal": GoalId("tidy-1"),
            "node": "red",
            "objective": "Put the red cube into the red tray.",
            "skill": "pick_and_place",
            "target": "panda",
            "parameters": {"object": "red_cube", "destination": "red_tray"},
            "accept": (),
            "scene": Scene(name="tabletop/cubes_and_trays", seed=1, episode="tidy-1"),
            "seed": 7,
            "limits": Limits(),
        }
        return Session(**{**values, **changes})

    return build


class Bench:
    """A runner on doubles."""

    def __init__(
        self, tmp_path, target, planner, library, registry, profile, limits, clock, policies=None, settings=()
    ):
        self.target, self.planner, self.clock, self.workspace = target, planner, clock, tmp_path
        self.handle = TargetSessionHandle(LocalConnection(target), limits, sees_truth=True)
        self.beats = []
        self.runner = SessionRunner(
            target=Embodiment(
                handle=self.handle,
                world=GroundTruthWorldModel("panda", self.handle, profile=profile),
                profile=profile,
                limits=limits,
            ),
            skills=SkillLoader(
                planner=planner,
                library=library,
                registry=registry,
                policies=policies(self.handle) if policies is not None else None,
            ),
            bundles=Bundles(tmp_path, settings=settings),
            clock=clock,
        )

    def run(self, session, tree=None, cancel=lambda: None, policy="", plan=()):
        self.handle.load(session.scene)
        return self.runner.run(
            session,
            1,
            {"tree": tree or session.skill} | ({"policy_adapter": policy} if policy else {}) | dict(plan),
            evidence=f"evidence/{session.id}",
            cancel=cancel,
            beat=lambda **beat: self.beats.append(beat),
        )


@pytest.fixture
def build_bench(tmp_path, library, registry, profile, limits):
    def build(
        target=None,
        planner=None,
        library=library,
        registry=registry,
        workspace=tmp_path,
        clock=None,
        policies=None,
        settings=(),
    ):
        target = target or PerfectTarget(
            profile, [build_cube(), build_cube("red_tray", (0.5, 0.3, 0.0))], graspable=None
        )
        planner, clock = planner or ScriptedPlanner(), clock or ManualClock()
        return Bench(workspace, target, planner, library, registry, profile, limits, clock, policies, settings)

    return build


@pytest.fixture
def plant(tmp_path):
    """A library with one more tree."""

    def plant(children, header=""):
        (tmp_path / "trees").mkdir(exist_ok=True)
        listed = "".join(f"      - {child}\n" for child in children)
        text = f"tree: planted\ndescription: A tree.\n{header}root:\n  sequence:\n    children:\n{listed}"
        (tmp_path / "trees" / "planted.yaml").write_text(text)
        return Library((tmp_path, find_shipped_root()))

    return plant


@pytest.fixture
def session(build_session):
    return build_session(skill="planted", parameters={})
