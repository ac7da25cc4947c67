"""A rehearsal: the session's own skill, carried out once in the imagined world, with its servo inputs recorded.

Planner, leaves, guard and conditions are those of a real session and draw the same seeds, so that the rehearsal does
what the session would do.
"""

import itertools
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.clock import Clock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.settings.safety import TargetLimits
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.drivers.mujoco.faults import FaultInjector
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver
from phyagentos.runtime.execution.context import open_context
from phyagentos.runtime.execution.holds import HoldMonitor
from phyagentos.runtime.execution.leaf import LeafError
from phyagentos.runtime.execution.leaf_registry import LeafRegistry
from phyagentos.runtime.execution.loop import Outcome, SessionLoop
from phyagentos.runtime.execution.tree_loader import build_tree
from phyagentos.runtime.execution.tree_runtime import TreeSkillRuntime
from phyagentos.runtime.motion.process import Planner
from phyagentos.runtime.perception.world_model import WORLD, GroundTruthWorldModel
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback
from phyagentos.runtime.targets.wire import RecordedFault
from rollout_forecaster.estimate import Array, BelievedWorld, believe_scene, settle_estimate

STATE_STEPS = 25  # between two recorded states
REST_S = 0.3  # of simulated time, within which released objects come to rest

_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


class ControlRecording(FaultInjector):
    """Records the servo inputs of every physics step, and now and then the state; injects no fault.

    Attributes:
        rows: (n_servos,) inputs of each step.
        states: mjSTATE_FULLPHYSICS before every `STATE_STEPS`-th step.
    """

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[Array] = []
        self.states: list[Array] = []

    @property
    def is_idle(self) -> bool:
        """It is not: it sees every step."""
        return False

    def act(self, physics: Physics) -> list[RecordedFault]:
        """Called before every physics step."""
        if len(self.rows) % STATE_STEPS == 0:
            state = np.zeros(mujoco.mj_stateSize(physics.model, _FULL))
            mujoco.mj_getState(physics.model, physics.data, state, _FULL)
            self.states.append(state)
        self.rows.append(physics.data.ctrl.copy())
        return []


@dataclass(frozen=True, slots=True, kw_only=True)
class Rehearsal:
    """Result of a rehearsal.

    Attributes:
        start: mjSTATE_INTEGRATION at its beginning.
        controls: (n, n_servos) servo inputs, one row per physics step, the last ones at rest.
        states: (m, n_state) mjSTATE_FULLPHYSICS before every `STATE_STEPS`-th of these steps.
    """

    session: Session
    outcome: Outcome
    trace: tuple[TraceEvent, ...]
    start: Array
    controls: Array
    states: Array
    stage: "Stage"


class Stage:
    """The imagined world of one estimate; its scene is loaded into the robot of a believed world."""

    def __init__(
        self,
        robot: MujocoDriver,
        recording: ControlRecording,
        environment: Environment,
        profile: TargetProfile,
        limits: TargetLimits,
    ) -> None:
        self._robot, self.recording = robot, recording
        self.epochs = itertools.count(1)  # fencing tokens: the same session is rehearsed several times
        self.scene = Scene(name=environment.scene, seed=0, episode="imagined")
        self._served = ServedTarget(robot, ReceiveLog(None))
        self.handle = TargetSessionHandle(Loopback(self._served), limits, sees_truth=True)
        self.handle.load(self.scene)
        self.start = settle_estimate(self.physics, environment, profile)
        self._snapshot = robot.snapshot().data
        self.world = GroundTruthWorldModel(profile.target, self.handle, profile=profile)

    @property
    def physics(self) -> Physics:
        """The present simulation."""
        return self._robot.physics

    def reset(self) -> None:
        """Back to the estimate."""
        self.handle.load(self.scene, self._snapshot)

    def observe(self) -> Environment:
        """The imagined world as it is now; its truth is a belief already."""
        self._served.forget_time()
        self.world.enter(self.scene)
        return self.world.observe(WORLD)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rehearser:
    """Rehearses sessions of one target; `folder` is that of the robot's model, the planner its own."""

    profile: TargetProfile
    folder: Path
    limits: TargetLimits
    library: Library
    registry: LeafRegistry
    planner: Planner
    clock: Clock

    def open_stage(self, environment: Environment) -> Stage:
        """The imagined world of an estimate; raises ExecutionError `SCENE_INVALID` and others of building a scene."""
        believed = believe_scene(read_placed(self.library, environment.scene), environment)
        recording = ControlRecording()
        world = BelievedWorld(self.library, believed, lambda _episode, _seed: recording)
        robot = MujocoDriver(world, self.profile, self.folder)
        return Stage(robot, recording, environment, self.profile, self.limits)

    def rehearse(self, stage: Stage, session: Session, tree: str) -> Rehearsal:
        """Carry out a session's tree on a stage, from the estimate on."""
        stage.reset()
        handle = stage.handle
        handle.begin(session.id, next(stage.epochs))
        initial = stage.observe()
        context = open_context(
            session,
            profile=self.profile,
            limits=self.limits,
            description=handle.describe(),
            planner=self.planner,
            initial=initial,
            world=stage.world,
            start_rad=handle.start_rad,
        )
        skill = TreeSkillRuntime(build_tree(tree, session.parameters, context, self.library, self.registry), context)
        stage.recording.rows.clear()
        stage.recording.states.clear()
        loop = SessionLoop(
            handle=handle,
            context=context,
            skill=skill,
            holds=HoldMonitor(session.hold, initial, session.target),
            cancel=lambda: None,
            clock=self.clock,
        )
        outcome = loop.run()
        try:
            skill.halt()
        except LeafError as error:
            context.note("leaf_error", "LEAF_ERROR", leaf=error.path, message=str(error))
        handle.halt()
        handle.settle(REST_S)
        handle.end()
        trace = skill.trace()
        skill.close()
        return Rehearsal(
            session=session,
            outcome=outcome,
            trace=trace,
            start=stage.start,
            controls=np.array(stage.recording.rows),
            states=np.array(stage.recording.states),
            stage=stage,
        )
