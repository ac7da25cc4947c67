"""Requirements of every driver, as checks that any package can run over its own.

    from phyagentos.testing import DRIVER_CHECKS, DriverSubject

    @pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
    def test_my_driver(check):
        check(DriverSubject(open=open_my_driver, scene="tabletop/cubes_and_trays"))

A check drives a fresh driver through `ServedTarget` and raises AssertionError. Motions are small: one joint by a few
hundredths of a radian (metres, for a slide) from its posture after `load`. A target that is served elsewhere, by
whatever program, is checked over its wire: `open` gives a `ReachedTarget`.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from phyagentos.codes import get_present_name
from phyagentos.errors import ExecutionError
from phyagentos.runtime.channel import Channel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetPort
from phyagentos.runtime.targets.handshake import greet, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback

SESSION, EPOCH = "conformance", 1
PERIODS = 25  # of the small motion: half a second at 50 Hz
TOLERANCE_RAD = 0.02  # between the last set-point and where a joint came to rest
STILL_RAD_S = 0.02

Check = Callable[["DriverSubject"], None]


class ReachedTarget:
    """A target that another program serves; `connect` opens a connection, `key` admits."""

    def __init__(self, connect: Callable[[], Channel], key: bytes) -> None:
        self._connect, self._key = connect, key
        self._reach()

    def exchange(self, request: wire.Request) -> wire.Reply:
        """The reply; a `Begin` gets its token, as from a supervisor."""
        if isinstance(request, wire.Begin):
            token = mint(self._key, request.session, request.epoch)
            request = msgspec.structs.replace(request, token=token)
        return wire.exchange(self._channel, request, 30.0)

    @property
    def control_period_s(self) -> float:
        """As it describes itself [s]."""
        live = wire.require(wire.Describe, self.exchange(wire.Describe()))
        return live.physics_step_s * live.steps_per_command

    @property
    def time_s(self) -> float:
        """As it observes [s]."""
        return self._observe().time_s

    @property
    def is_moving(self) -> bool:
        """Whether a joint moves."""
        return bool(np.abs(self._observe().target.qd_rad_s).max() >= STILL_RAD_S)

    def withdraw(self) -> None:
        """Disconnect and come again."""
        self._channel.close()
        self._reach()

    def close(self) -> None:
        """End the program."""
        with contextlib.suppress(ExecutionError):
            self.exchange(wire.Shutdown())
        self._channel.close()

    def _reach(self) -> None:
        self._channel = self._connect()
        greet(self._channel, mint(self._key))

    def _observe(self) -> wire.Observation:
        return wire.require(wire.Observe, self.exchange(wire.Observe()))


@dataclass(slots=True, kw_only=True)
class DriverSubject:
    """One driver under test, which moves `joint` (an index) by `way` [rad or m]; `open` makes a fresh one each time.

    A target that is served elsewhere is started by `open`, and notified of emergency stops by `set_stop`; by
    `count_stops` its body says how many it has heard of, where it can.

    Attributes:
        noise: By how much measurements differ while a real robot stands [rad, rad/s, m]; a simulation repeats its own.
        reset: What a person does at the robot after an emergency stop, before a session may begin.
    """

    open: Callable[[], TargetPort | ReachedTarget]
    scene: str
    joint: int = 0
    way: float = 0.04
    estop: bool = False
    noise: float = 0.0
    reset: Callable[[], None] = lambda: None
    set_stop: Callable[[bool], None] = lambda _is_stopped: None
    count_stops: Callable[["DriverClient"], int] | None = None
    _targets: list[ServedTarget | ReachedTarget] = field(default_factory=list)

    def serve(self) -> "DriverClient":
        """A fresh driver, served in this process, or reached; every message travels as bytes."""
        target = self.open()
        served: ServedTarget | ReachedTarget = (
            target
            if isinstance(target, ReachedTarget)
            else ServedTarget(target, ReceiveLog(None), is_estopped=lambda: self.estop)
        )
        self._targets.append(served)
        return DriverClient(served, self)

    def close(self) -> None:
        """Close every served target."""
        while self._targets:
            self._targets.pop().close()


@dataclass(slots=True)
class DriverClient:
    """One side of the wire."""

    target: ServedTarget | ReachedTarget
    subject: DriverSubject
    sequence: int = 0

    def ask(self, request: wire.Request) -> Any:
        """The reply, after both travelled as bytes."""
        self.subject.set_stop(self.subject.estop)
        if isinstance(self.target, ReachedTarget):
            return self.target.exchange(request)
        return wire.exchange(Loopback(self.target), request, 1.0)

    def load(self, episode: str = "e", seed: int = 1, snapshot: bytes = b"", *, may_reset: bool = True) -> Any:
        """The scene of the subject."""
        return self.ask(wire.LoadScene(self.subject.scene, seed, episode, snapshot, may_reset=may_reset))

    def begin(self, session: str = SESSION, epoch: int = EPOCH) -> "DriverClient":
        """Load and take authority."""
        _require(self.load(), wire.Loaded, "LoadScene")
        _require(self.ask(wire.Begin(session, epoch)), wire.Ack, "Begin")
        self.sequence = 0
        return self

    def make(self, **changes: Any) -> wire.Command:
        """A command that holds where the target stands; `changes` replace its fields."""
        live, now = self.ask(wire.Describe()), self.ask(wire.Observe())
        rows = np.tile(np.clip(now.target.q_rad, live.q_min_rad, live.q_max_rad), (live.steps_per_command, 1))
        command = wire.Command(
            session=SESSION,
            epoch=EPOCH,
            sequence=self.sequence + 1,
            expires_at_s=1e9,
            q_rad=rows,
            qd_rad_s=np.zeros_like(rows),
            gripper_width_m=np.full(len(rows), now.target.gripper_width_m),
        )
        return msgspec.structs.replace(command, **changes)

    def plan(self) -> list[wire.Command]:
        """A smooth small motion of one joint, towards the middle of its range."""
        first, live = self.make(), self.ask(wire.Describe())
        steps, joint = live.steps_per_command, self.subject.joint
        middle = 0.5 * (live.q_min_rad[joint] + live.q_max_rad[joint])
        way = self.subject.way * (1.0 if first.q_rad[0, joint] <= middle else -1.0)
        s = np.arange(1, PERIODS * steps + 1) / (PERIODS * steps)
        q, qd = np.tile(first.q_rad[0], (len(s), 1)), np.zeros((len(s), live.n_joints))
        q[:, joint] += way * (10 * s**3 - 15 * s**4 + 6 * s**5)
        qd[:, joint] = way * (30 * s**2 - 60 * s**3 + 30 * s**4) / (PERIODS * steps * live.physics_step_s)
        return [
            msgspec.structs.replace(
                first,
                sequence=self.sequence + 1 + index,
                q_rad=q[index * steps : (index + 1) * steps],
                qd_rad_s=qd[index * steps : (index + 1) * steps],
            )
            for index in range(PERIODS)
        ]

    def send(self, command: wire.Command) -> Any:
        """A command; counted when it was carried out."""
        reply = self.ask(command)
        self.sequence += isinstance(reply, wire.Step)
        return reply


def describes_itself(subject: DriverSubject) -> None:
    """Its description is consistent with itself and with its measurements."""
    client = subject.serve()
    _require(client.load(), wire.Loaded, "LoadScene")
    live, now = client.ask(wire.Describe()), client.ask(wire.Observe())
    n = live.n_joints
    assert live.version == wire.WIRE_VERSION, f"it speaks version {live.version} of the wire"
    assert live.driver, "a description names its driver"
    sizes = {len(live.joints), len(live.q_min_rad), len(live.q_max_rad), len(now.target.q_rad)}
    assert sizes == {n}, f"{n} joints, but lists of {sizes}"
    assert (np.array(live.q_min_rad) < live.q_max_rad).all(), "a joint's range is empty"
    period_s = live.steps_per_command * live.physics_step_s
    assert abs(period_s - client.target.control_period_s) < 1e-9, f"a command of {period_s} s"
    assert abs(client.target.time_s - now.time_s) < 1e-9 or live.mode == "realtime", "two times of one moment"


def is_nothing_before_a_scene(subject: DriverSubject) -> None:
    """Before a scene is loaded no session begins."""
    _refuse(subject.serve().ask(wire.Begin(SESSION, EPOCH)), "REQUEST_INVALID")


def keeps_an_episode(subject: DriverSubject) -> None:
    """An episode goes on, is one scene and seed, and ends only where that is permitted."""
    client = subject.serve()
    first = _require(client.load(), wire.Loaded, "LoadScene")
    assert client.load() == first, "the same episode was begun anew"
    _refuse(client.load(seed=2), "BUSY")
    _refuse(client.load("f", may_reset=False), "NOT_PERMITTED")
    _require(client.load("f"), wire.Loaded, "LoadScene")
    _require(client.ask(wire.Begin(SESSION, EPOCH)), wire.Ack, "Begin")
    _refuse(client.load("g"), "NO_AUTHORITY")


def follows_set_points(subject: DriverSubject) -> None:
    """A motion takes one control period a command, and ends where it was commanded to, at rest."""
    client = subject.serve().begin()
    commands = client.plan()
    before_s = client.ask(wire.Observe()).time_s
    for command in commands:
        step = _require(client.send(command), wire.Step, "Command")
    passed_s, expected_s = step.time_s - before_s, len(commands) * client.target.control_period_s
    if client.ask(wire.Describe()).mode == "lockstep":
        assert abs(passed_s - expected_s) < 1e-6, f"{passed_s} s passed in {expected_s} s of commands"
    rest = _require(client.ask(wire.Settle(SESSION, EPOCH, 0.3)), wire.Step, "Settle")
    error = np.abs(np.array(rest.target.q_rad) - commands[-1].q_rad[-1]).max()
    assert error < TOLERANCE_RAD, f"it came to rest {error:.4f} from its last set-point"
    assert np.abs(rest.target.qd_rad_s).max() < STILL_RAD_S, "it does not come to rest"
    assert not client.target.is_moving, "it reports a motion at rest"


def admits_a_motion_that_meets_no_other_target(subject: DriverSubject) -> None:
    """An announcement is admitted and moves nothing; it needs authority."""
    client = subject.serve().begin()
    way, before = np.vstack([command.q_rad for command in client.plan()]), _look(client)
    admission = _require(client.ask(wire.Announce(SESSION, EPOCH, way)), wire.Admission, "Announce")
    assert not admission.blocked_by, f"{admission.blocked_by} is in the way where there is no other target"
    _refuse(client.ask(wire.Announce("other", EPOCH, way)), "NO_AUTHORITY")
    assert _stands(client, before), "an announcement moved it"


def refuses_what_is_no_command(subject: DriverSubject) -> None:
    """Arrays of a wrong shape or with NaN move nothing, and their sequence number stays free."""
    client = subject.serve().begin()
    sound, before = client.make(), _look(client)
    for name in ("q_rad", "qd_rad_s", "gripper_width_m"):
        array = getattr(sound, name)
        for bad in (array[:0], np.concatenate((array, array)), array.ravel()[:1], np.full_like(array, np.nan)):
            if bad.shape != array.shape or np.isnan(bad).any():
                _refuse(client.send(client.make(**{name: bad})), "MALFORMED", "TARGET_LIMIT")
    assert _stands(client, before), "a command that was refused moved it"
    _require(client.send(client.make()), wire.Step, "a sound command after refused ones")


def asks_for_authority(subject: DriverSubject) -> None:
    """A command of another session, out of sequence or late moves nothing."""
    client = subject.serve()
    _require(client.load(), wire.Loaded, "LoadScene")
    _refuse(client.send(client.make()), "NO_AUTHORITY")
    client.begin()
    before = _look(client)
    for changes, code in (
        ({"session": "other"}, "NO_AUTHORITY"),
        ({"epoch": EPOCH + 1}, "STALE_TOKEN"),
        ({"sequence": 2}, "NO_AUTHORITY"),
        ({"expires_at_s": -1.0}, "EXPIRED"),
    ):
        _refuse(client.send(client.make(**changes)), code)
    _refuse(client.ask(wire.Begin("other", EPOCH)), "NO_AUTHORITY")
    _refuse(client.ask(wire.Settle(SESSION, EPOCH, float("nan"))), "MALFORMED")
    assert _stands(client, before), "a request that was refused moved it"
    _require(client.ask(wire.End(SESSION, EPOCH)), wire.Ended, "End")
    _refuse(client.send(client.make()), "NO_AUTHORITY")
    _refuse(client.ask(wire.Begin(SESSION, EPOCH)), "STALE_TOKEN")


def halts_in_the_middle(subject: DriverSubject) -> None:
    """A halt brings a motion to rest by the target's own means; after category 1 nothing is commanded."""
    client = _be_in_the_middle(subject)
    step = _require(client.ask(wire.Halt(SESSION, EPOCH)), wire.Step, "Halt")
    assert np.abs(step.target.qd_rad_s).max() < STILL_RAD_S, "it still moves after a halt"
    _require(client.ask(wire.Settle(SESSION, EPOCH, 0.5)), wire.Step, "Settle")
    _require(client.send(client.make()), wire.Step, "a command after a halt of category 2")
    _require(client.ask(wire.Halt(SESSION, EPOCH, category=1)), wire.Step, "Halt")
    _refuse(client.send(client.make()), "SAFETY_STOP")


