"""What a driver answers, checked once at the boundary of a target, before anything else reads it.

A reply that cannot be true is the target's fault, `PROTOCOL_BROKEN` with field and value: time that stands, jumps or
runs backwards, a number that is not finite, or below zero where none can be, lists, names and depths without end, text
where a code or a file name belongs, pictures of another kind or of a camera that was not requested.
"""

import math
import re
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from phyagentos.codes import Phase, find_code
from phyagentos.errors import ExecutionError, format_names
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetPort

HALT_MAX_S = 10.0  # of the target's time, to come to rest
STANDS = 1e-3  # of what was to pass, where time goes on by itself
LATE_MAX_S = 1.0  # of a command's end after its expiry and its period
ITEMS_MAX = 100_000  # numbers, texts and lists of one reply, besides what arrays hold
DEPTH_MAX = 50  # of lists in lists
NAME_MAX = 1000  # characters of a name
SMALL = 100  # of them in one list, or characters, of a report that needs no closer look
TEXT_MAX = 2**16  # characters of one text
SHOWN = 200  # of them in a message
UNIT_TOLERANCE = 0.01  # of the length of a quaternion
FILES = {
    wire.SCENE_MODEL: {evidence.SCENE_MODEL, evidence.SCENE_XML},
    wire.MOTION: {evidence.MOTION},
    wire.RENDER: {wire.PICTURE},
}
"""Files of the tools that a session uses."""
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")  # of a file of any other tool
_MAY_BE_INFINITE = re.compile(r"(gripper_force_n|q_(min|max)_rad\[\d+\])")  # of a description: unknown, without an end
_AT_LEAST_ZERO = ("tracking_error_rad", "contact_force_n", "contact_force_error_n")  # of a report
_OF_PEOPLE = ("message", "reason")  # texts that may come from another program
_OF_STOPS = {Phase.SAFETY, Phase.TARGET}


class ReplyCheck:
    """Judges the replies of one driver in their order; knows the time of the latest one."""

    def __init__(self, driver: TargetPort) -> None:
        self._driver = driver
        self._live: wire.Description | None = None
        self._time_s = self._slack_s = math.nan

    def note_motion(self) -> None:
        """The driver has moved without a request, or by one whose reply has no time: its time may have gone on."""
        self._slack_s = HALT_MAX_S

    def forget_time(self) -> None:
        """The owner of an imagined world has put it to another moment."""
        self._time_s = math.nan

    def check(self, request: wire.RequestFor[wire.ReplyT], reply: wire.ReplyT) -> wire.ReplyT:
        """The reply; raises ExecutionError `PROTOCOL_BROKEN`."""
        fault = self._find_fault(request, reply)
        if fault:
            raise ExecutionError("PROTOCOL_BROKEN", f"{type(request).__name__} was answered with {fault}")
        match request, reply:
            case wire.LoadScene(), _:
                self._live, self._time_s = None, math.nan
            case wire.Begin() | wire.InvokeTool() | wire.Announce(), _:
                self.note_motion()
            case _, wire.Description():
                self._live = reply
        return reply

    def judge_refusal(self, error: ExecutionError) -> tuple[str, str]:
        """Code and message of a refusal by the driver; `PROTOCOL_BROKEN` where its code is none."""
        message = clean(error.message)[: 10 * SHOWN]
        if (row := find_code(error.code)) is not None:
            return row.name, message
        return "PROTOCOL_BROKEN", f"a refusal with the code {_show(error.code)}, which is none: {message}"

    def _find_fault(self, request: wire.Request, reply: wire.Reply) -> str:
        is_plain = isinstance(reply, wire.Step | wire.Frames) and _is_plainly_sound(reply)  # most replies of a session
        fault = "" if is_plain else _find_unsound(reply)
        if isinstance(reply, wire.Step):
            fault = fault or (_find_fault_of_code(reply.stopped, _OF_STOPS) if reply.stopped else "")
            fault = fault or self._find_fault_of_size(reply.target.q_rad, reply.target.qd_rad_s)
            fault = fault or _find_negative(reply)
            return fault or self._find_fault_of_time(request, reply.time_s, is_stopped=bool(reply.stopped))
        match reply:
            case wire.Observation(time_s, target):
                fault = fault or self._find_fault_of_size(target.q_rad, target.qd_rad_s)
                fault = fault or self._find_fault_of_time(request, time_s)
            case wire.Ended(time_s):
                fault = fault or self._find_fault_of_time(request, time_s)
            case wire.Description():
                fault = fault or _find_fault_of_command(reply)
            case wire.ToolResult(artefacts) if isinstance(request, wire.InvokeTool):
                fault = fault or _find_foreign_file(request.name, artefacts)
            case wire.Frames(frames, missing) if isinstance(request, wire.Capture):
                faults = (*map(_find_fault_of_frame, frames), *map(_find_fault_of_code, missing.values()))
                fault = fault or _find_fault_of_cameras(request, frames) or next(filter(None, faults), "")
        return fault

    def _find_fault_of_size(self, *joints: tuple[float, ...]) -> str:
        live = self._live
        wrong = [len(each) for each in joints if live is not None and len(each) != live.n_joints]
        return f"{wrong[0]} joints, where it described {live.n_joints}" if wrong and live is not None else ""

    def _find_fault_of_time(self, request: wire.Request, time_s: float, *, is_stopped: bool = False) -> str:
        """Where time moves by requests alone, each takes its own; elsewhere it goes on, and no command ends late."""
        before_s, slack_s, live = self._time_s, self._slack_s, self._live
        self._time_s, self._slack_s = time_s, 0.0
        if math.isnan(before_s) or live is None:
            return ""
        passed_s, step_s = time_s - before_s, live.physics_step_s
        found = f"the time {time_s:.3f} s after {before_s:.3f} s: "
        if passed_s < -0.5 * step_s:
            return f"{found}it runs backwards"
        least_s, most_s = _bound(request, step_s * live.steps_per_command, is_stopped=is_stopped)
        steps_alone = live.mode == WorldMode.LOCKSTEP and not live.shares_time
        expected_s = least_s - 0.5 * step_s if steps_alone else STANDS * least_s
        if passed_s < expected_s and (passed_s <= STANDS * least_s or not self._driver.is_ending()):  # asks the client
            return f"{found}it stands, where {least_s:g} s were to pass"
        if steps_alone and passed_s > most_s + slack_s + 0.5 * step_s:
            return f"{found}it jumps, where {most_s:g} s were to pass at most"
        if isinstance(request, wire.Command) and time_s > request.expires_at_s + most_s + LATE_MAX_S:
            return f"{found}the command had expired at {request.expires_at_s:.3f} s"
        return ""


