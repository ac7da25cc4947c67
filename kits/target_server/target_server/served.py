"""One body under authority: what phyagentos does for the targets that it serves itself, done here.

A command is carried out only of the session and epoch in force, with the next number, before its expiry, within the
described ranges and speeds, without a stop, and while the receive log can be written. Within a command each row is
preceded by a look at the stop file, at the client, and at its wish to end.
"""

import contextlib
import datetime
import hmac
import json
import math
import os
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from target_server.body import Body, State
from target_server.procedures import Calls
from target_server.wire import VERSION, Refusal, mint, unpack

SETTLE_MAX_S = 60.0
BEAT_S = 0.5
DEADMAN_PERIODS = 2.0  # without a command, while the body moves by itself
CALL_SILENCE_S = 1.0  # without a command, while a procedure runs; the other side looks about between commands
SLACK = 1e-6  # of ranges
SPEED_SLACK = 1.1  # of speeds between two rows
_NOTED = ("session", "epoch", "sequence")
_UNLOGGED = {"Observe", "Describe", "Capture", "Shutdown", "InvokeTool", "Follow"}


Points = tuple[list[list[float]], list[list[float]], list[float]]  # positions and speeds by row, openings


class Client:
    """What a body under authority asks of the connection to its client, in the middle of a request."""

    def wants_end(self) -> bool:
        """Whether it asked for the end of what is carried out, or is gone."""
        return False

    def beat(self) -> None:
        """Let it know that its request is worked on."""


class ReceiveLog:
    """Appends a line a request to a file, in the format of the framework's own receive logs; nothing without a path."""

    def __init__(self, path: str | None) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644) if path else -1
        self._unwritten, self.arrived_at = b"", ""
        self.note(time_s=0.0, kind="process_start")

    def stamp(self) -> None:
        """A request arrives now."""
        if self._fd >= 0:
            now = datetime.datetime.now(datetime.timezone.utc).replace(tzinfo=None)  # noqa: UP017 - Python 3.10
            self.arrived_at = f"{now.isoformat(timespec='microseconds')}Z"

    def note(self, **line: Any) -> None:
        """Append one line; kept in memory while the disk takes no more."""
        if self._fd >= 0:
            self._unwritten += json.dumps({**line, "at": self.arrived_at}).encode() + b"\n"
            self._write()

    def check(self) -> None:
        """Refuse what could not be recorded."""
        self._write()
        if self._unwritten:
            raise Refusal("WRITE_FAILED", "the receive log cannot be written; what cannot be recorded is not done")

    def _write(self) -> None:
        try:
            while self._unwritten:
                self._unwritten = self._unwritten[os.write(self._fd, self._unwritten) :]
        except OSError:
            pass  # `check` refuses what moves until it is written