def halts_when_its_client_is_gone(subject: DriverSubject) -> None:
    """A client that disconnects in the middle of a motion leaves it at rest, without authority."""
    client = _be_in_the_middle(subject)
    client.target.withdraw()
    assert not client.target.is_moving, "it goes on without its client"
    assert np.abs(client.ask(wire.Observe()).target.qd_rad_s).max() < STILL_RAD_S, "it still moves"
    _refuse(client.send(client.make()), "NO_AUTHORITY")


def stops_in_an_emergency(subject: DriverSubject) -> None:
    """A latched emergency stop ends a motion, its body hears of it, and no command or session begins under it."""
    client = _be_in_the_middle(subject)
    count = subject.count_stops or (lambda _client: int(subject.estop))
    before = count(client)
    subject.estop = True
    _refuse(client.send(client.make()), "ESTOPPED")
    assert not client.target.is_moving, "it goes on under an emergency stop"
    assert count(client) == before + 1, "its body did not hear of the emergency stop, or more than once"
    assert np.abs(client.ask(wire.Observe()).target.qd_rad_s).max() < STILL_RAD_S, "it still moves"
    _require(client.ask(wire.End(SESSION, EPOCH)), wire.Ended, "End")
    _refuse(client.ask(wire.Begin("next", EPOCH)), "ESTOPPED")
    subject.estop = False
    subject.reset()
    _require(client.ask(wire.Begin("next", EPOCH)), wire.Ack, "Begin")
    before = count(client)
    subject.estop = True
    client.ask(wire.Halt("next", EPOCH))
    assert count(client) == before + 1, "its body does not hear of an emergency stop that a halt comes upon"
    subject.estop = False
    subject.reset()


