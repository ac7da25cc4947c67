"""Where time goes on while a policy infers, its late chunks lead where it said, and never by a jump."""

from types import SimpleNamespace

import numpy as np
import pytest

from phyagentos.protocol.capabilities.action_spaces import ActionSpace, GripperRange, describe_target_space
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.runtime.actions.bridges.compilation import compile_chain
from phyagentos.runtime.execution.lag import Lag
from phyagentos.runtime.execution.skill_runtime import SkillStatus
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.policy_runtime import PolicyParts, PolicySkillRuntime
from tests.clocks import ManualClock

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
    """A runtime in real time on a perfect arm; remembers the set-point at the end of every control period."""

    def __init__(self, profile, infer, *, delay_s, delta=False, rate_hz=50.0):
        clock = ManualClock()
        self.q = np.array(profile.arm.home_rad)
        self.width_m = OPEN_M if profile.end_effector == "opening" else 0.0
        shown = lambda: {"joint_state": self.q.copy()}  # noqa: E731
        observer = SimpleNamespace(observe=lambda: (clock.now_s(), shown()), read_time=clock.now_s)
        space = ActionSpace(
            representation="joint_position",
            delta=delta,
            joints=profile.arm.joints,
            rate_hz=rate_hz,
            chunk_length=ROWS,
            gripper=GripperRange(closed=0.0, open=1.0) if profile.end_effector == "opening" else None,
        )
        stream = {"modality": "proprioception", "shape": ["n_joints"], "dtype": "float64", "unit": "rad", "rate_hz": 50}
        descriptor = PolicyDescriptor.model_validate(
            {
                "policy": "line/1",
                "endpoint": "tcp://127.0.0.1:1",
                "observations": {"joint_state": stream},
                "inference_s": INFERENCE_S,
            }
        )
        commands = SimpleNamespace(q_rad=self.q, gripper_width_m=self.width_m, n_steps=10, step_s=0.002)
        session = SimpleNamespace(id="s", objective="", parameters={}, seed=1)
        context = SimpleNamespace(
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
            chain=compile_chain(space, describe_target_space(profile)),
            observer=observer,
            client=Client(clock, infer, delay_s),
            is_realtime=True,
        )
        self.runtime, self.clock = PolicySkillRuntime(parts, context), clock
        self.joint, self.widths = [], []

    def run(self, turns=400):
        for _ in range(turns):
            result = self.runtime.tick()
            if result.status is not SkillStatus.RUNNING:
                return result.status
            if result.set_points is not None:
                self.q, self.width_m = result.set_points.q_rad[-1], float(result.set_points.gripper_width_m[-1])
                self.joint.append(self.q[0])
                self.widths.append(self.width_m)
            self.clock.advance(PERIOD_S)
        return SkillStatus.RUNNING


def tell(positions, gripper, *, delta):
    """Rows of a chunk that lets joint 1 pass these positions, of which the first is where it stands, beside home."""
    rows = np.zeros((len(positions) - 1, 8))
    rows[:, 0] = np.diff(positions) if delta else positions[1:]
    rows[:, 7] = gripper
    return rows


@pytest.mark.parametrize("rate_hz", [50.0, 25.0])
@pytest.mark.parametrize("delta", [False, True], ids=["absolute", "delta"])
@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.06, 0.1])
def test_a_late_chunk_leads_where_the_policy_said_when_it_was_asked(profile, delay_s, delta, rate_hz):
    home = np.array(profile.arm.home_rad)
    along = lambda t: 0.75 * (1.0 - np.cos(1.2 * np.clip(t, 0.0, np.pi / 1.2)))  # noqa: E731

    def infer(request):
        times_s = request.rows_done * PERIOD_S + np.arange(ROWS + 1) / rate_hz
        rows = tell(along(times_s), times_s[1:] < 1.0, delta=delta)
        rows[:, :7] += 0.0 if delta else home
        return rows, bool(times_s[-1] > np.pi / 1.2)

    stand = Stand(profile, infer, delay_s=delay_s, delta=delta, rate_hz=rate_hz)
    assert stand.run() is SkillStatus.SUCCEEDED, stand.runtime.find_failure()
    times_s = PERIOD_S * np.arange(1, len(stand.joint) + 1)
    assert np.array(stand.joint) - home[0] == pytest.approx(
        along(times_s), abs=1e-3
    )  # rows of 25 Hz have lines between
    assert stand.joint[-1] - home[0] == pytest.approx(1.5, abs=1e-4)
    assert np.array(stand.widths)[times_s < 0.95] == pytest.approx(OPEN_M)
    assert np.array(stand.widths)[times_s > 1.0] == pytest.approx(CLOSED_M)


@pytest.mark.parametrize("stood", [True, False], ids=["stood", "moved"])
def test_a_late_chunk_of_changes_goes_on_from_where_the_arm_is(profile, stood):
    way = 0.002  # of one row

    def infer(request):  # changes its mind between the first chunk and the later ones
        moves = bool(request.sequence) if stood else not request.sequence
        return tell(way * moves * np.arange(ROWS + 1), 1.0, delta=True), request.sequence >= 2

    stand = Stand(profile, infer, delay_s=0.1, delta=True)
    assert stand.run() is SkillStatus.SUCCEEDED
    steps = np.diff(stand.joint, prepend=profile.arm.home_rad[0])
    assert np.isclose(steps, way, atol=1e-9).sum() + np.isclose(steps, 0.0, atol=1e-9).sum() == len(steps)
    assert sorted(set(np.round(steps / way).astype(int))) == [0, 1], "no row that is left out comes at once"


def test_a_policy_moves_an_arm_without_a_gripper_by_rows_without_its_column(profile):
    told = profile.model_dump(exclude={"gripper"}) | {"end_effector": "none"}
    bare, home = type(profile).model_validate(told), np.array(profile.arm.home_rad)
    line = np.linspace(home[0], home[0] + 0.02, ROWS + 1)
    stand = Stand(bare, lambda _: (tell(line, 0.0, delta=False)[:, :-1] + [0.0, *home[1:]], True), delay_s=0.0)

    assert stand.run() is SkillStatus.SUCCEEDED
    assert stand.q == pytest.approx([line[-1], *home[1:]], abs=1e-6)
    assert set(stand.widths) == {0.0}