def _bound(request: wire.Request, period_s: float, *, is_stopped: bool) -> tuple[float, float]:
    """How much time a request takes at least and at most [s]."""
    match request:
        case wire.Command():
            return (0.0, period_s + HALT_MAX_S) if is_stopped else (period_s, period_s)
        case wire.Settle(duration_s=duration_s):
            return duration_s, duration_s + HALT_MAX_S
        case wire.Halt() | wire.End():
            return 0.0, HALT_MAX_S
    return 0.0, 0.0


def _is_plainly_sound(value: object) -> bool:
    """Whether a small value has no fault; quicker than `_find_unsound`, which also finds the place of one."""
    match value:
        case float():
            return math.isfinite(value)
        case str():
            return len(value) <= SMALL and value.isprintable()
        case tuple():
            return len(value) <= SMALL and (_are_finite(value) or all(map(_is_plainly_sound, value)))
        case msgspec.Struct():
            is_turn = not (isinstance(value, Pose) and _is_no_turn(value))
            return is_turn and all(map(_is_plainly_sound, msgspec.structs.astuple(value)))
        case dict():
            return not value
        case np.ndarray():
            return bool(value.dtype != np.float64)
    return value is None or value is msgspec.UNSET or isinstance(value, int)


def _are_finite(values: tuple[object, ...]) -> bool:
    """Whether all are finite numbers; nothing else is quicker in a list of them."""
    try:
        return all(map(math.isfinite, values))  # type: ignore[arg-type]
    except (TypeError, OverflowError):
        return False


def _find_unsound(reply: wire.Reply) -> str:
    """The first number that is not finite, quaternion that is no turn, or endless part; empty where all is sound."""
    is_description = isinstance(reply, wire.Description)
    for number, (where, part) in enumerate(_list_parts(reply, "")):
        if number >= ITEMS_MAX:
            return f"more than {ITEMS_MAX} numbers, texts and lists"
        if isinstance(part, float) and not math.isfinite(part):
            if not (is_description and _MAY_BE_INFINITE.fullmatch(where)):
                return f"{where} = {part}"
        elif isinstance(part, str | bytes) and len(part) > TEXT_MAX:
            return f"{where}, a text of {len(part)} characters, {TEXT_MAX} are possible"
        elif isinstance(part, str) and not where.endswith(_OF_PEOPLE) and clean(part) != part:
            return f"{where} = {_show(part)}, a text with characters that no document holds"
        elif isinstance(part, Pose) and _is_no_turn(part):
            return f"{where}.quaternion_wxyz = {part.quaternion_wxyz}, which is no turn"
        elif isinstance(part, dict) and (fault := _find_fault_of_names(part)):
            return f"{where}, {fault}"
        elif isinstance(part, dict | list) and where.count("[") > DEPTH_MAX:
            return f"more than {DEPTH_MAX} lists in lists"
    return ""


