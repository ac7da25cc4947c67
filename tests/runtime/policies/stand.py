"""A policy runtime on a perfect arm and a clock of its own: in real time, or in lockstep."""

from types import SimpleNamespace

import numpy as np

from phyagentos.protocol.capabilities.action_spaces import ActionSpace, GripperRange, describe_target_space
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.world.environment import Pose, TargetState
from phyagentos.runtime.actions.bridges.chain import compile_chain
from phyagentos.runtime.execution.commands import Lag
from phyagentos.runtime.execution.skill_runtime import SkillStatus
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.observations import Observer
from phyagentos.runtime.policies.policy_runtime import PolicyParts, PolicySkillRuntime
from phyagentos.runtime.targets.wire import Observation
from phyagentos.testing import ManualClock
from tests.policies import STREAM, describe

PERIOD_S = 0.02
INFERENCE_S = 0.1
OPEN_M, CLOSED_M = 0.08, 0.0
ROWS = 20  # of a chunk


class Client:
    """A server that answers `delay_s` after it was asked."""

    def __init__(self, clock, infer, delay_s):
        self.clock, self.infer, self.delay_s = clock, infer, delay_s
        self.asked = None

    @property
    def is_waiting(self):
        return self.asked is not None

    def ask(self, request, start=None):
        self.asked, self.due_s = request, self.clock.now_s() + self.delay_s

    def poll(self):
        if self.clock.now_s() < self.due_s - 1e-9:
            return None
        request, self.asked = self.asked, None
        rows, done = self.infer(request)
        return wire.Chunk(sequence=request.sequence, rows=rows, done=done)


class Stand:
    """A runtime on a perfect arm, in real time or in lockstep; remembers the set-point at the end of every period.

    Set `pauses` to let it rest; `asked` holds the requests, `speed` the velocity of joint 1 at the end of each period,
    `rows` its position at each physics step.
    """

    def __init__(
        self, profile, infer, *, delay_s=0.0, delta=False, rate_hz=50.0, realtime=True, history=1, execution=(), **space
    ):
        clock, self.realtime, self.pauses, self.asked, self.speed = ManualClock(), realtime, False, [], []

        def remember(request):
            self.asked.append(request)
            return infer(request)

        self.q = np.array(profile.arm.home_rad)
        self.width_m = OPEN_M if profile.end_effector == "opening" else 0.0
        spoken = ActionSpace(
            representation="joint_position",
            delta=delta,
            joints=profile.arm.joints,
            rate_hz=rate_hz,
            chunk_length=ROWS,
            **space,
            gripper=GripperRange(closed=0.0, open=1.0) if profile.end_effector == "opening" else None,
        )
        shown = {"joint_state": STREAM | {"history": history}}
        descriptor = describe(observations=shown, inference_s=INFERENCE_S, execution=dict(execution))
        streams = descriptor.observations
        observer = Observer(streams, Sensors(sensors={}), SimpleNamespace(observe=self.observe), 0.0, {})
        commands = SimpleNamespace(q_rad=self.q, gripper_width_m=self.width_m, n_steps=10, step_s=0.002)
        session = SimpleNamespace(id="s", objective="", parameters={}, seed=1)
        self.context = SimpleNamespace(
            session=session,
            profile=profile,
            commands=commands,
            lag=Lag(0.1),
            step=SimpleNamespace(tracking_error_rad=0.0),
            time_s=0.0,
            note=lambda *_, **__: None,
        )
        parts = PolicyParts(
            descriptor=descriptor,
            chain=compile_chain(spoken, describe_target_space(profile)),
            observer=observer,
            client=Client(clock, remember, delay_s),
            is_realtime=realtime,
            is_pausing=lambda: self.pauses,
        )
        self.runtime, self.clock = PolicySkillRuntime(parts, self.context), clock
        self.joint, self.rows, self.widths = [], [], []

    def observe(self):
        zeros = (0.0,) * len(self.q)
        state = TargetState(q_rad=tuple(self.q), qd_rad_s=zeros, gripper_width_m=self.width_m, tcp=Pose())
        return Observation(time_s=self.clock.now_s(), target=state)

    def run(self, turns=400):
        for _ in range(turns):
            result = self.runtime.tick()
            if result.status is not SkillStatus.RUNNING:
                return result.status
            if result.set_points is not None:
                self.q, self.width_m = result.set_points.q_rad[-1], float(result.set_points.gripper_width_m[-1])
                self.joint.append(self.q[0])
                self.rows.extend(result.set_points.q_rad[:, 0])
                self.widths.append(self.width_m)
                self.speed.append(float(result.set_points.qd_rad_s[-1][0]))
            if result.set_points is not None or self.realtime:
                self.clock.advance(PERIOD_S)
            self.context.time_s = self.clock.now_s()
        return SkillStatus.RUNNING
