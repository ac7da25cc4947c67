"""One driver under authority: what a target process serves, and the same for every driver.

Commands are refused when session, epoch, sequence number or expiry do not match, after a stop, and when the receive log
cannot be written. Requests are refused, never raised over the wire.
"""

import contextlib
import math
from collections import deque
from collections.abc import Callable

import msgspec

from phyagentos.errors import DefinitionError, ExecutionError, format_names
from phyagentos.runtime.channel import PeerChannel
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.authority import Authority
from phyagentos.runtime.targets.driver import TargetDriver
from phyagentos.runtime.targets.handshake import Tokens
from phyagentos.runtime.targets.receive_log import LOG_BEHIND, STATE_WRITE, ReceiveLog, Reception

SETTLE_MAX_S = 60.0
_BEAT = wire.REPLIES.encode(wire.Beat())
_UNLOGGED = (wire.Observe, wire.Describe, wire.Capture, wire.Shutdown)


class ServedTarget:
    """A driver with its authority and its receive log.

    Args:
        is_estopped: Whether the emergency stop is latched.
        keep_stop: Makes the latch durable; called once the target is at rest, since a disk may be slow.
        truth: Whether the driver's ground truth may be read here, where it has one.
        permits: Whether a token is that of a session's epoch (`Tokens.permits`); any is within one process.
    """

    def __init__(
        self,
        driver: TargetDriver,
        log: ReceiveLog,
        *,
        is_estopped: Callable[[], bool] = lambda: False,
        keep_stop: Callable[[], None] = lambda: None,
        truth: bool = True,
        permits: Callable[[str, int, bytes], bool] = lambda _session, _epoch, _token: True,
    ) -> None:
        self.driver, self._permits = driver, permits
        self._log, self._is_estopped, self._keep_stop, self._truth = log, is_estopped, keep_stop, truth
        self._authority = Authority()
        self._scene: wire.LoadScene | None = None
        self._loaded: wire.Loaded | None = None
        self._description: wire.Description | None = None  # of this scene
        self._ahead: deque[tuple[wire.Request, bool]] = deque()  # whether the driver has taken it before its turn

    def close(self) -> None:
        """Close driver and log."""
        self.driver.close()
        self._log.close()

    @property
    def time_s(self) -> float:
        """Time of the target [s]; NaN while no scene is loaded."""
        return self.driver.time_s

    @property
    def control_period_s(self) -> float:
        """Length of a command [s]."""
        return self.driver.control_period_s

    @property
    def is_moving(self) -> bool:
        """Whether the latest command left the body in motion."""
        return self.driver.is_moving

    def listen(self, client: PeerChannel, tokens: Tokens) -> None:
        """A client was admitted; a motion that waits for others beats, and looks at both meanwhile and for stops."""
        self.driver.is_ending = lambda: self._is_estopped() or tokens.is_stale or not beat(client)

    def withdraw(self) -> None:
        """Halt when the client disconnects; its authority ends."""
        if self._authority.session:
            self._authority.end()
            with contextlib.suppress(ExecutionError):  # a driver that lost its own device has nothing to halt
                self.driver.end()
            self._note_event("Withdraw")

    def coast(self) -> None:
        """One control period without a command: an unfinished motion is stopped, then held."""
        if self._scene is None:
            return
        if self.driver.is_moving:
            self.note_deadman()
        self.driver.hold(self.control_period_s)

    def note_deadman(self) -> None:
        """Revoke the session's authority: no command came in time, in the middle of a motion."""
        if self._authority.session:
            self._authority.stop("DEADMAN")
            self._note_event("Deadman")

    def look_for_stops(self) -> bool:
        """Halt when the emergency stop is latched; whether it is."""
        if not self._is_estopped():
            return False
        if self._authority.session and self._authority.stopped != "ESTOPPED":
            self._authority.stop("ESTOPPED")
            with contextlib.suppress(ExecutionError):  # a driver that lost its own device has nothing to stop
                self.driver.emergency_stop()
            self._note_event("EStop")
        self._keep_stop()
        return True

    def send_ahead(self, request: wire.Command | wire.Capture) -> None:
        """Let the driver have a request before its turn, unless it is refused now; `handle`, in this order, answers."""
        may_go = all(taken for _, taken in self._ahead)
        if may_go and isinstance(request, wire.Command):
            n_before = sum(isinstance(each, wire.Command) for each, _ in self._ahead)
            refused = self._authority.check_command(request, self.time_s, n_before)
            may_go = not (refused or self._log.is_behind or self._is_estopped())
        self._ahead.append((request, may_go and self.driver.send_ahead(request)))

    def handle(self, request: wire.Request) -> wire.Reply:
        """Carry out one request, or refuse it."""
        self._log.stamp()
        is_taken = bool(self._ahead) and self._ahead[0][0] is request and self._ahead.popleft()[1]
        reply: wire.Reply
        try:
            match request:
                case wire.Command():
                    if not is_taken:
                        self._refuse_unlogged()
                        self.look_for_stops()
                    refused = None if is_taken else self._authority.check_command(request, self.time_s)
                    reply = refused or self._report(self.driver.apply(request))
                case wire.Announce():
                    refused = self._authority.check_commanding(request.session, request.epoch)
                    reply = refused or wire.Admission(self.driver.announce(request))
                case wire.Observe():
                    reply = self._observe(request)
                case wire.Capture():
                    reply = self.driver.capture(request)
                case wire.Describe():
                    reply = self._describe()
                case wire.LoadScene():
                    reply = self._load(request)
                case wire.Begin():
                    reply = self._begin(request)
                case wire.InvokeTool():
                    reply = self._invoke_tool(request)
                case wire.Shutdown():
                    reply = wire.Ack()
                case _:
                    reply = self._authority.check(request.session, request.epoch) or self._bring_to_rest(request)
        except ExecutionError as error:
            code = "ESTOPPED" if error.code == "ABORTED" and self.look_for_stops() else error.code
            reply = wire.Refused(code, error.message)
        except DefinitionError as error:
            reply = wire.Refused(error.problems[0].code, str(error))
        except (OSError, ValueError, TypeError, msgspec.ValidationError) as error:
            reply = wire.Refused("MALFORMED", f"{type(request).__name__}: {error}")
        if self._is_logged(request):
            self._note(type(request).__name__, request, reply)
        return reply

    def _is_logged(self, request: wire.Request) -> bool:
        """Whether a request stands in the receive log; those that change nothing are too frequent."""
        if isinstance(request, wire.InvokeTool):
            tools = self._description.tools if self._description is not None else ()
            return any(tool.moves and tool.name == request.name for tool in tools)
        return not isinstance(request, _UNLOGGED)

    def _report(self, stopped: str) -> wire.Step:
        """The end of a command, with the code of the body's own stop."""
        self._authority.count()
        step = self.driver.report()
        if stopped:
            self._authority.stop(stopped)
            step = msgspec.structs.replace(step, stopped=stopped)
        return step

    def _bring_to_rest(self, request: wire.Halt | wire.Settle | wire.End) -> wire.Step | wire.Ended:
        """Requests that only the session in authority may send, even after a stop."""
        match request:
            case wire.Halt():
                self.driver.halt(request.category)
                if request.category == 1 and not self._authority.stopped:
                    self._authority.stop("DRIVES_OFF")
            case wire.Settle():
                if not 0.0 <= request.duration_s <= SETTLE_MAX_S:  # also when it is NaN
                    message = f"a settling time of {request.duration_s} s; 0 to {SETTLE_MAX_S} s are possible"
                    raise ExecutionError("MALFORMED", message)
                self.driver.hold(request.duration_s)
            case wire.End():
                faults = self.driver.end()
                self._authority.end()
                return wire.Ended(self.time_s, faults)
        return self.driver.report()

    def _describe(self) -> wire.Description:
        if self._description is None:
            described = self.driver.describe()
            offers = described.ground_truth and self._truth
            self._description = msgspec.structs.replace(described, ground_truth=offers)
        return self._description

    def _load(self, request: wire.LoadScene) -> wire.Reply:
        if self._authority.session:
            message = f"{self._authority.session} has authority; scenes are loaded between sessions"
            return wire.Refused("NO_AUTHORITY", message)
        standing = self._scene
        if standing is not None and self._loaded is not None:
            if request.episode == standing.episode and not request.snapshot:
                if (request.scene, request.seed) != (standing.scene, standing.seed):
                    known = (standing.scene, standing.seed)
                    asked = (request.scene, request.seed)
                    return wire.Refused("EPISODE_CONFLICT", f"episode {request.episode} is {known}, not {asked}")
                return self._loaded
            if not request.may_reset:
                message = f"episode {request.episode} would end episode {standing.episode}; no reset is permitted"
                return wire.Refused("RESET_FORBIDDEN", message)
        self._loaded = self.driver.load(request)
        self._scene, self._description = request, None  # cameras belong to the scene
        self._note(STATE_WRITE)
        return self._loaded

    def _begin(self, request: wire.Begin) -> wire.Reply:
        self._refuse_unlogged()
        if not self._permits(request.session, request.epoch, request.token):
            message = f"the token is not that of epoch {request.epoch} of {request.session}"
            return wire.Refused("BAD_TOKEN", message)
        if self._scene is None:
            return wire.Refused("NO_SCENE", "no scene is loaded; send LoadScene first")
        if self.look_for_stops():
            return wire.Refused("ESTOPPED", "the emergency stop is latched; `paos estop --reset` ends it")
        refused = self._authority.begin(request.session, request.epoch)
        if refused is not None:
            return refused
        try:
            self.driver.begin(request.session, request.epoch)
        except ExecutionError:
            self._authority.end()
            raise
        return wire.Ack()

    def _observe(self, request: wire.Observe) -> wire.Observation:
        if request.truth and not self._describe().ground_truth:
            message = "the ground truth is not offered here; perception.yaml needs `sensing: truth` for a simulation"
            raise ExecutionError("NO_GROUND_TRUTH", message)
        observation = self.driver.observe(truth=request.truth)
        if not request.snapshot:
            return observation
        return msgspec.structs.replace(observation, snapshot=self.driver.snapshot())

    def _invoke_tool(self, request: wire.InvokeTool) -> wire.Reply:
        tools = {tool.name: tool for tool in self._describe().tools}
        if request.name not in tools:
            return wire.Refused("UNKNOWN_TOOL", f"no tool {request.name!r}; there are {format_names(tools)}")
        if tools[request.name].moves:
            self._refuse_unlogged()
            self.look_for_stops()
            refused = self._authority.check_commanding(request.session, request.epoch)
            if refused is not None:
                return refused
        return self.driver.invoke_tool(request.name, request.arguments)

    def _refuse_unlogged(self) -> None:
        if self._log.is_behind:
            raise ExecutionError("LOG_UNWRITABLE", LOG_BEHIND)

    def _note_event(self, kind: str) -> None:
        """An event without a request."""
        self._log.stamp()
        self._note(kind)

    def _note(self, kind: str, request: wire.Request | None = None, reply: wire.Reply | None = None) -> None:
        self._log.note(
            Reception(
                time_s=0.0 if math.isnan(self.time_s) else self.time_s,
                kind=kind,
                episode=self._scene.episode if self._scene else "",
                session=getattr(request, "session", ""),
                epoch=getattr(request, "epoch", 0),
                sequence=getattr(request, "sequence", 0),
                accepted=not isinstance(reply, wire.Refused),
                code=reply.code if isinstance(reply, wire.Refused) else "",
            )
        )


def beat(client: PeerChannel) -> bool:
    """Let the client know that its request is worked on; whether it waits for that alone."""
    try:
        client.send_bytes(_BEAT)
        return not client.poll()
    except OSError:
        return False