def goes_on_from_its_snapshot(subject: DriverSubject) -> None:
    """A driver that gives snapshots goes on from one with the same bits; other bytes change nothing."""
    client = subject.serve().begin()
    snapshot = client.ask(wire.Observe(snapshot=True)).snapshot
    if snapshot is None:
        return
    assert snapshot.media_type, "a snapshot without a media type"
    commands = client.plan()
    _require(client.ask(wire.End(SESSION, EPOCH)), wire.Ended, "End")
    ends = []
    for _ in range(2):
        other = subject.serve()
        _require(other.load(snapshot=snapshot.data), wire.Loaded, "LoadScene from a snapshot")
        _require(other.ask(wire.Begin(SESSION, EPOCH)), wire.Ack, "Begin")
        for command in commands:
            _require(other.send(command), wire.Step, "Command")
        ends.append(other.ask(wire.Observe(snapshot=True)).snapshot)
        _require(other.ask(wire.End(SESSION, EPOCH)), wire.Ended, "End")
    assert ends[0] == ends[1], "the same commands from the same snapshot ended in two states"
    _refuse(other.load("x", snapshot=b"no snapshot"), "MALFORMED")
    assert other.ask(wire.Observe(snapshot=True)).snapshot == ends[1], "a refused snapshot changed the state"


