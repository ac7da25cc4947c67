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
from phyagentos.runtime.targets.driver import SETTLE_MAX_S, VERBS, Need, TargetPort, Trait
from phyagentos.runtime.targets.handshake import Tokens
from phyagentos.runtime.targets.receive_log import LOG_BEHIND, STATE_WRITE, ReceiveLog, Reception
from phyagentos.runtime.targets.reply_check import ReplyCheck

_KEEP_ALIVE = wire.REPLIES.encode(wire.KeepAlive())


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
        driver: TargetPort,
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
        self._replies = ReplyCheck(driver)
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
            self._replies.note_motion()
            self.note_event("Withdraw")

    def forget_time(self) -> None:
        """The owner of an imagined world has put it to another moment: its time may have gone anywhere."""
        self._replies.forget_time()

    def coast(self) -> None:
        """One control period without a command: an unfinished motion is stopped, then held."""
        if self._scene is None:
            return
        if self.driver.is_moving:
            self.note_deadman()
        self.driver.hold(self.control_period_s)
        self._replies.note_motion()

    def note_deadman(self) -> None:
        """Revoke the session's authority: no command came in time, in the middle of a motion."""
        if self.revoke("DEADMAN"):
            self.note_event("Deadman")

    def revoke(self, code: str) -> bool:
        """End the commands of the present session by a stop; False without one, or where this stop did before."""
        if not self._authority.session or self._authority.stopped == code:
            return False
        self._authority.stop(code)
        return True

    def look_for_stops(self) -> bool:
        """Halt when the emergency stop is latched; whether it is."""
        if not self._is_estopped():
            return False
        if self.revoke("ESTOPPED"):
            with contextlib.suppress(ExecutionError):  # a driver that lost its own device has nothing to stop
                self.driver.emergency_stop()
            self._replies.note_motion()
            self.note_event("EStop")
        self._keep_stop()
        return True

    def send_ahead(self, request: wire.Command | wire.Capture) -> None:
        """Let the driver have a request before its turn, unless it is refused now; `handle`, in this order, answers."""
        may_go = all(taken for _, taken in self._ahead)
        if may_go and isinstance(request, wire.Command):
            refused = self._authority.check_command(
                request, self.time_s, n_before=sum(isinstance(each, wire.Command) for each, _ in self._ahead)
            )
            may_go = not (refused or self._log.is_behind or self._is_estopped())
        self._ahead.append((request, may_go and self.driver.send_ahead(request)))

    def handle(self, request: wire.Request) -> wire.Reply:
        """Carry out one request, or refuse it."""
        self._log.stamp()
        is_taken = bool(self._ahead) and self._ahead[0][0] is request and self._ahead.popleft()[1]
        try:
            reply = self._refuse(request, is_taken=is_taken) or self._look_up(request) or self._carry_out(request)
            self._note_effects(request, reply)
        except ExecutionError as error:
            if isinstance(request, wire.Begin) and request.session == self._authority.session:
                self._authority.end()
            code, message = self._replies.judge_refusal(error)
            reply = wire.Refused("ESTOPPED" if code == "ABORTED" and self.look_for_stops() else code, message)
        except DefinitionError as error:
            reply = wire.Refused(error.problems[0].code, str(error))
        except (OSError, ValueError, TypeError, msgspec.ValidationError) as error:
            reply = wire.Refused("MALFORMED", f"{type(request).__name__}: {error}")
        if self._is_logged(request):
            self._note(type(request).__name__, request, reply)
        return reply

    def _carry_out(self, request: wire.RequestFor[wire.ReplyT]) -> wire.ReplyT:
        return self._replies.check(request, self.driver.carry_out(request))

    def _is_logged(self, request: wire.Request) -> bool:
        """Whether a request stands in the receive log."""
        if isinstance(request, wire.InvokeTool):
            tools = self._description.tools if self._description is not None else ()
            return any(tool.moves and tool.name == request.name for tool in tools)
        return Trait.UNLOGGED not in VERBS[type(request)].traits

    def _refuse(self, request: wire.Request, *, is_taken: bool) -> wire.Refused | None:
        """Why a request is not carried out now; one that the driver has taken ahead was judged then."""
        match request:
            case wire.Command():
                return None if is_taken else self._refuse_command(request)
            case wire.LoadScene():
                return self._refuse_scene(request)
            case wire.Begin():
                return self._refuse_session(request)
            case wire.InvokeTool():
                return self._refuse_tool(request)
            case wire.Observe(truth=True) if not self._describe().ground_truth:
                message = "the ground truth is not offered here; perception.yaml needs `sensing: truth` in a simulation"
                return wire.Refused("REQUEST_INVALID", message)
            case wire.OfSession(session, epoch) if VERBS[type(request)].needs is Need.COMMANDING:
                if isinstance(request, wire.Call | wire.Follow):
                    self._refuse_unlogged()
                    self.look_for_stops()
                return self._authority.check_commanding(session, epoch)
            case wire.OfSession(session, epoch):
                self.look_for_stops()  # where a guard was the first to see one, no further command comes
                return self._authority.check(session, epoch)
        return None

    def _refuse_command(self, request: wire.Command) -> wire.Refused | None:
        self._refuse_unlogged()
        self.look_for_stops()
        return self._authority.check_command(request, self.time_s)

    def _refuse_scene(self, request: wire.LoadScene) -> wire.Refused | None:
        if self._authority.session:
            message = f"{self._authority.session} has authority; scenes are loaded between sessions"
            return wire.Refused("NO_AUTHORITY", message)
        standing = self._scene
        if standing is None:
            return None
        if self._is_present(request):
            if (request.scene, request.seed) != (standing.scene, standing.seed):
                known = (standing.scene, standing.seed)
                wanted = (request.scene, request.seed)
                return wire.Refused("BUSY", f"episode {request.episode} is {known}, not {wanted}")
        elif not request.may_reset:
            message = f"episode {request.episode} would end episode {standing.episode}; no reset is permitted"
            return wire.Refused("NOT_PERMITTED", message)
        return None

    def _is_present(self, request: wire.LoadScene) -> bool:
        """Whether the episode is loaded, and need not begin anew at a snapshot."""
        return self._scene is not None and request.episode == self._scene.episode and not request.snapshot

    def _refuse_session(self, request: wire.Begin) -> wire.Refused | None:
        self._refuse_unlogged()
        if not self._permits(request.session, request.epoch, request.token):
            return wire.Refused("NOT_SECURED", f"the token is not that of epoch {request.epoch} of {request.session}")
        if self._scene is None:
            return wire.Refused("REQUEST_INVALID", "no scene is loaded; send LoadScene first")
        if self.look_for_stops():
            return wire.Refused("ESTOPPED", "the emergency stop is latched; `paos estop --reset` ends it")
        return self._authority.check_begin(request.session, request.epoch)

    def _refuse_tool(self, request: wire.InvokeTool) -> wire.Refused | None:
        tools = {tool.name: tool for tool in self._describe().tools}
        if request.name not in tools:
            return wire.Refused("REQUEST_INVALID", f"no tool {request.name!r}; there are {format_names(tools)}")
        if not tools[request.name].moves:
            return None
        self._refuse_unlogged()
        self.look_for_stops()
        return self._authority.check_commanding(request.session, request.epoch)

    def _look_up(self, request: wire.Request) -> wire.Reply | None:
        """The reply that needs no driver: what it has said before, and a mistake of the request."""
        match request:
            case wire.Describe():
                return self._describe()
            case wire.LoadScene() if self._is_present(request):
                return self._loaded
            case wire.Settle() if not 0.0 <= request.duration_s <= SETTLE_MAX_S:  # also when it is NaN
                message = f"a settling time of {request.duration_s} s; 0 to {SETTLE_MAX_S} s are possible"
                return wire.Refused("MALFORMED", message)
        return None

    def _note_effects(self, request: wire.Request, reply: wire.Reply) -> None:
        """Keep what the driver's reply has changed: scene, authority, number of commands."""
        match request, reply:
            case wire.LoadScene(), wire.Loaded() if not self._is_present(request):
                self._loaded = reply
                self._scene, self._description = request, None  # cameras belong to the scene
                self._note(STATE_WRITE)
            case wire.Begin(), wire.Ack():
                self._authority.begin(request.session, request.epoch)
            case wire.Command(), wire.Step():
                self._authority.count()
                if reply.stopped:
                    self._authority.stop(reply.stopped)
            case wire.Halt(is_emergency=True), wire.Step():
                self._authority.stop("ESTOPPED")
            case wire.Halt(category=1), wire.Step() if not self._authority.stopped:
                self._authority.stop("SAFETY_STOP")
            case _, wire.Ended():
                self._authority.end()

    def _describe(self) -> wire.Description:
        if self._description is None:
            described = self._carry_out(wire.Describe())
            self._description = msgspec.structs.replace(described, ground_truth=described.ground_truth and self._truth)
        return self._description

    def _refuse_unlogged(self) -> None:
        if self._log.is_behind:
            raise ExecutionError("WRITE_FAILED", LOG_BEHIND)

    def note_event(self, kind: str) -> None:
        """An event without a request."""
        self._log.stamp()
        self._note(kind)

    def _note(self, kind: str, request: wire.Request | None = None, reply: wire.Reply | None = None) -> None:
        self._log.note(
            Reception(
                time_s=self.time_s if math.isfinite(self.time_s) else 0.0,
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
        client.send_bytes(_KEEP_ALIVE)
        return not client.poll()
    except OSError:
        return False