def _find_fault_of_names(named: dict[object, object]) -> str:
    names = [name for name in named if isinstance(name, str)]
    if long := next((name for name in names if len(name) > NAME_MAX), ""):
        return f"a name of {len(long)} characters, {NAME_MAX} are possible"
    strange = next((name for name in names if not name.isprintable()), None)
    return f"{_show(strange)} where a name belongs" if strange is not None else ""


def _list_parts(value: object, where: str) -> Iterator[tuple[str, object]]:
    """Numbers, texts, poses and lists below a value, each before what it holds, with their paths."""
    if isinstance(value, msgspec.Struct):
        if isinstance(value, Pose):
            yield where, value
        for name in value.__struct_fields__:
            if not isinstance(value, wire.Artefact) or name != "data":  # bounded by its message
                yield from _list_parts(getattr(value, name), f"{where}.{name}".lstrip("."))
    elif isinstance(value, dict):
        yield where, value
        for name, each in value.items():
            yield from _list_parts(each, f"{where}[{_show(str(name))}]")
    elif isinstance(value, list | tuple):
        yield where, value
        for index, each in enumerate(value):
            yield from _list_parts(each, f"{where}[{index}]")
    elif not isinstance(value, np.ndarray):
        yield where, value
    elif value.dtype == np.float64:  # a depth may be NaN
        yield where, float(value.sum())


def _is_no_turn(pose: Pose) -> bool:
    return not abs(math.hypot(*pose.quaternion_wxyz) - 1.0) <= UNIT_TOLERANCE


def _find_negative(step: wire.Step) -> str:
    """What no measurement is below zero: it would hide a force, an uncertainty, an arm that lags behind."""
    named = {name: getattr(step, name) or 0.0 for name in _AT_LEAST_ZERO}
    named |= {f"touched_n[{_show(name)}]": force_n for name, force_n in step.touched_n.items()}
    return next((f"{name} = {value}, below zero" for name, value in named.items() if value < 0.0), "")


def _find_fault_of_command(live: wire.Description) -> str:
    rows, joints = live.steps_per_command, live.n_joints
    if not (live.physics_step_s > 0.0 < rows):
        return f"{rows} steps of {live.physics_step_s} s a command"
    is_sound = joints >= 0 and rows * max(joints, 1) <= ITEMS_MAX
    return "" if is_sound else f"{joints} joints and {rows} steps a command"


def _find_fault_of_cameras(request: wire.Capture, frames: Sequence[wire.Frame]) -> str:
    shown, wanted = [each.camera for each in frames], {*request.cameras, *request.crops}
    strange = [each for each in shown if shown.count(each) > 1 or (request.cameras and each not in wanted)]
    return f"a frame of {_show(strange[0])}, which was not requested, or twice" if strange else ""


def _find_fault_of_frame(frame: wire.Frame) -> str:
    expected, lens = (frame.height, frame.width), (frame.fx, frame.fy)
    found = ""
    if frame.rgb.shape != (*expected, 3) or frame.depth_m.shape != expected or min(expected) < 1:
        found = f"colours {frame.rgb.shape} and depths {frame.depth_m.shape}, where its size is {expected}"
    elif (frame.rgb.dtype.name, frame.depth_m.dtype.name) != ("uint8", "float32"):
        found = f"colours of {frame.rgb.dtype} and depths of {frame.depth_m.dtype}; expected uint8 and float32"
    elif min(lens) <= 0.0:
        found = f"focal lengths of {lens}"
    elif (frame.depth_m <= 0.0).any():
        found = f"a depth of {np.nanmin(frame.depth_m)} m; NaN stands where nothing was measured"
    return found and f"a frame of {_show(frame.camera)} with {found}"


def _find_fault_of_code(code: str, phases: set[Phase] | None = None) -> str:
    row = find_code(code)
    return "" if row is not None and (phases is None or row.phase in phases) else f"{_show(code)} where a code belongs"


def _find_foreign_file(tool: str, names: dict[str, wire.Artefact]) -> str:
    known = FILES.get(tool)
    strange = [name for name in names if not (name in known if known else _NAME.fullmatch(name))]
    return f"a file {_show(strange[0])}; possible: {format_names(known or ['a plain name'])}" if strange else ""


def _show(text: str) -> str:
    return repr(clean(text)[:SHOWN])