def offers_what_it_describes(subject: DriverSubject) -> None:
    """Tools, cameras and ground truth are those of its description; others are refused by their code."""
    client = subject.serve()
    _require(client.load(), wire.Loaded, "LoadScene")
    live = client.ask(wire.Describe())
    _refuse(client.ask(wire.InvokeTool("no such tool")), "REQUEST_INVALID")
    _refuse(client.ask(wire.Capture(cameras=("no such camera",))), "REQUEST_INVALID")
    frames = client.ask(wire.Capture()).frames if live.depth_cameras else ()
    assert all((each.number >= 0) == live.counts_frames for each in frames), "frames count unlike its description"
    if live.ground_truth:
        _require(client.ask(wire.Observe(truth=True)), wire.Observation, "Observe")
    else:
        _refuse(client.ask(wire.Observe(truth=True)), "REQUEST_INVALID")
    plain = client.ask(wire.Observe())
    assert (plain.entities, plain.regions, plain.snapshot) == ((), (), None), "more than was asked for"
    if live.offers_tool(wire.SCENE_MODEL):
        assert client.ask(wire.InvokeTool(wire.SCENE_MODEL)).artefacts, "a scene model without files"


DRIVER_CHECKS: tuple[Check, ...] = (
    describes_itself,
    is_nothing_before_a_scene,
    keeps_an_episode,
    follows_set_points,
    admits_a_motion_that_meets_no_other_target,
    refuses_what_is_no_command,
    asks_for_authority,
    halts_in_the_middle,
    halts_when_its_client_is_gone,
    stops_in_an_emergency,
    goes_on_from_its_snapshot,
    offers_what_it_describes,
)


def _be_in_the_middle(subject: DriverSubject) -> DriverClient:
    client = subject.serve().begin()
    for command in client.plan()[: PERIODS // 2]:
        _require(client.send(command), wire.Step, "Command")
    return client


def _look(client: DriverClient) -> Any:
    """The present state without its time."""
    return client.ask(wire.Observe()).target


def _stands(client: DriverClient, before: Any) -> bool:
    """Whether the state is the one before, within the noise of the subject."""
    now, noise = _look(client), client.subject.noise
    pairs = [(now.q_rad, before.q_rad), (now.qd_rad_s, before.qd_rad_s), (now.gripper_width_m, before.gripper_width_m)]
    return bool(now == before or (noise and all(np.allclose(a, b, rtol=0.0, atol=noise) for a, b in pairs)))


def _require(reply: Any, kind: type, what: str) -> Any:
    assert isinstance(reply, kind), f"{what} was answered by {reply}"
    return reply


def _refuse(reply: Any, *codes: str) -> None:
    assert isinstance(reply, wire.Refused), f"not refused: {reply}; expected {' or '.join(codes)}"
    assert get_present_name(reply.code) in codes, f"refused with {reply}; expected {' or '.join(codes)}"
