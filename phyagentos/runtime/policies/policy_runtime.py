"""Carries out a policy as a skill: observe, infer, convert, command, again. Paper section 4.3 (PolicySkillRuntime).

While the server infers there is no command, and in lockstep simulated time stands: a slow server gives the same
trajectory as a fast one. Where time goes on by itself the next chunk is requested ahead, and rows that are too old by
the time it comes are left out. `PolicyExecution` declares what follows what.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from py_trees.common import Status

from phyagentos.errors import DefectError, DefinitionError, ExecutionError, find_place, list_foreign_errors
from phyagentos.protocol.capabilities.action_spaces import ActionSpace, describe_target_space
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor, PolicyExecution, Stream
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.sessions.trace import Role, TraceEvent
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.actions.bridges.chain import BridgeChain, compile_chain
from phyagentos.runtime.actions.bridges.tool_poses import describe_frames, read_arm
from phyagentos.runtime.actions.chunks import TemporalEnsemble, iter_periods, run_up
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.actions.set_points import Array, SetPoints
from phyagentos.runtime.actions.violations import Violation, ViolationCode
from phyagentos.runtime.execution.commands import compute_brake
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.criteria import is_met
from phyagentos.runtime.execution.leaf import FailureCode
from phyagentos.runtime.execution.skill_runtime import Failure, SkillStatus, TickResult
from phyagentos.runtime.execution.taken_over import Leader
from phyagentos.runtime.perception.world_model import WORLD
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.client import PolicyClient
from phyagentos.runtime.policies.exchanges import ExchangeLog
from phyagentos.runtime.policies.observations import Observer
from phyagentos.runtime.policies.readings import Compile, read_rows, suggest_lines

LEAF = "policy"
OVERLAP = 4  # rows that only shape the end of a spline: so far before it an error of its end velocity is 0.27^4
EMPTY_MAX = 20  # chunks in a row without a row that could be carried out
TIME_TOLERANCE_S = 1e-9
LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
LEADER_HZ, LEADER_ROWS, LEADER_SILENCE_S = 10.0, 20, 1.0  # of a person who moves the arm
METADATA_MAX = 300  # characters of what a server says of itself


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyParts:
    """Parts of one execution of a policy.

    Attributes:
        chain: From the policy's action space to the target's; one row per control period comes out.
        compile_from: The chain that another action space of the policy would have.
        is_realtime: Whether time goes on while the server infers.
        is_pausing: Whether the session is to rest.
        sought_m: (3,) where the first object of `environment_state` is believed to be [m]; None where there is none.
    """

    descriptor: PolicyDescriptor
    chain: BridgeChain
    observer: Observer
    client: PolicyClient
    compile_from: Compile = lambda _space: ()
    is_realtime: bool = False
    is_pausing: Callable[[], bool] = lambda: False
    sought_m: tuple[float, ...] | None = None
    log: ExchangeLog | None = None


class PolicySkillRuntime:
    """A `SkillRuntime` over a policy server; it plans nothing and sets no channels of its context."""

    def __init__(self, parts: PolicyParts, context: SkillContext) -> None:
        self._parts, self._how = parts, parts.descriptor.execution
        self._context = context
        self._periods: deque[SetPoints] = deque()
        self._beyond: Iterator[SetPoints] = iter(())  # of the present chunk, after the next one should have come
        self._ready: wire.Chunk | None = None  # waits for the horizon of the one before
        self._ensemble = TemporalEnsemble(self._how.ensemble_decay) if self._how.mode == "temporal_ensemble" else None
        self._events: list[TraceEvent] = []
        self._failure: Failure | None = None
        self._before = np.append(context.commands.q_rad, context.commands.gripper_width_m)
        self._velocity = np.zeros(len(self._before) - 1)
        self._acceleration = np.asarray(context.profile.arm.acceleration_rad_s2)
        context.lag.begin()
        self._asked_at_s, self._asked_after = 0.0, 0
        self._asked_from = self._before, self._velocity
        self._shown_at_s = 0.0  # of the present chunk
        self._chunks = self._commands = self._empty = 0
        self._is_last = self._is_met = False
        self._missed_m = np.full(3, np.inf)
        self._look_due_s = 0.0
        self._is_outdated = False  # what was asked for before a pause
        self._has_braked = False  # so that the policy, which did not, may speak of an arm in motion
        self._keeps_past = any(stream.history > 1 for stream in parts.descriptor.observations.values())

    def tick(self) -> TickResult:
        """The next control period; none while the server infers."""
        self._approach()
        try:
            if self._keeps_past:
                self._parts.observer.sample(self._context.time_s)
            self._converse()
        except ExecutionError as error:
            return self._fail(error.code, str(error), error.place if isinstance(error, DefectError) else "")
        except list_foreign_errors() as error:  # of a wire or a bridge that a package brings
            place = find_place(error)
            return self._fail("LEAF_ERROR", f"{type(error).__name__}: {error} ({place})", place)
        points = self._choose() if self._failure is None else None
        if self._failure is not None:
            return TickResult(SkillStatus.FAILED, None, LEAF)
        if points is not None:
            if self._context.lag.is_stalled:
                error_rad = self._context.step.tracking_error_rad
                return self._fail(FailureCode.STALLED, f"the arm is {error_rad:.3f} rad behind its set-points")
            self._before = np.append(points.q_rad[-1], points.gripper_width_m[-1])
            self._velocity = points.qd_rad_s[-1]
            self._commands += 1
            return TickResult(SkillStatus.RUNNING, points, LEAF)
        if self._is_last:
            why = "the acceptance was seen to hold" if self._is_met else "the policy reported done"
            self._note(Status.SUCCESS.value, message=f"{why} after {self._commands} control periods")
            return TickResult(SkillStatus.SUCCEEDED, None, LEAF)
        return TickResult(SkillStatus.RUNNING, None, LEAF, thinking=True)

    def wait(self, timeout_s: float) -> None:
        """Sleep until the server answers."""
        self._parts.client.wait(timeout_s)

    def halt(self) -> None:
        """Drop the remaining rows and close the connection."""
        self._drop()
        self._parts.client.close()

    def read_outputs(self) -> Fields:
        """How much was carried out, and where the object was from the tool when it was nearest [m]."""
        self._approach()
        near = {"missed_m": self._missed_m.round(4).tolist()} if self._parts.sought_m is not None else {}
        return {"chunks": self._chunks, "control_periods": self._commands} | near

    def find_failure(self) -> Failure | None:
        """Why it failed."""
        return self._failure

    def trace(self) -> tuple[TraceEvent, ...]:
        """One event for each chunk, one for the end."""
        return tuple(self._events)

    def close(self) -> None:
        """Close the connection, and finish the files of what was exchanged."""
        self._parts.client.close()
        if self._parts.log is not None:
            self._parts.log.close()

    @property
    def _period_s(self) -> float:
        return self._context.profile.control_period_s

    def _approach(self) -> None:
        if self._parts.sought_m is not None:
            apart_m = np.subtract(self._parts.sought_m, self._context.step.target.tcp.position_m)
            self._missed_m = min(self._missed_m, apart_m, key=np.linalg.norm)

    def _converse(self) -> None:
        """Take an answer that has come; ask when the rows run out."""
        client, is_pausing = self._parts.client, self._parts.is_pausing()
        if self._parts.descriptor.heartbeat_s is not None:
            client.watch()
        if client.is_waiting:
            if (chunk := client.poll()) is not None:
                self._ready, self._chunks = None if self._is_outdated else chunk, self._chunks + 1
                if self._parts.log is not None:
                    self._parts.log.answer(chunk)
        elif self._ready is None and not self._is_last and not is_pausing:
            is_ahead = self._parts.is_realtime and self._how.mode != "open_loop"
            ahead_s = self._parts.descriptor.inference_s if is_ahead else 0.0
            if len(self._periods) <= np.ceil(ahead_s / self._period_s):
                self._ask()
        may_switch = self._how.mode != "receding_horizon" or not self._periods
        if self._ready is not None and may_switch and not is_pausing:
            chunk, self._ready = self._ready, None
            self._take(chunk)

    def _choose(self) -> SetPoints | None:
        """The next control period: of the present chunk, or one that brakes."""
        how = self._how
        spent_s = self._commands * self._period_s
        if (how.duration_s is not None and spent_s >= how.duration_s - TIME_TOLERANCE_S) or self._looks_met():
            self._drop()
            self._is_last = True
            return self._brake()
        if self._parts.is_pausing() and (how.interruption == "row" or not self._periods):
            self._drop()
            self._is_outdated = self._parts.client.is_waiting
            return self._brake()
        if how.expiry_s is not None and self._context.time_s - self._shown_at_s > how.expiry_s + TIME_TOLERANCE_S:
            if self._periods:
                self._note(Status.RUNNING.value, message="the chunk has expired", rows=len(self._periods))
            self._drop_rows()
        if self._periods:
            return self._periods.popleft()
        return self._bridge_gap() if self._parts.is_realtime and self._commands else None

    def _looks_met(self) -> bool:
        """Whether the acceptance was seen to hold after something was commanded; looked at when it is due."""
        context, every_s = self._context, self._how.until_met_s
        if every_s is None or self._is_met or not self._commands:
            return self._is_met
        if context.time_s >= self._look_due_s - TIME_TOLERANCE_S:
            self._look_due_s = context.time_s + every_s
            self._is_met = is_met(context.session, context.world.observe(WORLD), context.initial)
        return self._is_met

    def _bridge_gap(self) -> SetPoints | None:
        """What is commanded while the next chunk is late."""
        how = self._how.underrun
        if not self._parts.client.is_waiting:
            return None
        goes_on = how == "continue" or self._ensemble is not None
        if goes_on and (points := next(self._beyond, None)) is not None:
            return points
        if how == "fail":
            self._fail("POLICY_LOST", f"no rows were left before chunk {self._chunks} came")
        return self._brake() if how in {"brake", "continue"} else None

    def _brake(self) -> SetPoints | None:
        """A control period towards rest; None at rest."""
        if not self._velocity.any():
            return None
        commands, self._has_braked = self._context.commands, True
        arm = self._before[:-1], self._velocity, self._acceleration
        q_rad, qd_rad_s = compute_brake(*arm, commands.n_steps, commands.step_s)
        return SetPoints(q_rad, qd_rad_s, np.full(commands.n_steps, self._before[-1]))

    def _drop(self) -> None:
        """Forget every chunk; the policy is shown the present before it goes on."""
        self._drop_rows()
        self._ready = None
        if self._ensemble is not None:
            self._ensemble.clear()

    def _drop_rows(self) -> None:
        self._is_last = self._is_last and not self._periods
        self._periods.clear()
        self._beyond = iter(())

    def _ask(self) -> None:
        session = self._context.session
        self._asked_at_s, observations = self._parts.observer.observe()
        self._asked_after, self._is_outdated = self._commands, False
        self._asked_from = self._before, self._velocity
        request = wire.Infer(
            session=session.id,
            sequence=self._chunks,
            rows_done=self._commands,
            time_s=self._asked_at_s,
            observations=observations,
        )
        start = wire.Start(session.id, session.objective, session.parameters, session.seed)
        self._parts.client.ask(request, None if self._chunks else start)
        if self._parts.log is not None:
            self._parts.log.show(request)

    def _take(self, chunk: wire.Chunk) -> None:
        """Convert a chunk; rows that are too old are left out, be it all of them."""
        self._is_last = chunk.done
        if not (chunk.done and not chunk.rows.size):
            rows = self._convert(chunk.rows)
            if rows is None:
                return
            late = self._commands - self._asked_after
            if self._is_past(len(rows)):
                late, self._is_last = len(rows), False
            elif self._ensemble is not None:
                rows = self._ensemble.blend(self._asked_after, rows)
            self._queue(self._leave_out(rows, late), late)
        self._empty = self._empty + 1 if not self._periods else 0
        if self._empty > EMPTY_MAX and not self._is_last:
            self._fail("POLICY_LOST", f"{self._empty} chunks in a row had nothing that could still be carried out")

    def _is_past(self, n_rows: int) -> bool:
        """Whether a chunk is too old: the world has waited for longer than its limit, and than the chunk lasts."""
        if self._how.expiry_s is None and self._periods:
            return False  # there was something to do meanwhile
        waited_s = self._parts.observer.read_time() - self._asked_at_s
        return waited_s > (self._how.expiry_s or max(n_rows * self._period_s, self._parts.descriptor.inference_s))

    def _convert(self, rows: Array) -> Array | None:
        """Rows of the target, from the set-point at their request; None when they are refused."""
        chain, (before, velocity) = self._parts.chain, self._asked_from
        bridged = read_rows(chain, np.asarray(rows, dtype=np.float64), before, velocity)
        if isinstance(bridged, Violation):
            where = f"{self._parts.descriptor.policy}, chunk {self._chunks}: {bridged}"
            metadata = ", ".join(f"{key} {value}" for key, value in self._parts.client.metadata.items())[:METADATA_MAX]
            hint = suggest_lines(chain.source, self._parts.compile_from, rows, before, velocity)
            says = f"Metadata of the server: {metadata}." if metadata else ""
            is_final = bool(hint) or bridged.code is ViolationCode.WRONG_SHAPE  # the next one would be the same
            self._fail(str(bridged.code), " ".join(filter(None, (f"{where}.", hint, says))), is_final=is_final)
            return None
        for each in bridged.interventions:
            details = {"where": each.where, "row": each.row, "before": each.before, "after": each.after}
            self._context.note("intervention", each.code, **details)
        return np.pad(bridged.rows, ((0, 0), (0, len(self._before) - chain.target.width)))  # no gripper: no opening

    def _leave_out(self, rows: Array, late: int) -> Array:
        """Without late rows; relative ones go on from the present set-point, wherever the chunk before led."""
        left = rows[late:]
        if late and len(left) and self._parts.chain.source.delta:
            left[:, :-1] += self._before[:-1] - rows[late - 1, :-1]
        return left

    def _queue(self, rows: Array, late: int) -> None:
        """Replace the chunk before, up to the rows that the next one will repeat."""
        commands, m = self._context.commands, 0
        if len(rows) and self._has_braked and not self._velocity.any():
            n_rows, rows = len(rows), run_up(rows, self._before, self._acceleration, self._period_s)
            m = len(rows) - n_rows
            if m and self._ensemble is not None:
                self._ensemble.clear()  # its rows come later than the chunk says
        self._note(Status.RUNNING.value, rows=len(rows), late=late, run_up=m, sequence=self._chunks - 1)
        if not len(rows):
            return
        self._has_braked = False
        periods = iter_periods(rows, self._before, self._velocity, n_steps=commands.n_steps, step_s=commands.step_s)
        self._periods = deque(islice(periods, max(self._count_until_next(len(rows) - m) + m, 2 * m)))
        self._beyond, self._shown_at_s = periods, self._asked_at_s

    def _count_until_next(self, n_rows: int) -> int:
        """Control periods until the next chunk is to take over; all of them where none follows."""
        if self._is_last or self._how.mode == "open_loop":
            return n_rows
        horizon = self._how.horizon or (1 if self._ensemble is not None else 0)
        if not horizon:
            return max(1, n_rows - OVERLAP)
        chain = self._parts.chain
        return max(1, min(n_rows, math.ceil(horizon * chain.target.rate_hz / chain.source.rate_hz)))

    def _fail(self, code: str, message: str, defect: str = "", *, is_final: bool = False) -> TickResult:
        self._drop()
        self._failure = Failure(LEAF, code, message, is_final, defect)
        self._note(Status.FAILURE.value, code=code, message=message)
        return TickResult(SkillStatus.FAILED, None, LEAF)

    def _note(self, status: str, *, code: str = "", message: str = "", **numbers: Any) -> None:
        self._events.append(
            TraceEvent(
                tick=self._commands,
                time_s=self._context.time_s,
                path=LEAF,
                leaf=LEAF,
                status=status,
                declared_role=Role.ACT,
                code=code,
                message=message,
                numbers=numbers,
            )
        )


def _list_poses(session: Session, world: Environment) -> dict[str, tuple[float, ...]]:
    """Position [m] and quaternion of each object that an argument names and the world shows, by parameter."""
    shown = {key: name for key, name in session.parameters.items() if isinstance(name, str) and world.shows(name)}
    named = {key: world.entities[name] for key, name in shown.items() if name in world.entities}
    return {key: (*each.pose.position_m, *each.pose.quaternion_wxyz) for key, each in named.items()}


def _describe_leader(leader: Leader, profile: TargetProfile) -> SkillRuntime:
    """A person as a policy: what the server is shown, and how its rows are read."""
    if urlsplit(leader.endpoint).scheme != "tcp" or urlsplit(leader.endpoint).hostname not in LOOPBACK:
        raise DefinitionError.of("INVALID_VALUE", "leader", leader.endpoint, "a server here: tcp://127.0.0.1:PORT")
    target, sense = describe_target_space(profile), {"modality": "proprioception", "dtype": "float64", "rate_hz": 50}
    steps = ActionSpace(
        representation="tool_pose",
        delta=True,
        rotation="axis_angle",
        rate_hz=LEADER_HZ,
        interpolation="cubic",
        chunk_length=LEADER_ROWS,
        gripper=target.gripper,
        clamp=True,
    )
    return SkillRuntime(
        skill="by_hand",
        description="A person moves the arm.",
        kind="policy",
        tree="",
        action_space=steps if leader.speaks == "tool" else target,
        policy=PolicyDescriptor(
            policy=f"person/{leader.by}",
            endpoint=leader.endpoint,
            observations={name: Stream.model_validate(sense) for name in ("tool_pose", "joint_state", "gripper_width")},
            inference_s=2.0 / LEADER_HZ,
            execution=PolicyExecution(mode="open_loop", underrun="brake", interruption="row"),
            heartbeat_s=LEADER_SILENCE_S,
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Policies:
    """The policy skills of a workspace, by name; a frame may come late by perception.yaml's `max_age_s` [s]."""

    skills: Mapping[str, SkillRuntime]
    profile: TargetProfile
    sensors: Sensors
    handle: TargetSessionHandle
    late_max_s: float
    is_realtime: bool

    def open(self, session: Session, context: SkillContext) -> PolicySkillRuntime:
        """The policy of a session that preflight has passed; its server is connected to with the first request.

        Raises:
            DefinitionError: When the documents have changed since, so that there is no such policy any more.
        """
        return self._open(self.skills[session.skill], session, context)

    def open_leader(self, leader: Leader, context: SkillContext) -> PolicySkillRuntime:
        """A person who moves the arm of a session: `tool` steps ten times a second, or joint positions.

        Raises:
            DefinitionError: When the target cannot take such commands.
        """
        return self._open(_describe_leader(leader, self.profile), context.session, context)

    def _open(self, skill: SkillRuntime, session: Session, context: SkillContext) -> PolicySkillRuntime:
        target, arm = describe_target_space(self.profile), read_arm(self.handle.describe(), context.step.target)
        compile_from = partial(compile_chain, target=target, frames=describe_frames(self.profile), arm=arm)
        chain = compile_from(skill.action_space or target)
        if not isinstance(chain, BridgeChain):
            raise DefinitionError(chain)
        policy = skill.policy
        assert policy is not None, "preflight refuses a policy skill without a policy"
        heartbeat = (policy.heartbeat_s, policy.inference_s)
        poses = _list_poses(session, context.initial)
        first = next((name for stream in policy.observations.values() for name in stream.entities), "")
        sought_m = poses[first][:3] if first in poses else None
        if sought_m is not None and (aside_m := session.parameters.get(policy.execution.aim)):
            poses[first] = (*np.add(sought_m, aside_m).tolist(), *poses[first][3:])
        parts = PolicyParts(
            descriptor=policy,
            chain=chain,
            compile_from=compile_from,
            observer=Observer(
                streams=policy.observations,
                sensors=self.sensors,
                handle=self.handle,
                late_max_s=self.late_max_s,
                health=context.initial.sensors,
                poses=poses,
            ),
            client=PolicyClient(policy.endpoint, session.limits.policy_s, policy.observations, *heartbeat),
            is_realtime=self.is_realtime,
            is_pausing=self.handle.is_pausing,
            sought_m=sought_m,
            log=ExchangeLog(context.evidence) if context.evidence is not None else None,
        )
        return PolicySkillRuntime(parts, context)