class Served:
    """A body with its authority, receive log and stops; `handle` answers one request."""

    def __init__(self, body: Body, key: bytes, log: ReceiveLog, stop_file: str | None = None) -> None:
        self.body, self._key, self._log, self._stop_file = body, key, log, stop_file
        self.session, self._epoch, self._sequence, self._stopped = "", 0, 0, ""
        self._floors: dict[str, int] = {}  # of sessions that have ended: the least epoch that is still granted
        self._scene: dict[str, Any] | None = None
        self.is_moving, self._events = False, list[str]()
        self._last: Sequence[float] = ()
        self._calls = Calls(lambda: body.time_s)

    @property
    def awaits_command(self) -> bool:
        """Whether it is halted unless a command follows in time."""
        return self.is_moving or self._calls.is_running

    @property
    def period_s(self) -> float:
        """Length of a command [s]."""
        return self.body.step_s * self.body.steps_per_command

    def handle(self, request: dict[str, Any], client: Client) -> dict[str, Any]:
        """The reply to one decoded request."""
        self._log.stamp()
        kind = request["type"]
        try:
            reply = self._carry_out(kind, request, client)
        except Refusal as refusal:
            reply = {"type": "Refused", "code": refusal.code, "message": str(refusal)}
        if kind not in _UNLOGGED:
            self._note(kind, request, reply.get("code", ""))
        self._note_events()
        return reply

    def withdraw(self) -> None:
        """The client is gone: halt, and end its authority."""
        if self.session:
            self._end()
            self._log.stamp()
            self._note("Withdraw")

    def watch(self, silent_s: float) -> None:
        """Between requests: halt under an emergency stop, and where a body in motion got no command in time."""
        self._log.stamp()
        self.look_for_stops()
        silence_max_s = max(DEADMAN_PERIODS * self.period_s, 0.0 if self.is_moving else CALL_SILENCE_S)
        is_awaited = self.body.is_realtime and self.awaits_command and not self._stopped
        if is_awaited and self.body.measure_silence(silent_s) > silence_max_s:
            self._stop("DEADMAN", "Deadman")
        self._note_events()

    def look_for_stops(self) -> bool:
        """Halt under an emergency stop; whether there is one: whether the stop file exists."""
        is_stopped = self._stop_file is not None and os.path.exists(self._stop_file)  # noqa: PTH110 - before each row, so the cheapest
        if is_stopped and self.session and self._stopped != "ESTOPPED":
            self._stop("ESTOPPED", "EStop")
        return is_stopped

    def _carry_out(self, kind: str, request: dict[str, Any], client: Client) -> dict[str, Any]:
        if kind == "Describe":
            return self._describe()
        if kind == "Observe":
            return self._observe(request)
        if kind == "Announce":  # no other body is in its world
            self._check(request)
            return {"type": "Admission", "blocked_by": ""}
        if kind == "Capture":
            return self._capture(request)
        if kind == "InvokeTool":
            return self._invoke(request)
        if kind == "Shutdown":
            return {"type": "Ack"}
        if kind == "LoadScene":
            return self._load(request, client)
        if kind == "Begin":
            return self._begin(request)
        if kind in ("Command", "Call"):
            self._log.check()
        if kind in ("Command", "Call", "Follow"):
            self.look_for_stops()
            self._check(request)
            self._check_stop()
            if kind != "Command":
                return self._follow(kind, request)
            self._check_turn(request)
            return self._apply(self._read_points(request), client)
        self.look_for_stops()
        self._check(request)
        if kind == "Cancel":
            return self._calls.cancel(request["number"]).encode()
        return self._bring_to_rest(kind, request, client)

    def _describe(self) -> dict[str, Any]:
        body, joints = self.body, self.body.joints
        return {
            "type": "Description", "target": body.target, "driver": body.driver, "version": VERSION,
            "n_joints": len(joints), "joints": [each.name for each in joints],
            "steps_per_command": body.steps_per_command, "physics_step_s": body.step_s,
            "q_min_rad": [each.low for each in joints], "q_max_rad": [each.high for each in joints],
            "observations": list(body.observations), "actions": list(body.actions),
            "cameras": list(body.cameras), "depth_cameras": list(body.cameras),
            "mode": "realtime" if body.is_realtime else "lockstep", "end_effector": body.end_effector,
            "gripper_force_n": body.gripper_force_n, "ground_truth": body.has_truth,
            "tools": [{"name": name, "moves": False} for name in body.tools],
            "procedures": list(map(vars, body.procedures)),
            "kinematics": {
                "axes": [each.axis for each in joints], "anchors_m": [each.anchor_m for each in joints],
                "tcp_m": body.tcp_m, "slides": [each.slides for each in joints],
            },
        }  # fmt: skip

    def _observe(self, request: dict[str, Any]) -> dict[str, Any]:
        reply: dict[str, Any] = {"type": "Observation", "time_s": self.body.time_s, "target": _encode(self.body.read())}
        if request["truth"]:
            if not self.body.has_truth:
                raise Refusal("REQUEST_INVALID", "the target has no ground truth")
            reply["entities"] = [
                each.encode() | {"observed_at_s": self.body.time_s, "source": self.body.driver}
                for each in self.body.list_entities()
            ]
            reply["regions"] = list(self.body.list_regions())
        if request["truth"] or not self.body.has_truth:
            reply["signals"] = {name: list(map(float, each)) for name, each in self.body.list_signals().items()}
        snapshot = self.body.snapshot() if request["snapshot"] else None
        if snapshot is not None:
            reply["snapshot"] = {"media_type": snapshot[0], "data": snapshot[1]}
        return reply

    def _capture(self, request: dict[str, Any]) -> dict[str, Any]:
        windows, names = request["crops"], request["cameras"]
        is_window = all(
            isinstance(each, list) and len(each) == len(("left", "top", "width", "height")) and _are(int, each)
            for each in windows.values()
        )
        if not _are(str, [*names, *windows]) or not is_window:
            raise Refusal("MALFORMED", f"cameras {names!r} and windows {windows!r}")
        pictures = self.body.capture(names, {name: tuple(each) for name, each in windows.items()}, request["every"])
        missing = {*(names or self.body.cameras)} - {each.camera for each in pictures}
        return {
            "type": "Frames", "frames": [each.encode() for each in pictures],
            "missing": dict.fromkeys(sorted(missing), "OBSERVATION_UNAVAILABLE"),
        }  # fmt: skip

    def _invoke(self, request: dict[str, Any]) -> dict[str, Any]:
        name = request["name"]
        if name not in self.body.tools:
            raise Refusal("REQUEST_INVALID", f"no tool {name!r}; there are {', '.join(self.body.tools) or 'none'}")
        files = self.body.tools[name](request["arguments"])
        artefacts = {file: {"media_type": media, "data": data} for file, (media, data) in files.items()}
        return {"type": "ToolResult", "artefacts": artefacts}

    def _load(self, request: dict[str, Any], client: Client) -> dict[str, Any]:
        if self.session:
            raise Refusal("NO_AUTHORITY", f"{self.session} has authority; scenes are loaded between sessions")
        standing, loaded = self._scene, {"type": "Loaded", "episode": request["episode"], "model_sha256": ""}
        if standing is not None:
            if request["episode"] == standing["episode"] and not request["snapshot"]:
                known, wanted = [(each["scene"], each["seed"]) for each in (standing, request)]
                if known != wanted:
                    raise Refusal("BUSY", f"episode {request['episode']} is {known}, not {wanted}")
                return loaded
            if not request["may_reset"]:
                message = f"episode {request['episode']} would end episode {standing['episode']}; no reset is permitted"
                raise Refusal("NOT_PERMITTED", message)
        self.body.beat = client.beat
        self.body.load(request["scene"], request["seed"], request["snapshot"])
        self._scene = request
        self._note("state_write")
        return loaded

    def _begin(self, request: dict[str, Any]) -> dict[str, Any]:
        self._log.check()
        session, epoch = request["session"], request["epoch"]
        if not hmac.compare_digest(request["token"], mint(self._key, session, epoch)):
            raise Refusal("NOT_SECURED", f"the token is not that of epoch {epoch} of {session}")
        if self._scene is None:
            raise Refusal("REQUEST_INVALID", "no scene is loaded; send LoadScene first")
        if self.look_for_stops():
            raise Refusal("ESTOPPED", f"the emergency stop is set; remove {self._stop_file} to reset it")
        if not session:
            raise Refusal("MALFORMED", "a session needs a name")
        if self.session and (session, epoch) != (self.session, self._epoch):
            raise Refusal("NO_AUTHORITY", f"{self.session} has authority; it must end first")
        if epoch < self._floors.get(session, 0):
            raise Refusal("STALE_TOKEN", f"epoch {epoch} of {session} is over")
        self.body.read()  # a body that cannot say where it is begins nothing
        if not self.session:
            self._calls.begin()
        if not self.session:
            self._stopped = ""  # the same claim made twice does not undo a stop
        self.session, self._epoch, self._sequence = session, epoch, 0
        self._rest()
        return {"type": "Ack"}

    def _check(self, request: dict[str, Any]) -> None:
        """Whether the session has authority."""
        if request["session"] != self.session or not self.session:
            raise Refusal("NO_AUTHORITY", f"{self.session or 'no session'} has authority, not {request['session']}")
        if request["epoch"] != self._epoch:
            raise Refusal("STALE_TOKEN", f"epoch {request['epoch']}; authority was given for {self._epoch}")

    def _check_stop(self) -> None:
        """Whether no stop has ended the session's commands."""
        if self._stopped:
            raise Refusal(self._stopped, f"{self.session} was stopped; another session must begin first")

    def _follow(self, kind: str, request: dict[str, Any]) -> dict[str, Any]:
        """Start a procedure, or say how far it is."""
        name, number = request.get("procedure", ""), request["number"]
        if kind == "Follow":
            return self._calls.read(number).encode()
        self._calls.check()
        if name not in (known := [each.name for each in self.body.procedures]):
            raise Refusal("REQUEST_INVALID", f"no procedure {name!r}; there are {', '.join(known) or 'none'}")
        start = partial(self.body.call, name, request["goal"])
        return self._calls.start(number, name, request["cancel_within_s"], start).encode()

    def _check_turn(self, request: dict[str, Any]) -> None:
        """Whether a command may be carried out now."""
        body = self.body
        self._calls.check()
        if request["sequence"] != self._sequence + 1:
            raise Refusal("NO_AUTHORITY", f"number {request['sequence']} after {self._sequence}")
        if not body.time_s <= request["expires_at_s"]:  # also when the expiry is NaN
            raise Refusal("EXPIRED", f"it is {body.time_s:.3f} s, the command expired at {request['expires_at_s']} s")

    def _read_points(self, request: dict[str, Any]) -> Points:
        """The set-points of a command that may be carried out now, and could be."""
        body, joints, n = self.body, self.body.joints, self.body.steps_per_command
        rows, speeds = (unpack(name, request[name], (n, len(joints))) for name in ("q_rad", "qd_rad_s"))
        widths = unpack("gripper_width_m", request["gripper_width_m"], (n,))
        if any(not -SLACK <= each <= body.width_max_m + SLACK for each in widths):
            raise Refusal("TARGET_LIMIT", f"gripper_width_m: outside of 0 to {body.width_max_m:g} m")
        before, step_s = self._last, body.step_s
        for row, speed in zip(rows, speeds, strict=True):
            for joint, was, q, qd in zip(joints, before, row, speed, strict=True):
                if not joint.low - SLACK <= q <= joint.high + SLACK:
                    raise Refusal(
                        "TARGET_LIMIT", f"{joint.name} at {q:.6g}; {joint.low:g} to {joint.high:g} is its range"
                    )
                moved = abs(q - was) / step_s
                if max(abs(qd), moved) > SPEED_SLACK * joint.velocity + SLACK / step_s:
                    found = f"{joint.name} at {max(abs(qd), moved):.4g}/s"
                    raise Refusal("TARGET_LIMIT", f"{found}; its limit is {joint.velocity:g}/s")
            before = row
        return rows, speeds, widths

    def _apply(self, points: Points, client: Client) -> dict[str, Any]:
        """Row by row; a stop or a client that wants the end breaks the command off and brings the body to rest."""
        self._sequence += 1
        stopped, beat_s = "", time.monotonic()
        for q, qd, width_m in zip(*points, strict=True):
            if self.look_for_stops():
                stopped = "ESTOPPED"
            elif client.wants_end():
                stopped = "ABORTED"
                self._stop(stopped, "Abort")
            else:
                stopped = self.body.step(q, qd, width_m)
                self._stopped = self._stopped or stopped
            if stopped:
                break
            if time.monotonic() - beat_s > BEAT_S:
                client.beat()
                beat_s = time.monotonic()
        self.is_moving = not stopped and any(points[1][-1])
        self._last = self.body.read().q if stopped else points[0][-1]
        return self._report(stopped, self._last)

    def _bring_to_rest(self, kind: str, request: dict[str, Any], client: Client) -> dict[str, Any]:
        if kind == "End":
            self._end()
            return {"type": "Ended", "time_s": self.body.time_s, "faults": []}
        if kind == "Halt" and request["is_emergency"]:
            self._stop("ESTOPPED", "EStop")
        elif kind == "Halt":
            self._calls.cancel_all()
            self.body.halt(request["category"])
            if request["category"] == 1:
                self._stopped = self._stopped or "SAFETY_STOP"
        else:
            if not 0.0 <= request["duration_s"] <= SETTLE_MAX_S:  # also when it is NaN
                raise Refusal("MALFORMED", f"a settling time of {request['duration_s']} s; 0 to {SETTLE_MAX_S} s")
            if self.is_moving:
                self.body.halt(2)
            for _ in range(math.ceil(request["duration_s"] / self.body.step_s - SLACK)):
                if client.wants_end():
                    break
                self.body.stay()
        self._rest()
        return self._report("", self._last)

    def _stop(self, code: str, event: str) -> None:
        self._stopped = code
        self._calls.cancel_all()
        if code == "ESTOPPED":
            self.body.emergency_stop()
        else:
            self.body.halt(2)
        self._rest()
        self._events.append(event)

    def _note_events(self) -> None:
        """A stop in the middle of a request comes after it: the request arrived before."""
        while self._events:
            self._note(self._events.pop(0))

    def _end(self) -> None:
        session, self.session = self.session, ""
        self._floors[session] = self._epoch + 1
        self._calls.cancel_all()
        if self.is_moving:
            self.body.halt(2)
        for _ in range(math.ceil(self._calls.longest_s / self.body.step_s)):
            if self._calls.has_ended():
                break
            self.body.beat()
            self.body.stay()
        self._calls.leave()
        self._rest()
        self.body.note_end(session)

    def _rest(self) -> None:
        self.is_moving = False
        with contextlib.suppress(Refusal):  # of a body that is lost: it refuses by itself what comes
            self._last = self.body.read().q

    def _report(self, stopped: str, wanted: Any) -> dict[str, Any]:
        return {
            "type": "Step", "time_s": self.body.time_s, "target": _encode(self.body.read()), "stopped": stopped,
            "tracking_error_rad": self.body.measure_error(wanted),
        }  # fmt: skip

    def _note(self, kind: str, request: dict[str, Any] | None = None, code: str = "") -> None:
        line: dict[str, Any] = {name: request[name] for name in _NOTED if name in request} if request else {}
        line |= {"accepted": False, "code": code} if code else {}
        self._log.note(
            time_s=self.body.time_s if self._scene else 0.0,
            kind=kind,
            episode=self._scene["episode"] if self._scene else "",
            **line,
        )


def _encode(state: State) -> dict[str, Any]:
    symbols = {name: getattr(state, name) for name in ("base", "inventory", "vitals", "nearby", "daylight")}
    return {name: each for name, each in symbols.items() if each is not None} | {
        "q_rad": list(map(float, state.q)), "qd_rad_s": list(map(float, state.qd)), "gripper_width_m": state.width_m,
        "tcp": {"position_m": list(map(float, state.tcp_m)), "quaternion_wxyz": list(state.tcp_wxyz)},
        "holding": list(state.holding), "fingers_touching": state.fingers_touching, "grip_force_n": state.grip_force_n,
    }  # fmt: skip


def _are(kind: type, values: Sequence[Any]) -> bool:
    return all(type(each) is kind for each in values)
